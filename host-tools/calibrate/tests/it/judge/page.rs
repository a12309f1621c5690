//! The figures that were asked for, as `docs/accuracy.md` tells them.

/// What was asked for, how much of it, and what the matrix alone, the force sensors alone and both together reach.
pub type Row<'r> = (&'r str, &'r str, [String; 3]);

/// The page has these rows of its table.
pub fn tells(rows: &[Row<'_>]) {
    const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/accuracy.md");
    let page = std::fs::read_to_string(PAGE).unwrap();
    let lines = rows
        .iter()
        .map(|(what, asked, reached)| format!("| {what} | {asked} | {} |", reached.join(" | ")));
    let missing: Vec<String> = lines.filter(|row| !page.lines().any(|line| line == row)).collect();
    assert!(missing.is_empty(), "docs/accuracy.md lacks these rows:\n{}", missing.join("\n"));
}

/// Of what one of them cannot tell.
pub const NONE: &str = "–";
