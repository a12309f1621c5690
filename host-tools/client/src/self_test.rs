//! Faults found by a finger's self-test.

use taxel::condition::{DEAD_LEVEL, MIDPOINT_MARGIN};
use taxel::self_test::{Channel, SelfTest};

/// Largest noise as a share of full scale: above it a channel resolves less than eight bits.
const NOISE: f32 = 1.0 / 256.0;

/// Share of the matrix's median level below which a taxel counts as dead. The light of its
/// neighbours alone gives some percent.
const DIM: f32 = 0.05;

/// Fault found by a self-test.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Channel by its name in a trace; none for the calibration record.
    pub channel: Option<String>,
    /// Whether the channel is only noisy, as each is while something moves the finger.
    pub noisy: bool,
    /// Fault and fix in words.
    pub text: String,
}

/// Lists the faults in words, each with its fix.
#[must_use]
pub fn findings(test: &SelfTest) -> Vec<String> {
    faults(test).into_iter().map(|fault| fault.text).collect()
}

/// Lists the faults by channel.
#[must_use]
pub fn faults(test: &SelfTest) -> Vec<Fault> {
    let full_scale = f32::from(test.full_scale.top().0);
    let channels = &test.channels;
    let mut wrong = vec![];
    let fault = |channel, text| Fault { channel: Some(channel), noisy: false, text };
    for (name, channel) in named(test) {
        if channel.noise > NOISE * full_scale {
            let (noise, most) = (channel.noise, NOISE * full_scale);
            let text = format!(
                "{name} is noisy ({noise:.1} codes, {most:.1} at most); keep the finger still and \
                 shaded, else look at its wiring"
            );
            wrong.push(Fault { channel: Some(name), noisy: true, text });
        }
    }
    let typical = typical_level(test);
    for (r, row) in channels.lit.iter().enumerate() {
        for (c, (lit, dark)) in row.iter().zip(&channels.dark).enumerate() {
            let (Some(lit), Some(dark)) = (lit, dark) else { continue };
            if lit.mean - dark.mean < (DEAD_LEVEL * full_scale).max(DIM * typical) {
                let name = format!("lit_r{r}c{c}");
                let text = format!(
                    "{name} is hardly brighter than its column in the dark ({:.0} and {:.0} codes); \
                     look at its LED, phototransistor and row driver",
                    lit.mean, dark.mean
                );
                wrong.push(fault(name, text));
            }
        }
    }
    for (s, sensor) in channels.bridges.iter().enumerate() {
        for (midpoint, channel) in ["a", "b", "c", "d"].iter().zip(sensor) {
            let Some(channel) = channel else { continue };
            let share = channel.mean / full_scale;
            let margin = 1.0 / MIDPOINT_MARGIN as f32;
            if !(margin..=1.0 - margin).contains(&share) {
                let name = format!("bridge_s{s}_{midpoint}");
                let text = format!(
                    "{name} rests at {:.0} % of the supply; an arm of the bridge is open \
                     or shorted",
                    share * 100.0
                );
                wrong.push(fault(name, text));
            }
        }
    }
    if test.record_intact == Some(false) {
        let text = "the stored calibration is damaged; upload it again".to_owned();
        wrong.push(Fault { channel: None, noisy: false, text });
    }
    wrong
}

/// Returns the median of the taxels' levels over the dark, in codes; 0 without a matrix.
fn typical_level(test: &SelfTest) -> f32 {
    let dark = test.channels.dark;
    let levels = test.channels.lit.iter().flat_map(|row| {
        row.iter().zip(dark).filter_map(|(lit, dark)| Some(lit.as_ref()?.mean - dark?.mean))
    });
    let mut levels: Vec<f32> = levels.collect();
    levels.sort_by(f32::total_cmp);
    levels.get(levels.len() / 2).copied().unwrap_or(0.0)
}

/// Ratio of each lit taxel to its dark column, by row; `None` where either is absent. Dark counts
/// as at least 1 code.
#[must_use]
pub fn on_off(test: &SelfTest) -> [[Option<f32>; 4]; 4] {
    let dark = test.channels.dark;
    test.channels.lit.map(|row| {
        std::array::from_fn(|c| {
            let (lit, dark) = (row.get(c).copied()??, dark.get(c).copied()??);
            Some(lit.mean / dark.mean.max(1.0))
        })
    })
}

/// Lists the channels present by their names in a trace.
#[must_use]
pub fn named(test: &SelfTest) -> Vec<(String, Channel)> {
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
