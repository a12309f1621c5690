//! Effects of a real finger against scenes, into host-tools/research/data/effects.csv and
//! docs/simulator.md.

use std::sync::atomic::AtomicBool;

use anyhow::Result;
use clap::Args;
use taxel_research::{Waiting, effects};

use crate::table::Table;

/// Runs the reference finger without each of its effects, and shows by how many stated standard
/// deviations its estimates move, into host-tools/research/data/effects.csv and docs/simulator.md
#[derive(Args)]
pub struct Effects {
    /// Only draw the table from the CSV file that is there
    #[arg(long)]
    draw: bool,
}

pub const TABLE: Table = Table {
    task: "effects",
    page: "docs/simulator.md",
    section: |csv| Ok(effects::section(&effects::parse(csv)?)),
};

/// Measures, unless the table is only to be drawn, and draws it.
pub fn run(arguments: &Effects) -> Result<()> {
    if !arguments.draw {
        let progress = |share: f64, what: &str| eprintln!("{:3.0} %  {what}", 100.0 * share);
        let waiting = Waiting { progress: &progress, stop: &AtomicBool::new(false) };
        effects::write_table(&effects::measure(waiting)?, &TABLE.csv())?;
    }
    TABLE.draw()
}
