//! Data sheet of the reference finger, each line from a table or a constant.

use anyhow::Result;
use scan_plan::finger::REFERENCE;
use taxel::instrument::Instrument;
use taxel::scan::{COLS, PITCH, ROWS, SENSORS};

use super::reference::{CELL, FIGURES, LABELS};
use super::tables::{Csv, cell, key, number, random};
use crate::hardware::{mould, mount};
use crate::marks::{Part, lines};

const ABLATION: &str = "host-tools/research/data/ablation.csv";
const ACCURACY: &str = "docs/accuracy.md";
const BOARD: &str = "docs/boards/stm32g431.md";
const BUDGET: &str = "docs/front-end.md";

/// Cell of a figure that nobody knows yet.
const UNKNOWN: &str = "not measured";
/// Voltage of USB.
const USB_V: f64 = 5.0;

/// Tables of the page.
pub fn parts() -> Result<Vec<Part>> {
    Ok(vec![("measures", measures()?), ("finger", finger()?)])
}

/// Line of the first table: quantity, matrix alone, both, kind, source.
fn measure(quantity: &str, [matrix, both]: [String; 2], kind: &str, from: &str) -> String {
    format!("| {quantity} | {matrix} | {both} | {kind} | {from} |")
}

fn unknown(quantity: &str, from: &str) -> String {
    measure(quantity, [UNKNOWN, UNKNOWN].map(str::to_owned), "–", from)
}

/// Both values of a pair, or the first error.
fn pair<T>(of: impl Fn(&str) -> Result<T>) -> Result<[T; 2]> {
    Ok([of("matrix")?, of("both")?])
}

fn measures() -> Result<String> {
    let ablation = Csv::read(ABLATION)?;
    let (labels, figures) = (Csv::read(LABELS)?, Csv::read(FIGURES)?);
    let error = |part: &str, column: &str| {
        ablation.mean(&[("finger", "reference finger"), ("part", part)], column)
    };
    let by_total =
        |part: &str, column: &str| labels.mean(&[("labels", CELL), ("part", part)], column);
    let figure =
        |part: &str, name: &str| figures.mean(&[("figure", name), ("part", part)], "value");
    let forces = |of: &dyn Fn(&str, &str) -> Result<f64>| {
        pair(|part| {
            let [x, y, z] = [of(part, "fx / mN")?, of(part, "fy / mN")?, of(part, "fz / mN")?];
            Ok(format!("{x:.0} / {y:.0} / {z:.0} mN"))
        })
    };
    let [least, most] = random("presses", "fz_n")?;
    let [shear_most, shear_at] =
        [random("shear", "shear_of_limit")?[1], random("shear", "x_mm")?[1]];
    let shear = key("shear", "friction.mu")? * shear_most * random("shear", "fz_n")?[1];
    let share = pair(|part| {
        let all = ["fx / mN", "fy / mN", "fz / mN"].map(|axis| error(part, axis));
        let [x, y, z] = all.map(|e| e.map(|e| format!("{:.1}", 0.1 * e / most)));
        Ok(format!("{} / {} / {} %", x?, y?, z?))
    })?;
    let ideal = |row: &str| {
        let [matrix, both] =
            [cell(ACCURACY, "Specification", row, 2)?, cell(ACCURACY, "Specification", row, 4)?];
        Ok::<_, anyhow::Error>([matrix, both].map(|c| {
            if c == "–" { "none".to_owned() } else { format!("{UNKNOWN}; ideal finger {c}") }
        }))
    };
    let places = |of: &dyn Fn(&str, &str) -> Result<f64>| {
        pair(|part| {
            let [middle, pad] = [of(part, "point middle / mm")?, of(part, "point pad / mm")?];
            Ok(format!("{middle:.2} mm; {pad:.2} mm"))
        })
    };
    let one = |name: &str, digits: usize, unit: &str| {
        pair(|part| Ok(format!("{:.digits$} {unit}", figure(part, name)?).replace('-', "−")))
    };
    let sigmas = pair(|part| {
        let [x, y, z] = ["sigma fx_n", "sigma fy_n", "sigma fz_n"].map(|name| figure(part, name));
        Ok(format!("{:.1} / {:.1} / {:.1} mN", x?, y?, z?))
    })?;
    let place = pair(|part| {
        let [x, y] = ["sigma x_mm", "sigma y_mm"].map(|name| figure(part, name));
        Ok(format!("{:.0} / {:.0} µm", x?, y?))
    })?;
    let ablated = "[effects of the finger](accuracy.md#the-finger-in-the-bill-of-materials)";
    let measured = "[how](#how-the-figures-were-made)";
    let sim = "simulated";
    Ok(lines([
        "| | matrix alone | matrix and force sensors | kind | from |".to_owned(),
        "|---|---|---|---|---|".to_owned(),
        measure(
            "normal force, calibrated range",
            [0, 1].map(|_| format!("{least} to {most} N")),
            sim,
            "scene `presses`",
        ),
        measure(
            "shear, calibrated range",
            [0, 1].map(|_| format!("to {shear:.1} N, within {shear_at} mm of the middle")),
            sim,
            "scene `shear`",
        ),
        unknown("overload", "–"),
        measure("**accuracy** F_x / F_y / F_z, RMS", forces(&error)?, sim, ablated),
        measure(&format!("the same, of {most} N"), share, sim, ablated),
        measure("the same, calibrated by a load cell alone", forces(&by_total)?, sim, measured),
        measure("**contact point**, RMS: in the middle; whole pad", places(&error)?, sim, ablated),
        measure("the same, calibrated by a load cell alone", places(&by_total)?, sim, measured),
        measure(
            "torsion, RMS",
            ideal("torsion")?,
            sim,
            "[ideal finger](accuracy.md#specification)",
        ),
        measure(
            "values beyond three stated deviations, worst quantity",
            pair(|part| Ok(format!("{:.1} %", error(part, "beyond 3 sigma / %")?)))?,
            sim,
            ablated,
        ),
        measure(
            "values within one stated deviation, mean of the quantities",
            pair(|part| Ok(format!("{:.0} %", error(part, "within 1 sigma / %")?)))?,
            sim,
            ablated,
        ),
        measure("**resolution** (1σ) F_x / F_y / F_z, each scan", sigmas, sim, measured),
        measure("resolution (1σ) x / y, each scan", place, sim, measured),
        measure("detection threshold", one("detection threshold", 0, "mN")?, sim, measured),
        measure("touch to 90 % of the force", one("settles within 10 %", 1, "ms")?, sim, measured),
        measure("touch to within 5 %", one("settles within 5 %", 1, "ms")?, sim, measured),
        measure(
            "**bandwidth**, 0.35 / rise from 10 to 90 %",
            one("bandwidth", 0, "Hz")?,
            sim,
            measured,
        ),
        measure(
            "**hysteresis**, third cycle of 2 s, of 2 N",
            one("hysteresis", 1, "%")?,
            sim,
            measured,
        ),
        measure(
            "**creep** in a minute, of the load",
            one("creep in a minute", 1, "%")?,
            sim,
            measured,
        ),
        measure(
            "**temperature**: change of 0.5 N; of 1.5 N, warmed by 10 K, uncompensated",
            pair(|part| {
                let [light, firm] =
                    ["0.5", "1.5"].map(|n| figure(part, &format!("warmed by 10 K at {n} N")));
                Ok(format!("{:.0} mN; {:.0} mN", light?, firm?))
            })?,
            sim,
            measured,
        ),
        measure(
            "devices behind accuracy; behind all else",
            pair(|part| {
                let of = [("finger", "reference finger"), ("part", part)];
                Ok(format!("{}; 1", ablation.cells(&of, "device")?.len()))
            })?,
            sim,
            ablated,
        ),
        unknown("drift over days; life", "–"),
        measure(
            "two contacts two pitches apart, found",
            ideal("two contacts two pitches apart, found")?,
            sim,
            "[ideal finger](accuracy.md#specification)",
        ),
    ]))
}

fn finger() -> Result<String> {
    let row = |quantity: &str, value: String, kind: &str, from: &str| {
        format!("| {quantity} | {value} | {kind} | {from} |")
    };
    let unknown = |quantity: &str| row(quantity, UNKNOWN.to_owned(), "–", "–");
    let converter = REFERENCE.converter;
    let skin = REFERENCE.skin;
    let pitch = f64::from(PITCH.0);
    let side = |count: usize| (count as f64 - 1.0) * pitch + skin.facet_mm;
    let touch = |column| cell(BOARD, "Load", "touch to the first byte, 4 kHz", column);
    let current = cell(BOARD, "Not verified on hardware", "supply", 2)?;
    let [usual, most] = {
        let (usual, most) = current.split_once(',').unwrap_or((&current, &current));
        [number(usual)?, number(most)?]
    };
    let memory =
        |column| cell("docs/boards/images.md", "The images and their memory", "stm32g431", column);
    let definition = "`scan_plan::finger::REFERENCE`";
    let drawing = "[mould](build-a-finger.md#2-the-skin)";
    let mounted = "[mount](build-a-finger.md#the-mount)";
    let board = "[board](boards/stm32g431.md)";
    let calculated = "calculated";
    Ok(lines([
        "| | value | kind | from |".to_owned(),
        "|---|---|---|---|".to_owned(),
        row("taxels", format!("{ROWS} × {COLS}, pitch {pitch} mm"), "design", "`taxel::scan`"),
        row("three-axis force sensors", format!("up to {SENSORS}"), "design", "`taxel::scan`"),
        row(
            "area of the taxels",
            format!("{:.1} mm × {:.1} mm", side(COLS), side(ROWS)),
            calculated,
            definition,
        ),
        row(
            "skin",
            format!(
                "{0} mm × {0} mm, {1} mm above the facets, {2} MPa",
                mould::SKIN_MM,
                skin.depth_mm,
                skin.young_mpa
            ),
            "design",
            drawing,
        ),
        row(
            "size of frame and skin",
            format!(
                "{0} mm × {0} mm × {1:.2} mm",
                mould::FRAME_MM,
                mould::frame_mm() + skin.depth_mm
            ),
            calculated,
            drawing,
        ),
        row("size of the board", "no layout yet".to_owned(), "–", board),
        row(
            "flange to surface, on the mount",
            format!("{:.2} mm", mount::reach()),
            calculated,
            mounted,
        ),
        unknown("mass"),
        row(
            "resolution of a facet's displacement",
            cell(BUDGET, "The signal chain", "that as displacement", 2)?,
            calculated,
            "[signal chain](front-end.md#the-signal-chain)",
        ),
        row(
            "converter",
            format!("{} bits, {} samples a reading", converter.bits, converter.oversampling),
            "data sheet",
            definition,
        ),
        row("scan rate, default", format!("{} Hz", converter.scan_hz), "design", definition),
        row(
            "scan rate, fastest at the default settle time",
            cell(BOARD, "Settle time and frame", "1 sample a reading, the fastest", 1)?,
            calculated,
            "[settle time](boards/stm32g431.md#settle-time-and-frame)",
        ),
        row(
            "frame rate, default",
            format!("{} Hz", Instrument::DEFAULT_RATE_HZ),
            "design",
            "`taxel::instrument`",
        ),
        row(
            "**latency**, touch to the first byte: mean; at most",
            format!("{}; {}", touch(2)?, touch(3)?),
            "emulated",
            "[load](boards/stm32g431.md#load)",
        ),
        row(
            "core's load, a frame every millisecond",
            cell(
                BOARD,
                "What a frame costs",
                "all that it does at the default, a frame every millisecond",
                2,
            )?,
            "emulated",
            "[cost of a frame](boards/stm32g431.md#what-a-frame-costs)",
        ),
        row(
            "**supply**",
            format!("USB, {USB_V} V; {} V inside", converter.range_v),
            "design",
            board,
        ),
        row(
            "current: usual; at most",
            format!("{usual} mA; {most} mA"),
            calculated,
            "[current](boards/stm32g431.md#current)",
        ),
        row(
            "power from USB: usual; at most",
            format!("{:.2} W; {:.2} W", usual * USB_V / 1e3, most * USB_V / 1e3),
            calculated,
            "[current](boards/stm32g431.md#current)",
        ),
        row(
            "**interface**",
            format!("USB CDC ACM, socket {}", cell(BOARD, "Bill of materials", "USB socket", 1)?),
            "design",
            "[protocol](protocol.md)",
        ),
        row(
            "controller, flash, RAM in use",
            format!(
                "{}; {} of {} KB; {} of {} KB",
                cell(BOARD, "Bill of materials", "controller", 1)?,
                memory(1)?,
                memory(2)?,
                memory(3)?,
                memory(4)?
            ),
            "linked image",
            "[images](boards/images.md)",
        ),
        unknown("operating temperature, humidity, protection"),
        row(
            "price of the parts",
            "not known: no quotes".to_owned(),
            "–",
            "[parts](boards/stm32g431.md#bill-of-materials)",
        ),
    ]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_line_says_its_kind_and_source() {
        let known = ["simulated", "calculated", "emulated", "data sheet", "design", "linked image"];
        for (name, part) in parts().unwrap() {
            let rows: Vec<&str> = part.lines().skip(2).collect();
            assert!(rows.len() > 15, "{name}");
            for line in rows {
                let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
                let (kind, from) = (cells[cells.len() - 2], cells[cells.len() - 1]);
                let unknown = line.contains(UNKNOWN)
                    || line.contains("not known")
                    || line.contains("no layout");
                assert!(known.contains(&kind) && from != "–" || unknown, "{line}");
            }
        }
    }
}
