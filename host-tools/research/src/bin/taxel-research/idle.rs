//! Touches told while nothing touches, into host-tools/research/data/idle.csv and docs/accuracy.md.

use anyhow::Result;
use clap::Args;
use taxel_research::{idle, table};

use crate::table::{Table, measured};

/// Counts frames with a contact of the reference finger while nothing touches it, and light,
/// warmth or LEDs change, into host-tools/research/data/idle.csv and docs/accuracy.md
#[derive(Args)]
pub struct Idle {
    /// Only draw the table from the CSV file that is there
    #[arg(long)]
    draw: bool,
}

pub const TABLE: Table = Table {
    task: "idle",
    page: "docs/accuracy.md",
    section: |csv| Ok(idle::section(&table::parse(csv)?)),
};

/// Measures, unless the table is only to be drawn, and draws it.
pub fn run(arguments: &Idle) -> Result<()> {
    if !arguments.draw {
        table::write(&measured(idle::measure)?, &TABLE.csv())?;
    }
    TABLE.draw()
}
