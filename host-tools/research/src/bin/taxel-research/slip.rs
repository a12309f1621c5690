//! Slip of the reference finger, into host-tools/research/data/slip.csv and docs/accuracy.md.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use clap::Args;
use taxel_research::{Waiting, slip};

use crate::{root, with_part};

/// Counts warnings and reports of slip of the reference finger, and false ones, into
/// host-tools/research/data/slip.csv and docs/accuracy.md
#[derive(Args)]
pub struct Slip {
    /// Only draw the table from the CSV file that is there
    #[arg(long)]
    draw: bool,
}

fn csv() -> PathBuf {
    root().join("host-tools/research/data/slip.csv")
}

fn page() -> PathBuf {
    root().join("docs/accuracy.md")
}

/// Measures, unless the table is only to be drawn, and draws it.
pub fn run(arguments: &Slip) -> Result<()> {
    if !arguments.draw {
        let progress = |_: f64, what: &str| eprintln!("{what}");
        let waiting = Waiting { progress: &progress, stop: &AtomicBool::new(false) };
        slip::write_table(&slip::measure(waiting)?, &csv())?;
    }
    Ok(std::fs::write(page(), drawn()?)?)
}

/// Returns the page with the table of the CSV file.
fn drawn() -> Result<String> {
    let rows = slip::parse(&std::fs::read_to_string(csv())?)?;
    with_part(&std::fs::read_to_string(page())?, "slip", &slip::section(&rows))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_has_the_table_of_slip() {
        let text = std::fs::read_to_string(page()).unwrap();
        assert!(text == drawn().unwrap(), "draw it with `taxel-research slip --draw`");
    }
}
