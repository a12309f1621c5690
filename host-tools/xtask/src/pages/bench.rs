//! Bench protocol of half a day, from the lists of the boards' pages.

mod limits;

use anyhow::{Context, Result, ensure};
use scan_plan::finger::REFERENCE;
use scan_plan::{f411, g431};
use taxel::scan::ScanSettings;

use self::limits::{Limits, Reading, readings};
use super::reference::{CELL, FIGURES, LABELS};
use super::tables::{Csv, cell, read};
use crate::marks::{self, Part};
use crate::run::root;

/// Page of the protocol.
pub const PAGE: &str = "docs/bench-protocol.md";

/// Boards whose pages have a list of bench checks.
const BOARDS: [&str; 2] = ["stm32g431", "stm32f411"];

/// Rows of the boards' lists in the order of the bench, with minutes at it; 0 runs unattended.
///
/// A name is the beginning of a check's name on a board's page.
const ORDER: [(&str, u32); 36] = [
    ("ROM bootloader by BOOT0", 5),
    ("supply", 5),
    ("serial number", 2),
    ("core voltage", 2),
    ("flash accelerator", 2),
    ("sectors 1 … 4 free of code", 2),
    ("reset causes", 8),
    ("the ADC's trigger", 1),
    ("row order", 10),
    ("LED current", 10),
    ("pattern", 5),
    ("settle time", 10),
    ("amplifier inputs turn", 5),
    ("amplifier gain", 5),
    ("midpoints", 5),
    ("bias is gone", 3),
    ("reference, temperature", 5),
    ("temperature and reference", 5),
    ("noise floor", 3),
    ("throughput", 5),
    ("cycles a frame", 3),
    ("nobody reads", 3),
    ("suspend", 3),
    ("halted endpoint", 3),
    ("re-plug", 3),
    ("settings over power-off", 3),
    ("page erasure", 5),
    ("sector erasure", 5),
    ("power cut in an upload", 15),
    ("overrun of", 3),
    ("watchdog", 3),
    ("debugger", 3),
    ("panic", 3),
    ("ROM bootloader by command", 3),
    ("HSI16", 0),
    ("USB, 25 MHz", 0),
];

/// Last of the unattended checks of the product.
const CRYSTAL_LESS: &str = "crystal-less USB";

/// Row of the protocol.
#[derive(Clone)]
struct Step {
    name: String,
    minutes: u32,
    check: String,
    bench: String,
    expected: String,
    /// Parts of the expectation, each with a row of the form.
    readings: Vec<Reading>,
}

/// Rows of a page's table below a heading: three cells each.
fn rows(page: &str, heading: &str) -> Result<Vec<[String; 3]>> {
    let text = read(page)?;
    let below = text.lines().skip_while(|line| line.trim_start_matches('#').trim() != heading);
    let below = below.skip(1).take_while(|line| !line.starts_with('#'));
    let table = below.filter(|line| line.starts_with('|')).skip(2);
    let mut rows: Vec<[String; 3]> = Vec::new();
    for line in table {
        let cells = line.trim_matches('|').split(" | ").map(|cell| cell.trim().to_owned());
        let cells: Vec<String> = cells.collect();
        let [check, bench, expected] = <[String; 3]>::try_from(cells)
            .map_err(|_| anyhow::anyhow!("{page}: not three cells: {line}"))?;
        // In another order, "the same" would mean another row.
        let same = expected
            .strip_prefix("the same")
            .filter(|rest| rest.is_empty() || rest.starts_with(';'));
        let expected = match (same, rows.last()) {
            (Some(rest), Some([.., before])) => format!("{before}{rest}"),
            _ => expected,
        };
        rows.push([check, bench, expected]);
    }
    Ok(rows)
}

/// Steps of a board in order; every check of its page is one.
fn steps(board: &str) -> Result<Vec<Step>> {
    let page = format!("docs/boards/{board}.md");
    let mut checks = rows(&page, "Not verified on hardware")?;
    let mut steps = Vec::new();
    for (begin, minutes) in ORDER.into_iter().chain([(CRYSTAL_LESS, 0)]) {
        let Some(at) = checks.iter().position(|[check, ..]| check.starts_with(begin)) else {
            continue;
        };
        let [check, bench, expected] = checks.remove(at);
        let name = format!("B{}", steps.len() + 1);
        let readings = readings(&expected);
        steps.push(Step { name, minutes, check, bench, expected, readings });
    }
    let left: Vec<&String> = checks.iter().map(|[check, ..]| check).collect();
    ensure!(left.is_empty(), "{page}: {left:?} have no place in the order of pages/bench.rs");
    Ok(steps)
}

/// Tables of the boards and of the finger, for the page.
pub fn parts() -> Result<Vec<Part>> {
    let mut parts = Vec::new();
    for board in BOARDS {
        let page = format!("boards/{board}.md#not-verified-on-hardware");
        parts.push((board, table(&steps(board)?, |check| format!("[{check}]({page})"))));
    }
    parts.push(("finger", table(&finger()?, str::to_owned)));
    Ok(parts)
}

fn table(steps: &[Step], check: impl Fn(&str) -> String) -> String {
    let mut out = "| step | minutes | check | on the bench | expected | measured |\n|---|---|---|---|---|---|\n"
        .to_owned();
    for step in steps {
        let Step { name, minutes, bench, expected, .. } = step;
        let minutes = if *minutes == 0 { "alone".to_owned() } else { minutes.to_string() };
        let check = check(&step.check);
        out += &format!("| {name} | {minutes} | {check} | {bench} | {expected} | |\n");
    }
    let all: u32 = steps.iter().map(|step| step.minutes).sum();
    out + &format!("\nAt the bench: {all} minutes.\n")
}

/// Full scales of the product and of the STM32F411 in their default scans.
fn full_scales() -> Result<[u16; 2]> {
    let settings = REFERENCE.converter.settings();
    let single = ScanSettings { oversampling: 1, ..settings };
    let refused = |refusal| anyhow::anyhow!("default scan: {refusal:?}");
    let product = g431::plan(settings).map_err(refused)?.full_scale;
    Ok([product, f411::plan(single).map_err(refused)?.full_scale])
}

/// Code with a space before its thousands, if it has five digits.
fn spaced(code: u16) -> String {
    if code < 10_000 { code.to_string() } else { format!("{} {:03}", code / 1000, code % 1000) }
}

/// Figures of the simulated reference finger: with force sensors, and the matrix alone.
struct Simulated {
    both: f64,
    matrix: f64,
    unit: &'static str,
}

impl Simulated {
    /// Text with both figures.
    fn text(&self, digits: usize) -> String {
        let Self { both, matrix, unit } = self;
        format!("{both:.digits$} {unit} (matrix alone {matrix:.digits$} {unit})")
    }

    /// Row of the form: at most [`WORSE`] times the figure, and what noise adds to it.
    fn reading(&self, name: &str, digits: usize, noise: [f64; 2]) -> Reading {
        let limit = |figure: f64, noise: f64| three_digits(WORSE * figure + noise);
        let (max, matrix_max) = (limit(self.both, noise[0]), limit(self.matrix, noise[1]));
        let unit = self.unit.to_owned();
        let limits = Limits { min: 0.0, max, matrix_max: Some(matrix_max), unit };
        Reading { expected: format!("{name} {}", self.text(digits)), limits: Some(limits) }
    }
}

/// Largest figure of a real finger, of that of the simulated one.
const WORSE: f64 = 1.5;
/// Weight of the creep's load in newtons: 100 g.
const WEIGHT_N: f64 = 0.981;

/// Number with three significant digits.
fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// Steps of the finger on a board, with what the reference finger does in simulation.
fn finger() -> Result<Vec<Step>> {
    let (figures, labels) = (Csv::read(FIGURES)?, Csv::read(LABELS)?);
    let simulated = |name: &str, unit| {
        let of = |part| figures.mean(&[("figure", name), ("part", part)], "value").map(f64::abs);
        Ok::<_, anyhow::Error>(Simulated { both: of("both")?, matrix: of("matrix")?, unit })
    };
    let error = |column: &str, unit| {
        let of = |part| labels.mean(&[("labels", CELL), ("part", part)], column);
        Ok::<_, anyhow::Error>(Simulated { both: of("both")?, matrix: of("matrix")?, unit })
    };
    let front = "docs/front-end.md";
    let rest = cell(front, "The signal chain", "steps of 12 bits", 2)?;
    let room = "room light left after the dark step is subtracted";
    let room = cell(front, "What the circuit simulation says", room, 2)?;
    let [product, f411] = full_scales()?.map(spaced);
    let at_rest = format!(
        "`taxel record --fields codes --duration 10 --out rest.csv`; each `lit_…` less its `dark_…`, × 4096 / the full \
         scale of `taxel info` ({product} with the default scan, {f411} on the STM32F411)"
    );
    let sigma = simulated("sigma fz_n", "mN")?;
    let creep = simulated("creep in a minute", "%")?;
    // Three standard deviations of the difference of two readings.
    let noise = [sigma.both, sigma.matrix]
        .map(|sigma| 3.0 * f64::sqrt(2.0) * sigma / (1e3 * WEIGHT_N) * 100.0);
    let accuracy = [
        error("fx / mN", "mN")?.reading("F_x", 0, [0.0; 2]),
        error("fy / mN", "mN")?.reading("F_y", 0, [0.0; 2]),
        error("fz / mN", "mN")?.reading("F_z", 0, [0.0; 2]),
        error("point middle / mm", "mm")?.reading("place, if the cell's log has it,", 2, [0.0; 2]),
    ];
    let step = simulated("settles within 10 %", "ms")?.reading("90 % after", 1, [0.0; 2]);
    let warmed = |n: &str| {
        let figure = simulated(&format!("warmed by 10 K at {n} N"), "mN")?;
        Ok::<_, anyhow::Error>(figure.reading(&format!("a load of {n} N changes by"), 0, [0.0; 2]))
    };
    let steps = [
        (
            2,
            "every channel",
            "`taxel self-test`, nothing touching, in the dark",
            readings("exit code 0, no channel named"),
        ),
        (5, "light at rest", &at_rest, readings(&format!("{rest} codes, within 50 %"))),
        (
            5,
            "room light",
            "the same with a lamp on and off",
            readings(&format!("`dark_…` moves; `lit_…` less `dark_…` by at most {room} of that")),
        ),
        (
            10,
            "wiring and gap",
            "`taxel view`, a pen over each taxel and each force sensor",
            readings("its own square turns blue, none orange; its circle fills"),
        ),
        (
            20,
            "calibration",
            "`taxel record --fields codes --duration 60 --out presses.mcap` and the load cell's log, three times; \
             fit two of them",
            readings("the fit ends without refusal"),
        ),
        (
            5,
            "accuracy",
            "`taxel calibrate evaluate --data unseen.mcap --reference unseen-cell.csv --calibration finger.toml`",
            accuracy.to_vec(),
        ),
        (
            3,
            "resolution",
            "100 g lying still, `taxel record --fields force,point --duration 10 --out held.csv`; standard deviations",
            vec![sigma.reading("F_z", 1, [0.0; 2])],
        ),
        (
            3,
            "creep",
            "100 g for a minute, `taxel record --fields force --duration 70 --out creep.csv`",
            vec![creep.reading("the load changes by", 1, noise)],
        ),
        (
            3,
            "step",
            "100 g taken off by its thread, `taxel record --rate 4000 --fields force --duration 5 --out step.csv`",
            [vec![step], readings("then zero")].concat(),
        ),
        (
            15,
            "temperature",
            "100 g at room temperature and 10 K warmer, `taxel record --fields force,codes --duration 60 --out warm.csv` each",
            vec![warmed("0.5")?, warmed("1.5")?],
        ),
    ];
    let numbered = steps.into_iter().enumerate().map(|(at, (minutes, check, bench, readings))| {
        let (name, check, bench) = (format!("F{}", at + 1), check.to_owned(), bench.to_owned());
        let parts = readings.iter().map(|reading| reading.expected.as_str());
        let expected = parts.collect::<Vec<_>>().join("; ");
        Step { name, minutes, check, bench, expected, readings }
    });
    Ok(numbered.collect())
}

/// Path of a board's form.
fn form(board: &str) -> String {
    format!("docs/bench-{board}.csv")
}

/// First lines of a form behind the board, for whoever fills it in.
const HEAD: &str = "# serial=\n# firmware=\n# commit=\n# force_sensors=\n# date=\n# by=\n";
const COLUMNS: [&str; 10] =
    ["step", "check", "expected", "min", "max", "matrix_max", "unit", "measured", "passed", "note"];

/// Blank results of a board: a row for each reading of the board's steps and of the finger's.
fn blank(board: &str) -> Result<Vec<u8>> {
    let head = format!("# board={board}\n{HEAD}");
    let mut writer = csv::Writer::from_writer(head.into_bytes());
    writer.write_record(COLUMNS)?;
    for Step { name, check, readings, .. } in steps(board)?.into_iter().chain(finger()?) {
        let several = readings.len() > 1;
        for (letter, Reading { expected, limits }) in ('a'..).zip(readings) {
            let step = if several { format!("{name}{letter}") } else { name.clone() };
            let limits = limits.map(|limits| {
                let matrix = limits.matrix_max.map(|max| max.to_string()).unwrap_or_default();
                [limits.min.to_string(), limits.max.to_string(), matrix, limits.unit]
            });
            let [min, max, matrix, unit] = limits.unwrap_or_default();
            writer
                .write_record([&step, &check, &expected, &min, &max, &matrix, &unit, "", "", ""])?;
        }
    }
    writer.into_inner().context("blank form")
}

/// Writes the blank forms; returns those that differed.
pub fn update(check: bool) -> Result<Vec<String>> {
    let mut different = Vec::new();
    for board in BOARDS {
        if marks::whole(&root().join(form(board)), &blank(board)?, check)? {
            different.push(form(board));
        }
    }
    Ok(different)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Minutes of half a day.
    const HALF_A_DAY: u32 = 240;

    #[test]
    fn protocol_takes_half_a_day() {
        let finger: u32 = finger().unwrap().iter().map(|step| step.minutes).sum();
        for board in BOARDS {
            let attended: u32 = steps(board).unwrap().iter().map(|step| step.minutes).sum();
            assert!(attended + finger <= HALF_A_DAY, "{board}: {attended} + {finger} minutes");
        }
    }

    #[test]
    fn light_at_rest_is_read_on_the_boards_scale() {
        let [product, single] = full_scales().unwrap();
        assert_eq!([product, single], [8 * 4095, 4095]);
        let step = &finger().unwrap()[1];
        assert!(step.bench.contains("× 4096 / the full scale"), "{}", step.bench);
        for full in [product, single] {
            assert!(step.bench.contains(&spaced(full)), "{}", step.bench);
        }
        let light = REFERENCE.share(REFERENCE.pair.rest_a()) - REFERENCE.share(0.0);
        assert!(
            step.expected.starts_with(&format!("{:.0} codes, ", 4096.0 * light)),
            "{}",
            step.expected
        );
        // Builders read it on their page, too.
        let page = read("docs/build-a-finger.md").unwrap();
        let page = page.split_whitespace().collect::<Vec<_>>().join(" ");
        let code = REFERENCE.share(REFERENCE.pair.rest_a()) * f64::from(product);
        let code = 10 * (code / 10.0).round() as u16;
        let full = spaced(product);
        assert!(page.contains(&format!("{} of {full}", spaced(code))), "{code}");
        assert!(page.contains(&format!("full scale: {full} with the default scan")));
    }

    #[test]
    fn form_has_a_row_for_each_reading() {
        let form = blank("stm32g431").unwrap();
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(&form[..]);
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        let steps = [steps("stm32g431").unwrap(), finger().unwrap()].concat();
        let expected: usize = steps.iter().map(|step| step.readings.len()).sum();
        assert!(rows.len() == expected && expected > steps.len(), "{} {expected}", rows.len());
        assert!(rows.iter().all(|row| row.len() == COLUMNS.len() && !row[2].is_empty()));
        let limits = |step: &str| {
            let row = rows.iter().find(|row| &row[0] == step).unwrap();
            [3, 4, 5, 6].map(|at| row[at].to_owned())
        };
        assert_eq!(limits("B2"), ["0", "53", "", "mA"]);
        assert_eq!(limits("B16b"), ["0", "0", "", "frames lost"]);
        assert_eq!(limits("F7"), ["0", "2.84", "11.6", "mN"]);
        assert_eq!(limits("B19"), ["", "", "", ""]);
    }
}
