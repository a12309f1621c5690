//! Reports of counts: printed tables, CSV, and comparison with an earlier CSV.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};

use crate::bench::Stage;
use crate::profile::Share;

/// Largest accepted ratio of instructions to the earlier count, because compiler versions differ.
const MARGIN: f64 = 1.10;
/// Accepted extra instructions, because a tenth of the smallest stages is less than one spilled
/// register.
const MARGIN_INSTRUCTIONS: f64 = 10.0;
/// Least share of the cycles that gets a line in a profile.
const LEAST_SHARE: f64 = 0.01;

const HEADER: &str = "name,instructions,cycles_low,cycles_high,mean_instructions,mean_cycles_low,mean_cycles_high,inputs";

/// Prints the table of stages.
pub fn table(stages: &[Stage]) {
    let width = stages.iter().map(|stage| stage.name.len()).max().unwrap_or(0);
    println!("Cortex-M4F, zero wait states: instructions exact, cycles modelled [low, high]\n");
    println!("{:width$}   worst: instructions  cycles       mean: instructions  cycles", "");
    for stage in stages {
        let worst = stage.worst();
        let [instructions, low, high] = stage.mean();
        let most = format!("{}-{}", worst.cycles.low, worst.cycles.high);
        let mean = format!("{low:.0}-{high:.0}");
        println!(
            "{:width$} {:>20}  {most:<13} {instructions:>16.0}  {mean}",
            stage.name, worst.instructions
        );
    }
}

/// Table of stages as CSV.
pub fn csv(stages: &[Stage]) -> String {
    let mut text = format!("{HEADER}\n");
    for stage in stages {
        let worst = stage.worst();
        let [instructions, low, high] = stage.mean();
        // Names have commas: "codes to wire bytes, contact, estimates".
        let _ = writeln!(
            text,
            "\"{}\",{},{},{},{instructions:.1},{low:.1},{high:.1},{}",
            stage.name,
            worst.instructions,
            worst.cycles.low,
            worst.cycles.high,
            stage.calls.len()
        );
    }
    text
}

/// Prints the shares of a stage's functions in its cycles.
pub fn profile(name: &str, shares: &[Share]) {
    let total: f64 = shares.iter().map(|share| share.cycles[1]).sum();
    println!("{name}: mean instructions, cycles a call\n");
    for Share { name, instructions, cycles: [low, high] } in shares {
        if *high >= LEAST_SHARE * total {
            let band = format!("{low:.0}-{high:.0}");
            println!("{instructions:>8.0}  {band:<12} {:>3.0} %  {name}", high / total * 100.0);
        }
    }
    println!();
}

/// Compares stages with the CSV at `path`.
///
/// # Errors
/// A stage that executes more instructions than listed, beyond the margins, or that is not listed.
pub fn compare(path: &Path, stages: &[Stage]) -> Result<()> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let mut lines = text.lines();
    ensure!(
        lines.next() == Some(HEADER),
        "{}: line 1 must be `{HEADER}`; write it again with `cargo xtask cycles --csv`",
        path.display()
    );
    let mut dearer = Vec::new();
    for stage in stages {
        let now = stage.worst().instructions;
        let before = lines.clone().find_map(|line| {
            let rest = line.strip_prefix('"')?.strip_prefix(stage.name.as_str())?;
            rest.strip_prefix("\",")?.split(',').next()?.parse::<u64>().ok()
        });
        match before {
            None => dearer.push(format!("{}: not listed", stage.name)),
            Some(before) => {
                let most = (before as f64 * MARGIN).max(before as f64 + MARGIN_INSTRUCTIONS);
                if now as f64 > most {
                    dearer.push(format!("{}: {now} instructions, were {before}", stage.name));
                }
            }
        }
    }
    if dearer.is_empty() {
        return Ok(());
    }
    bail!(
        "more instructions than in {}, by over a tenth; if that is intended, write it again with \
         `cargo xtask cycles --csv`:\n  {}",
        path.display(),
        dearer.join("\n  ")
    )
}
