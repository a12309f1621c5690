//! Bench protocol of half a day, from the lists of the boards' pages.

use anyhow::{Context, Result, ensure};
use scan_plan::finger::REFERENCE;
use scan_plan::{f411, g431};
use taxel::scan::ScanSettings;

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
struct Step {
    name: String,
    minutes: u32,
    check: String,
    bench: String,
    expected: String,
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
        steps.push(Step { name, minutes, check, bench, expected });
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

/// Steps of the finger on a board, with what the reference finger does in simulation.
fn finger() -> Result<Vec<Step>> {
    let (figures, labels) = (Csv::read(FIGURES)?, Csv::read(LABELS)?);
    let both = |name: &str, digits: usize, unit: &str| {
        let of = |part| figures.mean(&[("figure", name), ("part", part)], "value");
        let [all, matrix] = [of("both")?, of("matrix")?];
        let words = format!("{all:.digits$} {unit} (matrix alone {matrix:.digits$} {unit})");
        Ok::<_, anyhow::Error>(words.replace('-', "−"))
    };
    let error = |part, column| labels.mean(&[("labels", CELL), ("part", part)], column);
    let errors = |part| {
        let axes = ["fx / mN", "fy / mN", "fz / mN"].map(|axis| error(part, axis));
        let [x, y, z] = axes;
        Ok::<_, anyhow::Error>(format!("{:.0} / {:.0} / {:.0} mN", x?, y?, z?))
    };
    let front = "docs/front-end.md";
    let rest = cell(front, "The signal chain", "steps of 12 bits", 2)?;
    let room = "room light left after the dark step is subtracted";
    let room = cell(front, "What the circuit simulation says", room, 2)?;
    let place = error("both", "point middle / mm")?;
    let [product, f411] = full_scales()?.map(spaced);
    let at_rest = format!(
        "`taxel record --fields codes --duration 10 --out rest.csv`; each `lit_…` less its `dark_…`, × 4096 / the full \
         scale of `taxel info` ({product} with the default scan, {f411} on the STM32F411)"
    );
    let steps = [
        (
            2,
            "every channel",
            "`taxel self-test`, nothing touching, in the dark",
            "exit code 0, no channel named".to_owned(),
        ),
        (5, "light at rest", &at_rest, format!("{rest}, within a half of it")),
        (
            5,
            "room light",
            "the same with a lamp on and off",
            format!("`dark_…` moves; `lit_…` less `dark_…` by {room} of that"),
        ),
        (
            10,
            "wiring and gap",
            "`taxel view`, a pen over each taxel and each force sensor",
            "its own square turns blue, none orange; its circle fills".to_owned(),
        ),
        (
            20,
            "calibration",
            "`taxel record --fields codes --duration 60 --out presses.mcap` and the load cell's log, three times; \
             fit two of them",
            "the fit ends without refusal".to_owned(),
        ),
        (
            5,
            "accuracy",
            "`taxel calibrate evaluate --data unseen.mcap --reference unseen-cell.csv --calibration finger.toml`",
            format!(
                "F_x / F_y / F_z {} (matrix alone {}); place {place:.2} mm, if the cell's log has it",
                errors("both")?,
                errors("matrix")?
            ),
        ),
        (
            3,
            "resolution",
            "100 g lying still, `taxel record --fields force,point --duration 10 --out held.csv`; standard deviations",
            format!("F_z {}", both("sigma fz_n", 1, "mN")?),
        ),
        (
            3,
            "creep",
            "100 g for a minute, `taxel record --fields force --duration 70 --out creep.csv`",
            format!("{} of the load", both("creep in a minute", 1, "%")?),
        ),
        (
            3,
            "step",
            "100 g taken off by its thread, `taxel record --rate 4000 --fields force --duration 5 --out step.csv`",
            format!("90 % after {}; then zero", both("settles within 10 %", 1, "ms")?),
        ),
        (
            15,
            "temperature",
            "100 g at room temperature and 10 K warmer, `taxel record --fields force,codes --duration 60 --out warm.csv` each",
            format!(
                "changes by {} at 0.5 N, {} at 1.5 N",
                both("warmed by 10 K at 0.5 N", 0, "mN")?,
                both("warmed by 10 K at 1.5 N", 0, "mN")?
            ),
        ),
    ];
    let numbered = steps.into_iter().enumerate().map(|(at, (minutes, check, bench, expected))| {
        let (name, check, bench) = (format!("F{}", at + 1), check.to_owned(), bench.to_owned());
        Step { name, minutes, check, bench, expected }
    });
    Ok(numbered.collect())
}

/// Path of a board's form.
fn form(board: &str) -> String {
    format!("docs/bench-{board}.csv")
}

/// Blank results of a board: a row for each step of the board and of the finger.
fn blank(board: &str) -> Result<Vec<u8>> {
    let head = format!("# board={board}\n# serial=\n# firmware=\n# date=\n# by=\n");
    let mut writer = csv::Writer::from_writer(head.into_bytes());
    writer.write_record(["step", "check", "expected", "measured", "unit", "passed", "note"])?;
    for Step { name, check, expected, .. } in steps(board)?.into_iter().chain(finger()?) {
        writer.write_record([&name, &check, &expected, "", "", "", ""])?;
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
            step.expected.starts_with(&format!("{:.0}, ", 4096.0 * light)),
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
    fn form_has_a_row_for_each_step() {
        let form = blank("stm32g431").unwrap();
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(&form[..]);
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        let expected = steps("stm32g431").unwrap().len() + finger().unwrap().len();
        assert!(rows.len() == expected && expected > 30, "{} {expected}", rows.len());
        assert!(rows.iter().all(|row| row.len() == 7 && !row[2].is_empty()));
    }
}
