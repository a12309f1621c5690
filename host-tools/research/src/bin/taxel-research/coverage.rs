//! Coverage of the stated uncertainty, into host-tools/research/data/coverage.csv and risk.csv,
//! their pictures and docs/accuracy.md.

use anyhow::Result;
use clap::Args;
use taxel_research::{coverage, table};

use crate::root;
use crate::table::{Table, measured};

/// Judges the uncertainty that the reference finger states, under disturbances, into
/// host-tools/research/data/coverage.csv and risk.csv, docs/images and docs/accuracy.md
#[derive(Args)]
pub struct Coverage {
    /// Only draw pictures and table from the CSV files that are there
    #[arg(long)]
    draw: bool,
}

pub const TABLE: Table = Table {
    task: "coverage",
    page: "docs/accuracy.md",
    section: |csv| Ok(coverage::section(&table::parse(csv)?)),
};

/// Measures, unless it is only to be drawn, and draws.
pub fn run(arguments: &Coverage) -> Result<()> {
    let (path, risks) = (TABLE.csv(), TABLE.csv().with_file_name("risk.csv"));
    if !arguments.draw {
        let (covered, risk) = measured(coverage::measure)?;
        table::write(&covered, &path)?;
        table::write(&risk, &risks)?;
    }
    let images = root().join("docs/images");
    let covered = table::parse(&std::fs::read_to_string(&path)?)?;
    coverage::write_coverage(&covered, &images.join("coverage.svg"))?;
    let risk = table::parse(&std::fs::read_to_string(&risks)?)?;
    coverage::write_risk(&risk, &images.join("risk.svg"))?;
    TABLE.draw()
}
