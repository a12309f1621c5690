//! Slip of the reference finger, into host-tools/research/data/slip.csv, its chart and its table.

use anyhow::Result;
use clap::Args;
use taxel_research::{slip, table};

use crate::root;
use crate::table::{Table, measured};

/// Counts warnings and reports of slip of the reference finger, and false ones, into
/// host-tools/research/data/slip.csv, docs/images/slip.svg and docs/accuracy.md
#[derive(Args)]
pub struct Slip {
    /// Only draw chart and table from the CSV file that is there
    #[arg(long)]
    draw: bool,
}

pub const TABLE: Table = Table {
    task: "slip",
    page: "docs/accuracy.md",
    section: |csv| Ok(slip::section(&table::parse(csv)?)),
};

/// Measures, unless the table is only to be drawn, and draws chart and table.
pub fn run(arguments: &Slip) -> Result<()> {
    let path = TABLE.csv();
    if !arguments.draw {
        table::write(&measured(slip::measure)?, &path)?;
    }
    let rows = table::parse(&std::fs::read_to_string(&path)?)?;
    slip::write_chart(&rows, &root().join("docs/images/slip.svg"))?;
    TABLE.draw()
}
