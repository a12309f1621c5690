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

const HEADER: &str = "name,instructions,cycles_low,cycles_high,mean_instructions,mean_cycles_low,mean_cycles_high,inputs,cycles_4ws,mean_cycles_4ws";

/// Prints the table of stages.
pub fn table(stages: &[Stage]) {
    let width = stages.iter().map(|stage| stage.name.len()).max().unwrap_or(0);
    println!(
        "Cortex-M4F: instructions exact; cycles modelled [low, high] without wait states, their bounds \
         where the manual is open, and cycles on the STM32G431 at 170 MHz (4 WS, accelerator on, \
         caches empty at first)\n"
    );
    let head = |kind: &str, bounds: &str| {
        format!("{kind}: {:>12} {:>15}{bounds} {:>8}", "instructions", "cycles", "4 WS")
    };
    let bounds = format!(" {:>15}", "bounds");
    println!("{:width$} {}   {}", "", head("worst", &bounds), head(" mean", ""));
    for stage in stages {
        let worst = stage.worst();
        let [instructions, low, high, time] = stage.mean();
        let most = format!("{}-{}", worst.cycles.low, worst.cycles.high);
        let bounds = format!("{}-{}", worst.bounds.low, worst.bounds.high);
        let mean = format!("{low:.0}-{high:.0}");
        println!(
            "{:width$} {:>19} {most:>15} {bounds:>15} {:>8}   {instructions:>19.0} {mean:>15} {time:>8.0}",
            stage.name,
            worst.instructions,
            stage.worst_time()
        );
    }
}

/// Table of stages as CSV.
pub fn csv(stages: &[Stage]) -> String {
    let mut text = format!("{HEADER}\n");
    for stage in stages {
        let worst = stage.worst();
        let [instructions, low, high, time] = stage.mean();
        // Names have commas: "codes to wire bytes, contact, estimates".
        let _ = writeln!(
            text,
            "\"{}\",{},{},{},{instructions:.1},{low:.1},{high:.1},{},{},{time:.1}",
            stage.name,
            worst.instructions,
            worst.cycles.low,
            worst.cycles.high,
            stage.calls.len(),
            stage.worst_time()
        );
    }
    text
}

/// Prints the shares of a stage's functions in its cycles.
pub fn profile(name: &str, shares: &[Share]) {
    let total: f64 = shares.iter().map(|share| share.cycles[1] + share.waits).sum();
    println!("{name}: mean instructions, cycles, and waits for the flash, a call\n");
    for Share { name, instructions, cycles: [low, high], waits } in shares {
        if high + waits >= LEAST_SHARE * total {
            let band = format!("{low:.0}-{high:.0}");
            let share = (high + waits) / total * 100.0;
            println!("{instructions:>8.0}  {band:<12} {waits:>6.0}  {share:>3.0} %  {name}");
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
    // The comparison reads no further columns.
    ensure!(
        lines.next().is_some_and(|line| line.starts_with("name,instructions,")),
        "{}: line 1 must be `{HEADER}`; write it again with `cargo xtask cycles --csv`",
        path.display()
    );
    let mut costlier = Vec::new();
    for stage in stages {
        let now = stage.worst().instructions;
        let before = lines.clone().find_map(|line| {
            let rest = line.strip_prefix('"')?.strip_prefix(stage.name.as_str())?;
            rest.strip_prefix("\",")?.split(',').next()?.parse::<u64>().ok()
        });
        match before {
            None => costlier.push(format!("{}: not listed", stage.name)),
            Some(before) => {
                let most = (before as f64 * MARGIN).max(before as f64 + MARGIN_INSTRUCTIONS);
                if now as f64 > most {
                    costlier.push(format!("{}: {now} instructions, were {before}", stage.name));
                }
            }
        }
    }
    if costlier.is_empty() {
        return Ok(());
    }
    bail!(
        "more instructions than in {}, by over a tenth; if that is intended, write it again with \
         `cargo xtask cycles --csv`:\n  {}",
        path.display(),
        costlier.join("\n  ")
    )
}
