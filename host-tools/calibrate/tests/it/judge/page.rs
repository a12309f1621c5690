//! Required figures and their results, as listed in `docs/accuracy.md`.

/// Requirement, its value, and the results of matrix alone, force sensors alone and both.
pub type Row<'r> = (&'r str, &'r str, [String; 3]);

/// Asserts that the page has these rows in its table.
pub fn tells(rows: &[Row<'_>]) {
    let rows = rows.iter().map(|(what, specified, reached)| {
        format!("\n| {what} | {specified} | {} |\n", reached.join(" | "))
    });
    has(&rows.collect::<Vec<_>>());
}

/// Asserts that the page has these texts.
pub fn has(texts: &[String]) {
    const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/accuracy.md");
    let page = std::fs::read_to_string(PAGE).unwrap();
    let missing: Vec<&str> =
        texts.iter().filter(|text| !page.contains(*text)).map(|text| text.trim()).collect();
    assert!(missing.is_empty(), "docs/accuracy.md lacks:\n{}", missing.join("\n"));
}

/// Entry for a figure that a sensor cannot measure.
pub const NONE: &str = "–";
