//! Detection of faults, into host-tools/research/data/detection.csv, its chart and its section.

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use taxel_research::{Waiting, detection};

use crate::root;
use crate::table::Table;

/// Injects every kind of fault into a simulated reference finger and judges how it is reported,
/// into host-tools/research/data/detection.csv, docs/images/detection.svg and docs/accuracy.md
#[derive(Args)]
pub struct Detection {
    /// Runs of each sound scene, for the rate of false alarms
    #[arg(long, default_value_t = 1)]
    clean_runs: u64,
    /// Only draw chart and section from the CSV file that is there
    #[arg(long)]
    draw: bool,
}

pub const TABLE: Table = Table {
    task: "detection",
    page: "docs/accuracy.md",
    section: |csv| Ok(detection::section(&detection::parse(csv)?)),
};

/// Measures, unless the table is only to be drawn, and draws chart and section.
pub fn run(arguments: &Detection) -> Result<()> {
    let path = TABLE.csv();
    if !arguments.draw {
        let (start, told) = (Instant::now(), Mutex::new(-1));
        let progress = |share: f64, what: &str| {
            let percent = (100.0 * share) as i32;
            let Ok(mut told) = told.lock() else { return };
            if percent > *told {
                *told = percent;
                eprintln!("{percent:3} % {:4.0} s  {what}", start.elapsed().as_secs_f64());
            }
        };
        let waiting = Waiting { progress: &progress, stop: &AtomicBool::new(false) };
        detection::write_table(&detection::measure(arguments.clean_runs, waiting)?, &path)?;
    }
    let rows = detection::parse(&std::fs::read_to_string(&path)?)?;
    detection::write_chart(&rows, &root().join("docs/images/detection.svg"))?;
    TABLE.draw()
}
