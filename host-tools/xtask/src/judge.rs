//! `cargo xtask judge`: what is asked of calibration on recordings that are not in the repository, fitted and
//! judged by the commands that a user types.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use serde_json::Value;

use crate::costs::{self, Stage};
use crate::cycles;
use crate::run::{cargo, locked, program, root, run, target};

/// Where the recordings are.
#[derive(Args)]
pub struct Judge {
    /// The folder that holds `eflesh/` (a magnetic skin against a load cell) and `traces/` (a fingertip of
    /// another simulator)
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Only cases whose name contains this
    #[arg(long, default_value = "")]
    filter: String,
}

/// One fit, and what is asked of it on a recording that it has not seen.
struct Case {
    name: &'static str,
    /// Files and stretches beneath the folder.
    fitted: Vec<String>,
    unseen: String,
    /// What is typed besides the recordings.
    typed: &'static [&'static str],
    /// RMS error in newtons of a target, at most.
    errors: &'static [(&'static str, f64)],
    cost: Cost,
}

/// What one estimate may cost at most.
#[derive(Clone, Copy)]
enum Cost {
    MultiplyAdds(u64),
    /// Modelled, the dearer end of the band.
    Cycles(u64),
}

const TABLE: &[&str] = &["--inputs", "m*", "--targets", "force_n", "--model", "auto"];

/// Of its time, from the first row, what the shear recording is fitted to; the rest judges.
const SHARE: f64 = 0.8;

/// What a small net may take of a Cortex-M4F.
const SMALL_CYCLES: u64 = 900;

/// The skin's limits are what scikit-learn's best of three seeds leaves (linear skip path and 16 tanh units by L-BFGS:
/// 0.46, 0.78 and 0.28 N).
fn cases(data: &Path) -> Result<Vec<Case>> {
    let split = at_share(&data.join("eflesh/shear_1.csv"))?;
    let table = |name, fitted: &str, unseen: &str, errors| Case {
        name,
        fitted: vec![fitted.into()],
        unseen: unseen.into(),
        typed: TABLE,
        errors,
        cost: Cost::MultiplyAdds(600),
    };
    let finger = |name, typed, errors, cost| Case {
        name,
        fitted: vec!["traces/device3_presses.csv".into(), "traces/device3_shear.csv@0..30".into()],
        unseen: "traces/device3_shear.csv@30..40".into(),
        typed,
        errors,
        cost,
    };
    const SMALL: &[(&str, f64)] = &[("fx_n", 0.03), ("fy_n", 0.03), ("fz_n", 0.005)];
    const ANY: &[(&str, f64)] = &[("fx_n", 0.02), ("fy_n", 0.02), ("fz_n", 0.02)];
    let (first, second) = ("eflesh/normal_1.csv", "eflesh/normal_2.csv");
    let shear = "eflesh/shear_1.csv";
    Ok(vec![
        table("eflesh normal_1 -> normal_2", first, second, &[("force_n", 0.48)]),
        table("eflesh normal_2 -> normal_1", second, first, &[("force_n", 0.75)]),
        table(
            "eflesh shear_1, first 80 % -> last 20 %",
            &format!("{shear}@..{split:.3}"),
            &format!("{shear}@{split:.3}.."),
            &[("force_n", 0.28)],
        ),
        finger(
            "device3, a small net",
            &["--model", "auto", "--net-only", "--hidden", "12", "--form", "q15"],
            SMALL,
            Cost::Cycles(SMALL_CYCLES),
        ),
        finger("device3, any net", &["--model", "auto", "--net-only"], ANY, Cost::Cycles(6000)),
    ])
}

/// Fits and judges every case; fails where a limit is missed, after all have been judged.
pub fn task(arguments: &Judge) -> Result<()> {
    let data = std::path::absolute(&arguments.data)?;
    let cases = cases(&data)?;
    let cases: Vec<&Case> = cases.iter().filter(|c| c.name.contains(&arguments.filter)).collect();
    ensure!(!cases.is_empty(), "--filter {}: no case has this in its name", arguments.filter);
    let costs = costs::read(&cycles::table())?;
    run(cargo().args(["build", "--quiet", "--bin", "taxel"]).args(locked()))?;
    let mut missed = 0;
    for case in &cases {
        println!("{}", case.name);
        for verdict in judged(case, &data, &costs)? {
            missed += usize::from(!verdict.met());
            println!("{verdict}");
        }
    }
    match missed {
        0 => Ok(()),
        _ => bail!("{missed} missed of what is asked; they are told above"),
    }
}

fn judged(case: &Case, data: &Path, costs: &[Stage]) -> Result<Vec<Verdict>> {
    let record = target().join("judged.toml");
    let taxel = |words: &[&str]| -> Result<Value> {
        let mut command = program(target().join("debug/taxel"), &root());
        command.arg("calibrate").args(words).arg("--json");
        let output = command.output().context("`taxel` does not start")?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "{}: `taxel {}`: {said}", case.name, words.join(" "));
        eprint!("{said}");
        Ok(serde_json::from_slice(&output.stdout)?)
    };
    let path = |file: &String| data.join(file).display().to_string();
    let (out, unseen) = (record.display().to_string(), path(&case.unseen));
    let fitted: Vec<String> = case.fitted.iter().map(path).collect();
    let mut fit = vec!["fit", "--out", &out];
    fit.extend(case.typed);
    fit.extend(fitted.iter().flat_map(|file| ["--data", file]));
    let fit = taxel(&fit)?;
    let figures = taxel(&["evaluate", "--data", &unseen, "--calibration", &out])?;
    let mut verdicts = Vec::new();
    for (target, limit) in case.errors {
        let figure = |name: &str| figures[target][name].clone();
        let reached = figure("rmse").as_f64();
        let withheld: u64 = figure("withheld")
            .as_object()
            .map_or(0, |w| w.values().filter_map(Value::as_u64).sum());
        let rows = figure("n").as_u64().unwrap_or_default();
        verdicts.push(Verdict {
            what: format!("{target}, of {} rows", rows + withheld),
            asked: *limit,
            reached: reached.with_context(|| format!("{}: no {target} was judged", case.name))?,
            digits: 4,
        });
        verdicts.push(Verdict {
            what: format!("{target}, share of rows withheld"),
            asked: WITHHELD,
            reached: withheld as f64 / (rows + withheld) as f64,
            digits: 4,
        });
    }
    verdicts.push(cost(case, &fit, costs)?);
    Ok(verdicts)
}

/// Rows without a value are no good ones: no more than this share.
const WITHHELD: f64 = 0.01;

fn cost(case: &Case, fit: &Value, costs: &[Stage]) -> Result<Verdict> {
    let parts = fit["parts"].as_array().map_or(&[][..], Vec::as_slice);
    let names = || parts.iter().filter_map(|part| part["part"].as_str());
    let shape = names().find(|name| dimensions(name).is_some());
    let shape = shape.with_context(|| format!("{}: the fit names no net", case.name))?;
    let (what, asked, reached) = match case.cost {
        Cost::MultiplyAdds(most) => {
            (format!("multiply-adds of {shape}"), most, multiply_adds(shape).unwrap_or_default())
        }
        Cost::Cycles(most) => {
            let stage = if names().any(|name| name == "the net in 16 bits") {
                format!("q15 {shape}")
            } else {
                shape.to_owned()
            };
            let dearest = modelled(costs, &stage)
                .with_context(|| format!("{stage}: no row of {}", cycles::table().display()))?;
            (format!("modelled cycles of {stage}"), most, dearest)
        }
    };
    Ok(Verdict { what, asked: asked as f64, reached: reached as f64, digits: 0 })
}

/// Kind, inputs, hidden units and outputs of `skip 15-16-1`, `net 16-6-3`, `linear 15-1`.
fn dimensions(shape: &str) -> Option<(&str, Vec<u64>)> {
    let (kind, numbers) = shape.split_once(' ')?;
    let numbers: Vec<u64> = numbers.split('-').map(|n| n.parse().ok()).collect::<Option<_>>()?;
    let right = match kind {
        "linear" => 2,
        "net" | "skip" => 3,
        _ => return None,
    };
    (numbers.len() == right).then_some((kind, numbers))
}

fn multiply_adds(shape: &str) -> Option<u64> {
    let (kind, numbers) = dimensions(shape)?;
    match (kind, numbers.as_slice()) {
        ("linear", [inputs, outputs]) => Some(inputs * outputs),
        ("net", [inputs, hidden, outputs]) => Some(hidden * (inputs + outputs)),
        ("skip", [inputs, hidden, outputs]) => Some(hidden * (inputs + outputs) + inputs * outputs),
        _ => None,
    }
}

fn modelled(costs: &[Stage], stage: &str) -> Option<u64> {
    costs.iter().find(|row| row.name == stage).map(|row| row.cycles)
}

/// The second where [`SHARE`] of a table's time is over.
fn at_share(path: &Path) -> Result<f64> {
    let text = std::fs::read_to_string(path).with_context(|| {
        format!("{}: --data names the folder that holds eflesh/ and traces/", path.display())
    })?;
    let time = |line: Option<&str>| line?.split(',').next()?.parse::<f64>().ok();
    let ends = time(text.lines().nth(1)).zip(time(text.lines().next_back()));
    let (first, last) = ends.with_context(|| format!("{}: no times", path.display()))?;
    Ok(first + SHARE * (last - first))
}

/// What was asked and what was reached.
struct Verdict {
    what: String,
    asked: f64,
    reached: f64,
    digits: usize,
}

impl Verdict {
    fn met(&self) -> bool {
        self.reached <= self.asked
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { what, asked, reached, digits } = self;
        let verdict = if self.met() { "met" } else { "MISSED" };
        write!(f, "  {what:<40} asked {asked:>9.digits$}  reached {reached:>9.digits$}  {verdict}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_over_its_limit_is_missed_and_what_is_no_number_too() {
        let verdict = |reached| Verdict { what: "fy_n".into(), asked: 0.03, reached, digits: 4 };
        assert!(verdict(0.03).met() && verdict(0.0299).met());
        assert!(!verdict(0.0301).met() && !verdict(f64::NAN).met());
        assert!(verdict(0.0427).to_string().ends_with("reached    0.0427  MISSED"));
    }

    #[test]
    fn a_net_costs_what_its_shape_says() {
        assert_eq!(multiply_adds("skip 15-16-1"), Some(15 * 16 + 16 + 15));
        assert_eq!(multiply_adds("net 16-6-3"), Some(114));
        assert_eq!(multiply_adds("linear 15-1"), Some(15));
        assert_eq!(multiply_adds("array of sensors"), None);
        let costs = costs::read(&cycles::table()).unwrap();
        let shapes = ["q15 skip 16-12-3", "q15 skip 16-16-3", "skip 16-12-3"];
        let [small, wide, float] = shapes.map(|stage| modelled(&costs, stage).unwrap());
        assert!(small <= SMALL_CYCLES && SMALL_CYCLES < wide.min(float), "{small} {wide} {float}");
        assert_eq!(modelled(&costs, "net 16-7-3"), None);
    }
}
