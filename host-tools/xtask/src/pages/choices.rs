//! Tables of the page that tells which method, labels and chip to use.

use anyhow::Result;

use super::reference::{CELL, LABELS};
use super::tables::{Csv, cell};
use crate::marks::{Part, lines};

const ESTIMATORS: &str = "docs/images/estimators.csv";
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

fn methods() -> Result<String> {
    let table = Estimators(Csv::read(ESTIMATORS)?);
    let normal = |name| {
        Ok::<_, anyhow::Error>(format!(
            "F_z {:.1} mN",
            1e3 * table.error(name, "presses", "normal force")?
        ))
    };
    let shear = |name| {
        Ok::<_, anyhow::Error>(format!(
            "shear {:.1} mN",
            1e3 * table.error(name, "shear", "shear force")?
        ))
    };
    let place = |name| {
        Ok::<_, anyhow::Error>(format!(
            "place {:.2} mm",
            table.error(name, "presses", "contact point")?
        ))
    };
    let torsion = |name| {
        Ok::<_, anyhow::Error>(format!(
            "torsion {:.3} N·mm",
            table.error(name, "torsion", "torsion")?
        ))
    };
    let contacts = |column| {
        cell("docs/accuracy.md", "Specification", "two contacts two pitches apart, found", column)
    };
    let cycles = Csv::read(CYCLES)?;
    let two = [("name", "finger: two contacts, estimates")];
    let two = (cycles.mean(&two, "cycles_low")? + cycles.mean(&two, "cycles_high")?) / 2e3;
    let row = |have: &str, need: &str, method: &str, cost: String, expect: Vec<String>| {
        format!("| {have} | {need} | {method} | {cost} | {} |", expect.join(", "))
    };
    let wrench = "four sensors' wrench";
    Ok(lines([
        "| you have | you need | use | modelled cycles | expect, ideal finger, simulated |"
            .to_owned(),
        "|---|---|---|---|---|".to_owned(),
        row(
            "matrix",
            "place within a taxel",
            "nearest taxel; needs no calibration",
            table.cost("arg-min")?,
            vec![place("arg-min")?],
        ),
        row(
            "matrix",
            "normal force, few cycles",
            "net 16-12-1 in 16 bits: `--form q15`",
            table.cost("q15 net 16-12-1")?,
            vec![normal("q15 net 16-12-1")?],
        ),
        row(
            "matrix",
            "three forces, few cycles",
            "net 16-16-3: `--net-only`",
            table.cost("net 16-16-3")?,
            vec![normal("net 16-16-3")?, shear("net 16-16-3")?],
        ),
        row(
            "matrix",
            "three forces and place",
            "model of the skin (default)",
            table.cost("model")?,
            vec![normal("model")?, shear("model")?, place("model")?],
        ),
        row(
            "force sensors",
            "three forces",
            "sum of the sensors: ask for the field `force` alone",
            table.cost("four sensors")?,
            vec![normal("four sensors")?, shear("four sensors")?],
        ),
        row(
            "force sensors",
            "three forces, place, torsion",
            "wrench of the array",
            table.cost(wrench)?,
            vec![normal(wrench)?, shear(wrench)?, place(wrench)?, torsion("four sensors' wrench")?],
        ),
        row(
            "both",
            "everything",
            "every estimator (default)",
            table.cost("finger")?,
            vec![normal("finger")?, shear("finger")?, place("finger")?, torsion("finger")?],
        ),
        row(
            "matrix; both",
            "two contacts at once",
            "model of two contacts: field `contacts`",
            format!("{two:.1}k at worst, with all else"),
            vec![format!("found {}; {}, two pitches apart", contacts(2)?, contacts(4)?)],
        ),
    ]))
}

fn slip() -> Result<String> {
    let table = Estimators(Csv::read(ESTIMATORS)?);
    let page = "docs/accuracy.md";
    let told = |row: &str, column| cell(page, "Slip", row, column);
    let row = |have: &str, method: &str, column: usize| {
        let margin = |scene| table.error(method, scene, "slip margin");
        Ok::<_, anyhow::Error>(format!(
            "| {have} | {} | {:.0} % | {} | {} |",
            table.cost(method)?,
            1e2 * margin("shear")?,
            told("gross slips detected, of 320", column)?,
            told("warned 20 ms before gross slip", column)?
        ))
    };
    Ok(lines([
        "| you have | modelled cycles | error of the slip margin | gross slips detected, of 320 | warned 20 ms before |".to_owned(),
        "|---|---|---|---|---|".to_owned(),
        row("matrix", "slip: matrix", 2)?,
        row("both", "slip: both", 1)?,
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
        "| scene | STM32G431, frames at 4 kHz: core awake | scans lost in 0.13 s | STM32F411, frames at 1 kHz: core awake | scans lost in 0.13 s |".to_owned(),
        "|---|---|---|---|---|".to_owned(),
        row("no contact")?,
        row("normal contact")?,
        row("shear")?,
        row("two contacts")?,
    ]))
}
