//! `taxel self-test`: what the finger's channels read by themselves.

use serde_json::json;
use taxel::condition::{DEAD_LEVEL, MIDPOINT_MARGIN};
use taxel::self_test::{Channel, SelfTest};
use taxel::wire::message::{BoardHealth, Info};

use crate::finger::PortArg;
use crate::output;

/// Measures noise, light and midpoints of the unloaded finger, and checks its stored calibration. Exit
/// code 1 where something is wrong.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// Scans to measure over.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u16).range(2..=4096))]
    scans: u16,
    /// Print it as JSON.
    #[arg(long)]
    json: bool,
}

/// A channel noisier than this share of full scale resolves less than eight bits.
const NOISE: f32 = 1.0 / 256.0;

/// Runs the command.
///
/// # Errors
/// The finger cannot be reached, or something is wrong with it.
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

/// What is not as it should be.
fn findings(test: &SelfTest) -> Vec<String> {
    let full_scale = f32::from(test.full_scale.top().0);
    let channels = &test.channels;
    let mut wrong = vec![];
    for (name, channel) in named(test) {
        if channel.noise > NOISE * full_scale {
            let (noise, most) = (channel.noise, NOISE * full_scale);
            wrong.push(format!(
                "{name} is noisy ({noise:.1} codes, {most:.1} at most); keep the finger still and \
                 shaded, else look at its wiring"
            ));
        }
    }
    for (r, row) in channels.lit.iter().enumerate() {
        for (c, (lit, dark)) in row.iter().zip(&channels.dark).enumerate() {
            let (Some(lit), Some(dark)) = (lit, dark) else { continue };
            if lit.mean - dark.mean < DEAD_LEVEL * full_scale {
                wrong.push(format!(
                    "lit_r{r}c{c} is hardly brighter than its column in the dark ({:.0} and {:.0} codes); \
                     look at its LED, phototransistor and row driver",
                    lit.mean, dark.mean
                ));
            }
        }
    }
    for (s, sensor) in channels.bridges.iter().enumerate() {
        for (midpoint, channel) in ["a", "b", "c", "d"].iter().zip(sensor) {
            let Some(channel) = channel else { continue };
            let share = channel.mean / full_scale;
            let margin = 1.0 / MIDPOINT_MARGIN as f32;
            if !(margin..=1.0 - margin).contains(&share) {
                wrong.push(format!(
                    "bridge_s{s}_{midpoint} rests at {:.0} % of the supply; an arm of the bridge is open \
                     or shorted",
                    share * 100.0
                ));
            }
        }
    }
    if test.record_intact == Some(false) {
        wrong.push("the stored calibration is damaged; upload it again".to_owned());
    }
    wrong
}

/// The channels that are there, by their names in a trace.
fn named(test: &SelfTest) -> Vec<(String, Channel)> {
    let channels = &test.channels;
    let lit = channels.lit.iter().enumerate().flat_map(|(r, row)| {
        row.iter().enumerate().map(move |(c, channel)| (format!("lit_r{r}c{c}"), *channel))
    });
    let dark =
        channels.dark.iter().enumerate().map(|(c, channel)| (format!("dark_c{c}"), *channel));
    let bridges = channels.bridges.iter().enumerate().flat_map(|(s, sensor)| {
        ["a", "b", "c", "d"]
            .iter()
            .zip(sensor)
            .map(move |(midpoint, channel)| (format!("bridge_s{s}_{midpoint}"), *channel))
    });
    let own = [("aux_vref", channels.reference), ("aux_temp", channels.temperature)];
    let own = own.into_iter().map(|(name, channel)| (name.to_owned(), channel));
    lit.chain(dark)
        .chain(bridges)
        .chain(own)
        .filter_map(|(name, channel)| Some((name, channel?)))
        .collect()
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
    lines.push(format!("{} overruns, {} frames lost", info.counters.overruns, info.counters.lost));
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
        "record_intact": test.record_intact,
        "worst_ticks": info.cost.worst,
        "worst_reading_ticks": health.reading.map(|cost| cost.worst),
        "tick_hz": info.identity.tick_hz,
        "overruns": info.counters.overruns,
        "lost": info.counters.lost,
        "wrong": wrong,
    })
}
