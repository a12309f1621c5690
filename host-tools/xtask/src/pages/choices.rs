//! Tables of the page that tells which method, labels and chip to use.

use anyhow::Result;

use super::reference::{CELL, LABELS, SIX_AXES};
use super::tables::{Csv, cell};
use crate::marks::{Part, lines};

const ESTIMATORS: &str = "docs/images/estimators.csv";
const ABLATION: &str = "host-tools/research/data/ablation.csv";
const CYCLES: &str = "host-tools/emulator/data/cycles.csv";

/// Tables of the page.
pub fn parts() -> Result<Vec<Part>> {
    Ok(vec![("methods", methods()?), ("slip", slip()?), ("labels", labels()?), ("chips", chips()?)])
}

/// Estimators' errors and costs.
struct Estimators(Csv);

impl Estimators {
    fn error(&self, name: &str, scene: &str, quantity: &str) -> Result<f64> {
        let wanted = [("name", name), ("scene", scene), ("quantity", quantity)];
        self.0.mean(&wanted, "rmse")
    }

    /// Cost of a method in thousands of cycles; of some it depends on the scene.
    fn cost(&self, name: &str) -> Result<String> {
        let ends = |column| self.0.cells(&[("name", name)], column);
        let both = ends("cycles_low")?.into_iter().zip(ends("cycles_high")?);
        let means = both.map(|(low, high)| Ok((low.parse::<f64>()? + high.parse::<f64>()?) / 2e3));
        let means = means.collect::<Result<Vec<f64>>>()?;
        let least = format!("{:.1}k", means.iter().copied().fold(f64::MAX, f64::min));
        let most = format!("{:.1}k", means.iter().copied().fold(0.0, f64::max));
        Ok(if least == most { least } else { format!("{least} to {most}") })
    }
}

/// Row of the table of methods.
struct Choice {
    have: &'static str,
    need: &'static str,
    method: &'static str,
    /// Name in the table of estimators.
    name: &'static str,
    measures: &'static [Measure],
    /// Part of the reference finger that a default fit gives.
    part: Option<&'static str>,
}

/// Quantity of a method: its words, scene, name, unit, units in one, digits.
type Measure = (&'static str, &'static str, &'static str, &'static str, f64, usize);

const NORMAL: Measure = ("F_z", "presses", "normal force", "mN", 1e3, 1);
const SHEAR: Measure = ("shear", "shear", "shear force", "mN", 1e3, 1);
const PLACE: Measure = ("place", "presses", "contact point", "mm", 1.0, 2);
const TORSION: Measure = ("torsion", "torsion", "torsion", "N·mm", 1.0, 3);

const CHOICES: [Choice; 7] = [
    Choice {
        have: "matrix",
        need: "place within a taxel",
        method: "nearest taxel; needs no calibration",
        name: "arg-min",
        measures: &[PLACE],
        part: None,
    },
    Choice {
        have: "matrix",
        need: "normal force, few cycles",
        method: "net 16-12-1 in 16 bits: `--net-only --model mlp --form q15`, no shear among the labels",
        name: "q15 net 16-12-1",
        measures: &[NORMAL],
        part: None,
    },
    Choice {
        have: "matrix",
        need: "three forces, few cycles",
        method: "net 16-16-3: `--net-only --model mlp`",
        name: "net 16-16-3",
        measures: &[NORMAL, SHEAR],
        part: None,
    },
    Choice {
        have: "matrix",
        need: "three forces and place",
        method: "default fit: the model of the skin, where it holds",
        name: "model",
        measures: &[NORMAL, SHEAR, PLACE],
        part: Some("matrix"),
    },
    Choice {
        have: "force sensors",
        need: "three forces",
        method: "sum of the sensors: ask for the field `force` alone",
        name: "four sensors",
        measures: &[NORMAL, SHEAR],
        part: None,
    },
    Choice {
        have: "force sensors",
        need: "three forces, place, torsion",
        method: "wrench of the array",
        name: "four sensors' wrench",
        measures: &[NORMAL, SHEAR, PLACE, TORSION],
        part: None,
    },
    Choice {
        have: "both",
        need: "everything",
        method: "default fit: every estimator that holds",
        name: "finger",
        measures: &[NORMAL, SHEAR, PLACE, TORSION],
        part: Some("both"),
    },
];

fn methods() -> Result<String> {
    let table = Estimators(Csv::read(ESTIMATORS)?);
    let ablation = Csv::read(ABLATION)?;
    let mut rows = vec![
        "| you have | you need | use | modelled cycles | expect of the ideal finger | of the reference finger |"
            .to_owned(),
        "|---|---|---|---|---|---|".to_owned(),
    ];
    for Choice { have, need, method, name, measures, part } in CHOICES {
        let ideal = measures.iter().map(|(words, scene, quantity, unit, units, digits)| {
            let error = units * table.error(name, scene, quantity)?;
            Ok(format!("{words} {error:.digits$} {unit}"))
        });
        let ideal = ideal.collect::<Result<Vec<_>>>()?.join(", ");
        let real = |part| {
            let of =
                |column| ablation.mean(&[("finger", "reference finger"), ("part", part)], column);
            let shear = f64::max(of("fx / mN")?, of("fy / mN")?);
            let (normal, place) = (of("fz / mN")?, of("point pad / mm")?);
            Ok::<_, anyhow::Error>(format!(
                "F_z {normal:.0} mN, shear {shear:.0} mN, place {place:.2} mm"
            ))
        };
        let real = part.map_or(Ok("–".to_owned()), real)?;
        let cost = table.cost(name)?;
        rows.push(format!("| {have} | {need} | {method} | {cost} | {ideal} | {real} |"));
    }
    let cycles = Csv::read(CYCLES)?;
    let mut two = 0.0;
    for frames in ["estimates", "frames at 1 kHz"] {
        let name = format!("finger: two contacts, {frames}");
        let of = |column| cycles.mean(&[("name", &name)], column);
        two = f64::max(two, (of("cycles_low")? + of("cycles_high")?) / 2e3);
    }
    let found = |column| {
        cell("docs/accuracy.md", "Specification", "two contacts two pitches apart, found", column)
    };
    rows.push(format!(
        "| matrix; both | two contacts at once | model of two contacts: field `contacts` | {two:.1}k at worst, \
         with all else | found {}; {}, two pitches apart | – |",
        found(2)?,
        found(4)?
    ));
    Ok(lines(rows))
}

fn slip() -> Result<String> {
    let table = Estimators(Csv::read(ESTIMATORS)?);
    let told = |row: &str, column| cell("docs/accuracy.md", "Slip", row, column);
    let row = |have: &str, method: &str, column: usize| {
        Ok::<_, anyhow::Error>(format!(
            "| {have} | {} | {} | {} | {} |",
            table.cost(method)?,
            told("gross slips told", column)?,
            told("first slide on a new material, warned of 20 ms ahead", column)?,
            told("later slides on it, warned of 20 ms ahead", column)?
        ))
    };
    Ok(lines([
        "| you have | modelled cycles | gross slips told | first slide on a material, warned of 20 ms ahead | later ones |".to_owned(),
        "|---|---|---|---|---|".to_owned(),
        row("matrix", "slip: matrix", 1)?,
        row("force sensors", "slip: force sensors", 2)?,
        row("both", "slip: both", 3)?,
    ]))
}

fn labels() -> Result<String> {
    let table = Csv::read(LABELS)?;
    let row = |have: &str, labels: &str| {
        let cells = ["matrix", "both"].map(|part| {
            let of = |column| table.mean(&[("labels", labels), ("part", part)], column);
            let [x, y, z] = ["fx / mN", "fy / mN", "fz / mN"].map(of);
            let [middle, pad] = ["point middle / mm", "point pad / mm"].map(of);
            Ok::<_, anyhow::Error>(format!(
                "{:.0} / {:.0} / {:.0}, {:.2} ({:.2})",
                x?, y?, z?, middle?, pad?
            ))
        });
        let [matrix, both] = cells;
        Ok::<_, anyhow::Error>(format!("| {have} | {labels} | {} | {} |", matrix?, both?))
    };
    Ok(lines([
        "| you have | labels | matrix alone | matrix and force sensors |".to_owned(),
        "|---|---|---|---|".to_owned(),
        row("load cell under the finger", CELL)?,
        row("six-axis load cell under the finger", SIX_AXES)?,
        row(
            "load cell, and a stage or robot that places the indenter",
            "total force, contact point",
        )?,
        row("a simulator", "force on each sensor, contact point")?,
    ]))
}

fn chips() -> Result<String> {
    let (g431, f411) = ("docs/boards/stm32g431.md", "docs/boards/stm32f411.md");
    let row = |scene: &str| {
        let g = |column| cell(g431, "Load", &format!("{scene}, 4 kHz, frames at 4 kHz"), column);
        let f = |column| cell(f411, "Frame", &format!("{scene}, 4 kHz, frames at 1 kHz"), column);
        Ok::<_, anyhow::Error>(format!(
            "| {scene} | {} | {} | {} | {} |",
            g(1)?,
            g(4)?,
            f(1)?,
            f(4)?
        ))
    };
    Ok(lines([
        "| scene | STM32G431, frames at 4 kHz: core awake | scans lost in 0.13 to 0.2 s | STM32F411, frames at 1 kHz: core awake | scans lost in 0.13 to 0.2 s |".to_owned(),
        "|---|---|---|---|---|".to_owned(),
        row("no contact")?,
        row("normal contact")?,
        row("shear")?,
        row("two contacts")?,
    ]))
}
