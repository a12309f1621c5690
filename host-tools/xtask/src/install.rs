//! Cost of an installation as docs/getting-started.md states it, crates and size of the program,
//! and the crates of the two libraries as ARCHITECTURE.md states them.

use anyhow::{Context, Result, ensure};

use crate::run::root;

const PAGE: &str = "docs/getting-started.md";
/// Relative tolerance of sizes, because another compiler's code differs a little.
const MARGIN: f64 = 0.05;
/// Row of the command as it is released.
pub const RELEASED: &str = "the same without symbols, as released";

/// Returns the cells of a row of the page's table, behind its first.
fn row(build: &str) -> Result<Vec<String>> {
    let page = std::fs::read_to_string(root().join(PAGE)).context(PAGE)?;
    let row = page.lines().find_map(|line| line.strip_prefix(&format!("| {build} | ")));
    let row = row.with_context(|| format!("{PAGE}: no row `| {build} | …`"))?;
    Ok(row.split('|').map(|cell| cell.trim().to_owned()).collect())
}

/// Fails where the released program's size in bytes differs from the page's.
pub fn size_agrees(bytes: u64) -> Result<()> {
    let stated = row(RELEASED)?.get(1).and_then(|cell| cell.split(' ').next()?.parse::<f64>().ok());
    let (stated, found) = (stated.unwrap_or_default(), bytes as f64 / f64::from(1 << 20));
    ensure!(
        (stated - found).abs() <= MARGIN * found,
        "{PAGE}: the row {RELEASED} should say {found:.1} MB, not {stated} MB"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::run::{cargo, lines, locked};

    /// Builds of the page's table: its first cell, and cargo's features.
    const BUILDS: [(&str, &[&str]); 6] = [
        ("`cargo demo`", &["--no-default-features"]),
        ("`cargo install --path host-tools/cli`", &[]),
        (RELEASED, &[]),
        ("the same with `--features foxglove`", &["--features", "foxglove"]),
        ("the same with `--features zenoh`", &["--features", "zenoh"]),
        ("the same with `--features zenoh,foxglove`", &["--features", "zenoh,foxglove"]),
    ];

    /// Counts the crates that a build compiles on Linux, without those of the tests.
    fn crates(package: &str, features: &[&str]) -> usize {
        let mut tree = cargo();
        tree.args(["tree", "--quiet", "--package", package, "--edges", "normal,build"]);
        tree.args(["--prefix", "none", "--format", "{p}", "--no-dedupe"]).args(features);
        tree.args(["--target", "x86_64-unknown-linux-gnu"]).args(locked());
        let listed = lines(&mut tree).unwrap();
        let name = |line: &String| line.split(' ').take(2).collect::<Vec<_>>().join(" ");
        listed.iter().map(name).collect::<BTreeSet<_>>().len()
    }

    #[test]
    fn crates_of_each_build_are_those_of_the_page() {
        for (build, features) in BUILDS {
            let found = crates("taxel-cli", features).to_string();
            assert_eq!(row(build).unwrap()[0], found, "{PAGE}: the row {build}");
        }
    }

    #[test]
    fn crates_of_core_and_client_are_those_of_the_rooms() {
        let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
        // Without the package itself.
        let [bare, core, client] =
            [("taxel", &["--no-default-features"][..]), ("taxel", &[]), ("taxel-client", &[])]
                .map(|(package, features)| crates(package, features) - 1);
        assert!(bare <= 20 && core <= 30 && client <= 30, "{bare}, {core}, {client}");
        for (room, crates) in [
            ("src/", format!("{bare} crates, {core} with default features")),
            ("host-tools/client", format!("core; {client} crates in all")),
        ] {
            let row = page.lines().find(|line| line.starts_with(&format!("| `{room}` |")));
            let row = row.unwrap_or_else(|| panic!("ARCHITECTURE.md: no row `{room}`"));
            assert!(row.ends_with(&format!("| {crates} |")), "should end `{crates}`: {row}");
        }
    }

    #[test]
    fn size_beyond_the_margin_is_refused() {
        let stated = row(RELEASED).unwrap()[1].split(' ').next().unwrap().parse::<f64>().unwrap();
        let bytes = |times: f64| (times * stated * f64::from(1 << 20)) as u64;
        assert!(size_agrees(bytes(1.0)).is_ok() && size_agrees(bytes(1.04)).is_ok());
        assert!(size_agrees(bytes(1.08)).is_err() && size_agrees(bytes(0.9)).is_err());
    }
}
