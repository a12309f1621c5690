//! Limits of the specification, judged on recordings outside the repository.
//!
//! Every case is fitted and judged by the commands that a user types.

mod independent;
mod moving;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use serde_json::Value;
use taxel_research::costs::Costs;

use crate::command;

/// Recordings and selection of cases.
#[derive(Args)]
pub struct Judge {
    /// Folder with `eflesh/` (a magnetic skin and a load cell), `traces/` (a fingertip of another
    /// simulator) and `independent/` (fingers of other programs)
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Only cases whose name contains this
    #[arg(long, default_value = "")]
    filter: String,
}

/// A fit and its limits on a recording that the fit has not seen.
struct Case {
    name: &'static str,
    /// Files and time ranges in the folder.
    fitted: Vec<String>,
    unseen: String,
    /// Options of `taxel calibrate`.
    options: &'static [&'static str],
    /// Largest RMS error of each target in newtons.
    errors: &'static [(&'static str, f64)],
    cost: Cost,
}

/// Largest cost of one estimate.
#[derive(Clone, Copy)]
enum Cost {
    MultiplyAdds(u64),
    /// Modelled cycles, the upper end of the band.
    Cycles(u64),
}

const TABLE: &[&str] = &["--inputs", "m*", "--targets", "force_n"];

/// Share of the shear recording, from its first row, that the fit may see.
const SHARE: f64 = 0.8;

/// Largest number of Cortex-M4F cycles of a small net.
const SMALL_CYCLES: u64 = 900;

/// Lists the cases.
///
/// The limits of the magnetic skin are near the errors of scikit-learn's best of three seeds.
///
/// That net has a linear bypass and 16 tanh units, trained by L-BFGS: 0.46, 0.78 and 0.28 N.
fn cases(data: &Path) -> Result<Vec<Case>> {
    let split = at_share(&data.join("eflesh/shear_1.csv"))?;
    let table = |name, fitted: &str, unseen: &str, errors| Case {
        name,
        fitted: vec![fitted.into()],
        unseen: unseen.into(),
        options: TABLE,
        errors,
        cost: Cost::MultiplyAdds(600),
    };
    let finger = |name, options, errors, cost| Case {
        name,
        fitted: vec!["traces/device3_presses.csv".into(), "traces/device3_shear.csv@0..30".into()],
        unseen: "traces/device3_shear.csv@30..40".into(),
        options,
        errors,
        cost,
    };
    const SMALL: &[(&str, f64)] = &[("fx_n", 0.03), ("fy_n", 0.03), ("fz_n", 0.005)];
    const ANY: &[(&str, f64)] = &[("fx_n", 0.02), ("fy_n", 0.02), ("fz_n", 0.02)];
    let (first, second) = ("eflesh/normal_1.csv", "eflesh/normal_2.csv");
    let shear = "eflesh/shear_1.csv";
    Ok(vec![
        table("eflesh normal_1 -> normal_2", first, second, &[("force_n", 0.47)]),
        table("eflesh normal_2 -> normal_1", second, first, &[("force_n", 0.70)]),
        table(
            "eflesh shear_1, first 80 % -> last 20 %",
            &format!("{shear}@..{split:.3}"),
            &format!("{shear}@{split:.3}.."),
            &[("force_n", 0.27)],
        ),
        finger(
            "device3, a small net",
            &["--net-only", "--hidden", "12", "--form", "q15"],
            SMALL,
            Cost::Cycles(SMALL_CYCLES),
        ),
        finger("device3, any net", &["--net-only"], ANY, Cost::Cycles(6000)),
    ])
}

/// Fits and judges every case; fails after all of them where a limit is missed.
pub fn judge(arguments: &Judge) -> Result<()> {
    let data = std::path::absolute(&arguments.data)?;
    let cases = cases(&data)?;
    let cases: Vec<&Case> = cases.iter().filter(|c| c.name.contains(&arguments.filter)).collect();
    let mut fingers = independent::fingers();
    fingers.retain(|finger| finger.name.contains(&arguments.filter));
    let none = cases.is_empty() && fingers.is_empty();
    ensure!(!none, "--filter {}: no case has this in its name", arguments.filter);
    let costs = Costs::committed()?;
    let mut missed = 0;
    let mut tell = |name: &str, verdicts: Vec<Verdict>| {
        println!("{name}");
        for verdict in verdicts {
            missed += usize::from(!verdict.met());
            println!("{verdict}");
        }
    };
    for case in &cases {
        tell(case.name, judged(case, &data, &costs)?);
    }
    for finger in &fingers {
        tell(&finger.name, independent::judged(finger, &data)?);
    }
    match missed {
        0 => Ok(()),
        _ => bail!("{missed} limits missed; they are listed above"),
    }
}

/// Runs `taxel calibrate` and returns its JSON.
fn calibrate(case: &str, words: &[&str]) -> Result<Value> {
    let words = [&["calibrate"], words, &["--json"]].concat();
    Ok(serde_json::from_slice(&taxel(case, &words)?)?)
}

/// Runs `taxel` and returns what it prints.
fn taxel(case: &str, words: &[&str]) -> Result<Vec<u8>> {
    let name = format!("taxel{}", std::env::consts::EXE_SUFFIX);
    let taxel = std::env::current_exe()?.with_file_name(name);
    let mut command = command(&taxel, Path::new("."));
    command.args(words);
    let output = command.output().with_context(|| {
        format!("{}: does not start; build it as this program was built", taxel.display())
    })?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{case}: `taxel {}`: {said}", words.join(" "));
    eprint!("{said}");
    Ok(output.stdout)
}

fn judged(case: &Case, data: &Path, costs: &Costs) -> Result<Vec<Verdict>> {
    let folder = tempfile::tempdir()?;
    let path = |file: &String| data.join(file).display().to_string();
    let out = folder.path().join("judged.toml").display().to_string();
    let unseen = path(&case.unseen);
    let fitted: Vec<String> = case.fitted.iter().map(path).collect();
    let mut fit = vec!["fit", "--out", &out];
    fit.extend(case.options);
    fit.extend(fitted.iter().flat_map(|file| ["--data", file]));
    let fit = calibrate(case.name, &fit)?;
    let figures = calibrate(case.name, &["evaluate", "--data", &unseen, "--calibration", &out])?;
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
            limit: *limit,
            reached: reached.with_context(|| format!("{}: no {target} was judged", case.name))?,
            digits: 4,
        });
        verdicts.push(Verdict {
            what: format!("{target}, share of rows withheld"),
            limit: WITHHELD,
            reached: withheld as f64 / (rows + withheld) as f64,
            digits: 4,
        });
    }
    verdicts.push(cost(case, &fit, costs)?);
    Ok(verdicts)
}

/// Largest share of rows without a value.
const WITHHELD: f64 = 0.01;

fn cost(case: &Case, fit: &Value, costs: &Costs) -> Result<Verdict> {
    let parts = fit["parts"].as_array().map_or(&[][..], Vec::as_slice);
    let names = || parts.iter().filter_map(|part| part["part"].as_str());
    let shape = names().find(|name| dimensions(name).is_some());
    let shape = shape.with_context(|| format!("{}: the fit names no net", case.name))?;
    let (what, limit, reached) = match case.cost {
        Cost::MultiplyAdds(most) => {
            (format!("multiply-adds of {shape}"), most, multiply_adds(shape).unwrap_or_default())
        }
        Cost::Cycles(most) => {
            let stage = if names().any(|name| name == "the net in 16 bits") {
                format!("q15 {shape}")
            } else {
                shape.to_owned()
            };
            let cycles = costs.of(&[&stage])?.cycles_high;
            (format!("modelled cycles of {stage}"), most, cycles)
        }
    };
    Ok(Verdict { what, limit: limit as f64, reached: reached as f64, digits: 0 })
}

/// Splits kind, inputs, hidden units and outputs of `skip 15-16-1`, `net 16-6-3`, `linear 15-1`.
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

/// Returns the second at which [`SHARE`] of a table's time is over.
fn at_share(path: &Path) -> Result<f64> {
    let text = std::fs::read_to_string(path).with_context(|| {
        format!("{}: --data names the folder that holds eflesh/ and traces/", path.display())
    })?;
    let time = |line: Option<&str>| line?.split(',').next()?.parse::<f64>().ok();
    let ends = time(text.lines().nth(1)).zip(time(text.lines().next_back()));
    let (first, last) = ends.with_context(|| format!("{}: no times", path.display()))?;
    Ok(first + SHARE * (last - first))
}

/// A limit with the value reached.
struct Verdict {
    what: String,
    limit: f64,
    reached: f64,
    digits: usize,
}

impl Verdict {
    fn met(&self) -> bool {
        self.reached <= self.limit
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { what, limit, reached, digits } = self;
        let verdict = if self.met() { "met" } else { "MISSED" };
        write!(f, "  {what:<54} limit {limit:>9.digits$}  reached {reached:>9.digits$}  {verdict}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn value_over_its_limit_or_nan_is_missed() {
        let verdict = |reached| Verdict { what: "fy_n".into(), limit: 0.03, reached, digits: 4 };
        assert!(verdict(0.03).met() && verdict(0.0299).met());
        assert!(!verdict(0.0301).met() && !verdict(f64::NAN).met());
        assert!(verdict(0.0427).to_string().ends_with("reached    0.0427  MISSED"));
    }

    #[test]
    fn cost_of_a_net_follows_from_its_shape() {
        assert_eq!(multiply_adds("skip 15-16-1"), Some(15 * 16 + 16 + 15));
        assert_eq!(multiply_adds("net 16-6-3"), Some(114));
        assert_eq!(multiply_adds("linear 15-1"), Some(15));
        assert_eq!(multiply_adds("array of sensors"), None);
        let costs = Costs::committed().unwrap();
        let shapes = ["q15 skip 16-12-3", "q15 skip 16-16-3", "skip 16-12-3"];
        let [small, wide, float] = shapes.map(|stage| costs.of(&[stage]).unwrap().cycles_high);
        assert!(small <= SMALL_CYCLES && SMALL_CYCLES < wide.min(float), "{small} {wide} {float}");
        assert!(costs.of(&["net 16-7-3"]).is_err());
    }
}
