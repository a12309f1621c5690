//! Effects of a real finger against scenes, into host-tools/research/data/effects.csv and
//! docs/simulator.md.

use anyhow::Result;
use clap::Args;
use taxel_research::effects;

use crate::table::{Table, measured};

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
        effects::write_table(&measured(effects::measure)?, &TABLE.csv())?;
    }
    TABLE.draw()
}
