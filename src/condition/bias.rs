//! Bias of the unloaded finger: mean levels, their noise, and the averaging on command.

use serde::{Deserialize, Serialize};

use super::Signals;
use super::levels::{BridgeLevels, Levels, TaxelLevels};
use crate::math::{at_least, at_most, sqrt};
use crate::scan::{SENSORS, TAXELS};

/// Lower limit of a channel's noise: a quarter of a 12-bit step. The limit is needed because a
/// short average may look quieter.
pub const NOISE_FLOOR: f32 = 0.25 / 4096.0;
/// Upper limit of a channel's noise: 80 steps of a 12-bit converter. Above it few presses would
/// open the contact gate.
pub(crate) const NOISE_LIMIT: f32 = 0.02;

/// Bias of the optical matrix.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TaxelBias {
    /// Mean level of each taxel, as a fraction of full scale.
    pub level: TaxelLevels,
    /// Noise of one scan as a fraction of full scale: standard deviation, root mean square over the
    /// taxels.
    pub noise: f32,
}

/// Bias of one force sensor: b of [Ospina2017].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BridgeBias {
    /// Means of u_x, u_y, u_z, as fractions of full scale.
    pub level: BridgeLevels,
    /// Noise of one scan as a fraction of full scale: standard deviation, root mean square over the
    /// three.
    pub noise: f32,
}

/// Readings of every channel while nothing touches the finger.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Bias {
    /// The optical matrix, if known.
    pub taxels: Option<TaxelBias>,
    /// The force sensors, where known.
    pub bridges: [Option<BridgeBias>; SENSORS],
}

impl Bias {
    /// Returns the levels as changes against the unloaded finger.
    ///
    /// A c_k < 0 means nearer (sign rule of [DeMaria2011]). `healthy` are the unloaded levels of
    /// working taxels, from the calibration. These levels keep a bias taken on command from hiding
    /// a dead taxel as a dark one. Without a calibration the bias itself serves.
    #[must_use]
    #[inline(never)]
    pub fn apply(&self, levels: &Levels, healthy: Option<&TaxelLevels>) -> Signals {
        let mut signals = Signals { health: levels.health, ..Signals::default() };
        signals.health.dead = levels.dead(healthy.or(self.taxels.as_ref().map(|bias| &bias.level)));
        if let (Some(levels), Some(bias)) = (&levels.taxels, &self.taxels) {
            let c = signals.taxels.insert(bias.level);
            c.iter_mut().zip(levels).for_each(|(c, level)| *c -= level);
        }
        for ((signal, level), bias) in
            signals.bridges.iter_mut().zip(&levels.bridges).zip(&self.bridges)
        {
            if let (Some(level), Some(bias)) = (level, bias) {
                let u = signal.insert(*level);
                u.iter_mut().zip(bias.level).for_each(|(u, b)| *u -= b);
            }
        }
        signals
    }

    /// Returns whether the matrix or a sensor exceeds its noise by more than a factor, given
    /// squared.
    ///
    /// The signal of a part is its root mean square. Faulty channels do not count.
    #[must_use]
    #[inline(never)]
    pub fn exceeded(&self, signals: &Signals, factor2: f32) -> bool {
        if let (Some(c), Some(bias)) = (&signals.taxels, &self.taxels)
            && bias.exceeded(c, signals.health.dead, factor2)
        {
            return true;
        }
        self.any_sensor(signals, |noise| factor2 * noise * noise)
    }

    /// Returns whether a sensor exceeds its noise, as [`Bias::exceeded`] does, and also what it may
    /// have `drifted`, squared as well.
    #[inline(never)]
    pub(crate) fn sensor_exceeded(&self, signals: &Signals, factor2: f32, drifted2: f32) -> bool {
        self.any_sensor(signals, |noise| factor2 * noise * noise + drifted2)
    }

    /// Returns whether a sensor's mean square exceeds a limit, given its noise.
    #[inline(always)]
    fn any_sensor(&self, signals: &Signals, limit2: impl Fn(f32) -> f32) -> bool {
        let faults = signals.health.bridge_faults;
        for (i, sensor) in signals.bridges.iter().zip(&self.bridges).enumerate() {
            if let (Some(u), Some(bias)) = sensor
                && exceeds(u, 0, bias.noise, limit2(bias.noise))
                && faults >> i & 1 == 0
            {
                return true;
            }
        }
        false
    }

    /// Takes a `share` of the signals into the bias.
    #[inline(never)]
    pub(crate) fn follow(&mut self, signals: &Signals, share: f32) {
        if let (Some(c), Some(bias)) = (&signals.taxels, &mut self.taxels) {
            approach(&mut bias.level, c, -share);
        }
        for (u, bias) in signals.bridges.iter().zip(&mut self.bridges) {
            if let (Some(u), Some(bias)) = (u, bias) {
                approach(&mut bias.level, u, share);
            }
        }
    }
}

#[inline(always)]
fn approach(levels: &mut [f32], signals: &[f32], share: f32) {
    levels.iter_mut().zip(signals).for_each(|(level, signal)| *level += share * signal);
}

impl TaxelBias {
    /// Returns whether the taxels that are not `dead` exceed their noise, as [`Bias::exceeded`] does.
    #[inline(always)]
    pub(crate) fn exceeded(&self, c: &TaxelLevels, dead: u16, factor2: f32) -> bool {
        exceeds(c, dead, self.noise, factor2 * self.noise * self.noise)
    }
}

/// Returns whether the mean square of the signals whose bit in `skip` is clear exceeds a limit.
/// Without noise nothing is known to exceed it.
#[inline(always)]
fn exceeds(signals: &[f32], skip: u16, noise: f32, limit2: f32) -> bool {
    let (mut squares, mut count) = (0.0, signals.len() as f32);
    if skip == 0 {
        squares = signals.iter().fold(squares, |sum, signal| sum + signal * signal);
    } else {
        count = 0.0;
        let mut left = !skip;
        while let Some(signal) = signals.get(left.trailing_zeros() as usize) {
            squares += signal * signal;
            count += 1.0;
            left &= left - 1;
        }
    }
    // Both sides times the noise: without any, neither is more.
    squares * noise > count * noise * limit2
}

/// Averages scans into a [`Bias`] and checks that they hold still.
#[derive(Clone, Debug)]
pub struct BiasTaker {
    wanted: u16,
    seen: u16,
    clipped: bool,
    first: Levels,
    taxels: Moments<TAXELS>,
    bridges: [Moments<3>; SENSORS],
}

/// Result of a bias average.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taken {
    /// Averages of all channels.
    pub bias: Bias,
    /// Standard deviation of the noisiest channel, as a fraction of full scale.
    pub noisiest: f32,
}

/// Reasons for refusing a bias; the old one stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BiasRefusal {
    /// The finger moved.
    NotStill,
    /// A taxel was clipped, so that its level is unknown.
    Saturated,
}

impl BiasTaker {
    /// Limit of a channel's standard deviation, in multiples of its known noise. A larger one means
    /// that the finger moved.
    const STILL: f32 = 4.0;
    /// Assumed noise of a finger without a recorded one: two steps of a 12-bit converter.
    const UNKNOWN_NOISE: f32 = 2.0 / 4096.0;

    /// Makes an average over `frames` scans, at least two.
    #[must_use]
    pub fn new(frames: u16) -> Self {
        Self {
            wanted: frames.max(2),
            seen: 0,
            clipped: false,
            first: Levels::default(),
            taxels: Moments::NONE,
            bridges: [Moments::NONE; SENSORS],
        }
    }

    /// Adds one scan and returns the result after the last. `known` is the active bias, whose noise
    /// sets the limit of movement.
    pub fn add(&mut self, levels: &Levels, known: &Bias) -> Option<Result<Taken, BiasRefusal>> {
        if self.seen == 0 {
            self.first = *levels;
        }
        self.seen = self.seen.saturating_add(1);
        self.clipped |= levels.health.saturated != 0;
        // Deviations from the first scan, because squares of small numbers keep their digits.
        if let (Some(level), Some(first)) = (&levels.taxels, &self.first.taxels) {
            self.taxels.add(level, first);
        }
        for (moments, (level, first)) in
            self.bridges.iter_mut().zip(levels.bridges.iter().zip(&self.first.bridges))
        {
            if let (Some(level), Some(first)) = (level, first) {
                moments.add(level, first);
            }
        }
        (self.seen >= self.wanted).then(|| self.finish(known))
    }

    fn finish(&self, known: &Bias) -> Result<Taken, BiasRefusal> {
        if self.clipped {
            return Err(BiasRefusal::Saturated);
        }
        let mut noisiest = 0.0f32;
        let mut bias = Bias::default();
        if let Some(mut level) = self.first.taxels {
            let known = known.taxels.map(|t| t.noise);
            let noise = self.taxels.finish(known, &mut level, &mut noisiest)?;
            bias.taxels = Some(TaxelBias { level, noise });
        }
        for (i, (bias, moments)) in bias.bridges.iter_mut().zip(&self.bridges).enumerate() {
            let Some(mut level) = self.first.bridges.get(i).copied().flatten() else { continue };
            let known = known.bridges.get(i).copied().flatten().map(|b| b.noise);
            let noise = moments.finish(known, &mut level, &mut noisiest)?;
            *bias = Some(BridgeBias { level, noise });
        }
        Ok(Taken { bias, noisiest: sqrt(noisiest) })
    }
}

/// Running sums for the means and variances of channels that are read together.
#[derive(Clone, Copy, Debug)]
struct Moments<const N: usize> {
    scans: f32,
    /// Sum and sum of squares of each channel.
    sums: [[f32; 2]; N],
}

impl<const N: usize> Moments<N> {
    const NONE: Self = Self { scans: 0.0, sums: [[0.0; 2]; N] };

    /// Adds the deviations of `levels` from those of the `first` scan.
    #[inline(never)]
    fn add(&mut self, levels: &[f32; N], first: &[f32; N]) {
        self.scans += 1.0;
        for ([sum, squares], (level, first)) in self.sums.iter_mut().zip(levels.iter().zip(first)) {
            let deviation = level - first;
            *sum += deviation;
            *squares += deviation * deviation;
        }
    }

    /// Moves the `first` levels to their means and returns their noise.
    fn finish(
        &self,
        known: Option<f32>,
        first: &mut [f32; N],
        noisiest: &mut f32,
    ) -> Result<f32, BiasRefusal> {
        finish(self.scans, &self.sums, known, first, noisiest)
    }
}

/// Finishes the [`Moments`] of any number of channels.
#[inline(never)]
fn finish(
    scans: f32,
    sums: &[[f32; 2]],
    known: Option<f32>,
    first: &mut [f32],
    noisiest: &mut f32,
) -> Result<f32, BiasRefusal> {
    let known = at_least(known.unwrap_or(BiasTaker::UNKNOWN_NOISE), NOISE_FLOOR);
    let limit = at_most(BiasTaker::STILL * known, NOISE_LIMIT);
    let (mut worst, mut all) = (0.0f32, 0.0);
    for (level, [sum, squares]) in first.iter_mut().zip(sums) {
        let mean = sum / at_least(scans, 1.0);
        let variance = (squares - sum * mean) / at_least(scans - 1.0, 1.0);
        worst = at_least(variance, worst);
        all += at_least(variance, 0.0);
        *level += mean;
    }
    *noisiest = at_least(worst, *noisiest);
    if worst > limit * limit {
        return Err(BiasRefusal::NotStill);
    }
    Ok(at_least(sqrt(all / sums.len() as f32), NOISE_FLOOR))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels(offset: f32) -> Levels {
        Levels { taxels: Some([0.3 + offset; TAXELS]), ..Levels::default() }
    }

    #[test]
    fn bias_is_the_mean_of_a_still_finger() {
        let mut taker = BiasTaker::new(100);
        let mut taken = None;
        for i in 0..100 {
            assert!(taken.is_none());
            taken = taker.add(&levels(if i % 2 == 0 { 1e-4 } else { -1e-4 }), &Bias::default());
        }
        let bias = taken.unwrap().unwrap().bias.taxels.unwrap();
        assert!(bias.level.iter().all(|l| (l - 0.3).abs() < 1e-6));
        assert!((bias.noise - 1e-4).abs() < 2e-6, "{}", bias.noise);
    }

    #[test]
    fn bias_is_refused_while_the_finger_is_moving() {
        let mut taker = BiasTaker::new(100);
        let taken = (0..100).find_map(|i| taker.add(&levels(i as f32 * 1e-4), &Bias::default()));
        assert_eq!(taken, Some(Err(BiasRefusal::NotStill)));
    }

    #[test]
    fn bias_is_refused_while_a_taxel_is_clipped() {
        let mut clipped = levels(0.0);
        clipped.health.saturated = 1 << 5;
        let mut taker = BiasTaker::new(10);
        let taken = (0..10).find_map(|i| {
            let levels = if i == 4 { clipped } else { levels(0.0) };
            taker.add(&levels, &Bias::default())
        });
        assert_eq!(taken, Some(Err(BiasRefusal::Saturated)));
    }

    #[test]
    fn nearer_facet_has_negative_signal() {
        let unloaded = levels(0.0).taxels.unwrap();
        let bias =
            Bias { taxels: Some(TaxelBias { level: unloaded, noise: 1e-4 }), ..Bias::default() };
        let nearer = bias.apply(&levels(0.1), None).taxels.unwrap();
        assert!(nearer.iter().all(|c| *c < 0.0));
    }

    #[test]
    fn bias_takes_its_share_of_the_signals() {
        let mut bias = Bias {
            taxels: Some(TaxelBias { level: [0.3; TAXELS], noise: 1e-4 }),
            bridges: [Some(BridgeBias::default()), None, None, None],
        };
        let levels = Levels {
            taxels: Some([0.2; TAXELS]),
            bridges: [Some([0.1, 0.0, -0.1]); SENSORS],
            ..Levels::default()
        };
        for _ in 0..2 {
            bias.follow(&bias.apply(&levels, None), 0.5);
        }
        // A quarter of the way is left.
        let [taxels, bridge] = [bias.taxels.unwrap().level[7], bias.bridges[0].unwrap().level[2]];
        assert!((taxels - 0.225).abs() < 1e-6 && (bridge + 0.075).abs() < 1e-6);
        assert_eq!(bias.bridges[1], None);
    }

    #[test]
    fn what_a_sensor_may_have_drifted_is_no_contact() {
        let noise = 1e-4;
        let bias = Bias {
            bridges: [Some(BridgeBias { noise, ..BridgeBias::default() }), None, None, None],
            ..Bias::default()
        };
        let bridges = [Some([0.01; 3]), None, None, None];
        let signals = Signals { bridges, ..Signals::default() };
        let exceeds = |drifted: f32| bias.sensor_exceeded(&signals, 64.0, drifted * drifted);
        assert!(exceeds(0.0) && exceeds(0.0099) && !exceeds(0.0101));
    }

    #[test]
    fn faulty_channels_do_not_look_like_contact() {
        let above = |signals: &[f32], factor2: f32| exceeds(signals, 0b001, 0.1, factor2 * 0.01);
        assert!(!above(&[1.0, 0.0, 0.0], 0.0) && !above(&[1.0], 0.0));
        assert!(above(&[1.0, 0.2, -0.2], 3.9) && !above(&[1.0, 0.2, -0.2], 4.1));
    }

    #[test]
    fn signal_is_missing_without_bias() {
        let signals = Bias::default().apply(&levels(0.1), None);
        assert_eq!(signals.taxels, None);
    }
}
