//! Effects of a real finger against scenes, into host-tools/research/data/effects.csv and
//! docs/simulator.md.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use clap::Args;
use taxel_research::{Waiting, effects};

use crate::{root, with_part};

/// Runs the reference finger without each of its effects, and shows by how many stated standard
/// deviations its estimates move, into host-tools/research/data/effects.csv and docs/simulator.md
#[derive(Args)]
pub struct Effects {
    /// Only draw the table from the CSV file that is there
    #[arg(long)]
    draw: bool,
}

fn csv() -> PathBuf {
    root().join("host-tools/research/data/effects.csv")
}

fn page() -> PathBuf {
    root().join("docs/simulator.md")
}

/// Measures, unless the table is only to be drawn, and draws it.
pub fn run(arguments: &Effects) -> Result<()> {
    if !arguments.draw {
        let progress = |share: f64, what: &str| eprintln!("{:3.0} %  {what}", 100.0 * share);
        let waiting = Waiting { progress: &progress, stop: &AtomicBool::new(false) };
        effects::write_table(&effects::measure(waiting)?, &csv())?;
    }
    Ok(std::fs::write(page(), drawn()?)?)
}

/// Returns the page with the table of the CSV file.
fn drawn() -> Result<String> {
    let moved = effects::parse(&std::fs::read_to_string(csv())?)?;
    with_part(&std::fs::read_to_string(page())?, "effects", &effects::section(&moved))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_has_the_table_of_effects() {
        let text = std::fs::read_to_string(page()).unwrap();
        assert!(text == drawn().unwrap(), "draw it with `taxel-research effects --draw`");
    }
}
