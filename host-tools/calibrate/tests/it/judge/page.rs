//! Required figures and their results, as listed in `docs/accuracy.md`.

/// Requirement, its value, and the results of matrix alone, force sensors alone and both.
pub type Row<'r> = (&'r str, &'r str, [String; 3]);

/// Asserts that the page has these rows in its table.
pub fn tells(rows: &[Row<'_>]) {
    const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/accuracy.md");
    let page = std::fs::read_to_string(PAGE).unwrap();
    let lines = rows
        .iter()
        .map(|(what, asked, reached)| format!("| {what} | {asked} | {} |", reached.join(" | ")));
    let missing: Vec<String> = lines.filter(|row| !page.lines().any(|line| line == row)).collect();
    assert!(missing.is_empty(), "docs/accuracy.md lacks these rows:\n{}", missing.join("\n"));
}

/// Entry for a figure that a sensor cannot measure.
pub const NONE: &str = "–";
