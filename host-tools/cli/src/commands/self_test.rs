//! `taxel self-test`: noise and levels of the unloaded finger's channels.

use serde_json::json;
use taxel::self_test::{Channel, SelfTest};
use taxel::wire::message::{BoardHealth, Info};
use taxel_client::self_test::{findings, named, on_off};

use crate::finger::PortArg;
use crate::output;

/// Measures noise, light and midpoints of the unloaded finger, and checks its stored calibration.
/// Exit code 1 if something is faulty.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// Scans to measure over.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u16).range(2..=4096))]
    scans: u16,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel self-test
  taxel self-test --port sim:fault-at-rest --scans 200          # a dead LED and a shorted bridge
  taxel self-test --json && taxel record --out sound.mcap";

/// Runs the command.
///
/// The finger cannot be reached, or a check failed.
pub fn run(args: Args) -> anyhow::Result<()> {
    let client = args.port.connect()?;
    let test = client.self_test(args.scans)?;
    let (info, health) = (client.info()?, client.health()?);
    let wrong = findings(&test);
    if args.json {
        output::json(&as_json(&test, &info, &health, &wrong))?;
    } else {
        output::line(as_text(&test, &info, &health))?;
    }
    match wrong.as_slice() {
        [] => Ok(()),
        wrong => anyhow::bail!("self-test: {}", wrong.join("; ")),
    }
}

fn as_text(test: &SelfTest, info: &Info, health: &BoardHealth) -> String {
    let micros = |ticks: u32| f64::from(ticks) * 1e6 / f64::from(info.identity.tick_hz.max(1));
    let mut lines = vec![format!(
        "{:14} {:>9} {:>8}   of {}, over {} scans",
        "channel",
        "mean",
        "noise",
        test.full_scale.top().0,
        test.scans
    )];
    lines.extend(
        named(test)
            .iter()
            .map(|(name, Channel { mean, noise })| format!("{name:14} {mean:9.1} {noise:8.2}")),
    );
    for (r, row) in on_off(test).iter().enumerate() {
        let ratios = row.map(|ratio| ratio.map_or("–".to_owned(), |ratio| format!("{ratio:.1}")));
        lines.push(format!("lit / dark, row {r}: {}", ratios.join(" ")));
    }
    lines.push(format!(
        "stored calibration {}",
        match test.record_intact {
            None => "none",
            Some(true) => "whole",
            Some(false) => "damaged",
        }
    ));
    lines.push(format!("worst scan {:.1} µs to process", micros(info.cost.worst)));
    if let Some(reading) = health.reading {
        lines.push(format!("worst scan {:.1} µs to read", micros(reading.worst)));
    }
    lines.push(format!(
        "{} scans overrun, {} frames lost",
        info.counters.overruns, info.counters.lost
    ));
    lines.join("\n")
}

fn as_json(
    test: &SelfTest,
    info: &Info,
    health: &BoardHealth,
    wrong: &[String],
) -> serde_json::Value {
    let channels: serde_json::Map<_, _> = named(test)
        .into_iter()
        .map(|(name, Channel { mean, noise })| (name, json!({ "mean": mean, "noise": noise })))
        .collect();
    json!({
        "scans": test.scans,
        "full_scale": test.full_scale.top().0,
        "channels": channels,
        "lit_over_dark": on_off(test),
        "record_intact": test.record_intact,
        "worst_ticks": info.cost.worst,
        "worst_reading_ticks": health.reading.map(|cost| cost.worst),
        "tick_hz": info.identity.tick_hz,
        "overruns": info.counters.overruns,
        "lost": info.counters.lost,
        "wrong": wrong,
    })
}
