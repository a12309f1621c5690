//! Figures on the boards' pages, compared with the emulated images.
//!
//! `TAXEL_DRAW=1 cargo nextest run -j 1 -E 'test(budget) | test(load)'` writes them again.

use taxel_emulator::board::model::Model;

use crate::support::{name, repository};

/// Largest accepted difference: instructions differ between compiler versions.
const SHARE: f64 = 0.05;
/// Largest accepted difference of small figures and of percentages, in units of the figure.
const UNITS: f64 = 2.0;

/// First number in a cell, whose thousands are set apart.
fn number(cell: &str) -> Option<f64> {
    let digits: String = cell.chars().filter(|c| c.is_ascii_digit() || *c == '.').collect();
    digits.parse().ok()
}

/// Formats cycles with their thousands set apart.
pub fn thousands(cycles: u32) -> String {
    match cycles / 1000 {
        0 => format!("{cycles}"),
        thousands => format!("{thousands} {:03}", cycles % 1000),
    }
}

/// Compares the row `label` with `cells`, its first ones; returns the number in the cell behind.
///
/// # Panics
/// The page has no such row, or another figure.
pub fn row(board: Model, label: &str, cells: &[String]) -> Option<f64> {
    let path = repository().join("docs/boards").join(name(board)).with_extension("md");
    let page = std::fs::read_to_string(&path).unwrap();
    let begin = format!("| {label} |");
    let line = page.lines().find(|line| line.starts_with(&begin));
    let line = line.unwrap_or_else(|| panic!("{}: no row `{label}`", path.display()));
    let stated: Vec<&str> = line.split('|').skip(2).map(str::trim).collect();
    let behind = stated.get(cells.len()).copied().unwrap_or_default();
    if std::env::var_os("TAXEL_DRAW").is_some() {
        let rest = &stated[cells.len()..];
        let rest: String =
            rest.iter().filter(|cell| !cell.is_empty()).map(|c| format!(" {c} |")).collect();
        let drawn = format!("{begin} {} |{rest}", cells.join(" | "));
        std::fs::write(&path, page.replace(line, &drawn)).unwrap();
        return number(behind);
    }
    for (cell, stated) in cells.iter().zip(stated) {
        let (found, page) = (number(cell).unwrap(), number(stated).unwrap_or(f64::INFINITY));
        let most = if found > 100.0 { SHARE * found } else { UNITS };
        assert!((found - page).abs() <= most, "{label}: {cell}, the page says {stated}");
    }
    number(behind)
}
