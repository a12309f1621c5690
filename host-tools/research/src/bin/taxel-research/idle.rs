//! Touches told while nothing touches, into host-tools/research/data/idle.csv and docs/accuracy.md.

use std::sync::atomic::AtomicBool;

use anyhow::Result;
use clap::Args;
use taxel_research::{Waiting, idle};

use crate::table::Table;

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
    section: |csv| Ok(idle::section(&idle::parse(csv)?)),
};

/// Measures, unless the table is only to be drawn, and draws it.
pub fn run(arguments: &Idle) -> Result<()> {
    if !arguments.draw {
        let progress = |share: f64, what: &str| eprintln!("{:3.0} %  {what}", 100.0 * share);
        let waiting = Waiting { progress: &progress, stop: &AtomicBool::new(false) };
        idle::write_table(&idle::measure(waiting)?, &TABLE.csv())?;
    }
    TABLE.draw()
}
