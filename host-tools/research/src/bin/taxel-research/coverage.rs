//! Coverage of the stated uncertainty, into host-tools/research/data/coverage.csv and risk.csv,
//! their pictures and docs/accuracy.md.

use std::sync::atomic::AtomicBool;

use anyhow::Result;
use clap::Args;
use taxel_research::{Waiting, coverage};

use crate::root;
use crate::table::Table;

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
    section: |csv| Ok(coverage::section(&coverage::parse(csv)?)),
};

/// Measures, unless it is only to be drawn, and draws.
pub fn run(arguments: &Coverage) -> Result<()> {
    let (path, risks) = (TABLE.csv(), TABLE.csv().with_file_name("risk.csv"));
    if !arguments.draw {
        let progress = |share: f64, what: &str| eprintln!("{:3.0} %  {what}", 100.0 * share);
        let waiting = Waiting { progress: &progress, stop: &AtomicBool::new(false) };
        let (covered, risk) = coverage::measure(waiting)?;
        coverage::write_table(&covered, &path)?;
        coverage::write_table(&risk, &risks)?;
    }
    let images = root().join("docs/images");
    let covered = coverage::parse(&std::fs::read_to_string(&path)?)?;
    coverage::write_coverage(&covered, &images.join("coverage.svg"))?;
    let risk = coverage::parse(&std::fs::read_to_string(&risks)?)?;
    coverage::write_risk(&risk, &images.join("risk.svg"))?;
    TABLE.draw()
}
