//! A trace in memory, and the stretch of it in which nothing touches the finger.

use std::array;
use std::ops::Range;

use taxel::calibration::Calibration;
use taxel::condition::{Bias, BiasTaker, Levels, Signals, TemperatureCompensation, Thermometer};
use taxel::finger::{Estimate, Finger, Wanted};
use taxel::frame::Fields;
#[cfg(test)]
use taxel::scan::{Codes, Scan};
use taxel::scan::{SENSORS, TAXELS};
#[cfg(test)]
use taxel::units::{FullScale, Micros};
use taxel_files::trace::{Sample, Truth};

use taxel_regress::align::{self, Alignment};
use taxel_regress::error::FitError;
use taxel_regress::quantile::median;

/// Fewest rows of an unloaded stretch.
const LEAST_ROWS: usize = 20;
/// Most rows of an unloaded stretch; more do not improve a bias.
const MOST_ROWS: usize = 4096;
/// Settling time left out after a contact: twice the 10 ms of the skin of [Ospina2017].
const SETTLE_US: u64 = 20_000;
/// Time before and after a touch in which a press may have begun or not have ended.
const FLANK_US: u64 = 50_000;
/// Least force, as a share of the recording's peak.
const SMALL_FORCE: f64 = 0.005;
/// Least force, in standard deviations of the reference.
const CLEAR_OF_NOISE: f64 = 5.0;
/// Largest force of a recording at rest, in standard deviations of its reference.
const MOST_NOISE: f64 = 6.0;
/// Least distance of a wrong unloaded row from a channel's median, in its deviations.
///
/// It must also exceed two steps of a 12-bit converter.
const SPIKE: f64 = 8.0;
const SMALL_SPIKE: f64 = 2.0 / 4096.0;

/// A trace in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Name of the recording in messages.
    pub name: String,
    /// Rows of the trace.
    pub samples: Vec<Sample>,
}

impl Recording {
    /// Returns the recording with its truth read at the aligned times; rows beyond it get none.
    pub(crate) fn with_truth_at(&self, alignment: &Alignment) -> Self {
        let own: Vec<f64> = self.samples.iter().map(|s| s.scan.time.0 as f64 * 1e-6).collect();
        let times: Vec<f64> = own.iter().map(|t| alignment.time(*t)).collect();
        let mut read = self.clone();
        for (sample, place) in read.samples.iter_mut().zip(align::places(&own, &times)) {
            sample.truth = place.map_or_else(Truth::default, |(before, share)| {
                let after = self.samples.get(before + 1).unwrap_or(&self.samples[before]);
                between(&self.samples[before].truth, &after.truth, share)
            });
        }
        read
    }

    /// Averages the levels of the unloaded finger as the chip does, at the temperature of `warmth`.
    ///
    /// # Errors
    ///
    /// There is no stretch in which nothing touches the finger and its signals are still.
    pub fn bias(&self, warmth: Option<&TemperatureCompensation>) -> Result<Bias, FitError> {
        if self.samples.is_empty() {
            return Err(FitError::Empty { recording: self.name.clone() });
        }
        self.unloaded().and_then(|rows| self.bias_of(rows, warmth)).ok_or_else(|| {
            FitError::NoUnloadedStretch { recording: self.name.clone(), rows: LEAST_ROWS }
        })
    }

    /// Signals of every row as on the chip: changes from `bias` at the temperature of `warmth`.
    #[must_use]
    pub fn signals(&self, bias: &Bias, warmth: Option<&TemperatureCompensation>) -> Vec<Signals> {
        let rows = self.warm_levels(warmth).into_iter();
        rows.map(|(levels, gain)| {
            let mut signals = bias.apply(&levels, None);
            signals.bridges.iter_mut().flatten().flatten().for_each(|u| *u *= gain);
            signals
        })
        .collect()
    }

    /// Signals of every row as the finger makes them in passing, with drift and lag compensated.
    ///
    /// Faults are those of each row: codes that stand still are judged with the whole recording.
    #[must_use]
    pub fn compensated(&self, bias: &Bias, compensation: &Calibration) -> Vec<Signals> {
        let Calibration { warmth, lag, drift, .. } = compensation;
        let only = Calibration { warmth: *warmth, lag: *lag, drift: *drift, ..Calibration::EMPTY };
        let (finger, mut state) = Finger::new(Some(only));
        finger.restore_bias(&mut state, *bias);
        let mut estimate = Estimate::NOTHING;
        let wanted = Wanted { fields: Fields::empty(), due: false };
        let rows = self.samples.iter().zip(self.signals(bias, warmth.as_ref()));
        let rows = rows.map(|(sample, plain)| {
            finger.update(&mut estimate, &mut state, &sample.scan, wanted);
            Signals { health: plain.health, ..estimate.signals }
        });
        rows.collect()
    }

    /// Levels at the temperature of `warmth`, and the gain of a force sensor's signals there.
    fn warm_levels(&self, warmth: Option<&TemperatureCompensation>) -> Vec<(Levels, f32)> {
        let mut thermometer = Thermometer::default();
        let rows = self.samples.iter().map(|sample| {
            let mut levels = Levels::read(&sample.scan.codes);
            let warm = warmth.zip(thermometer.read(&sample.scan.codes));
            let gain = warm.map_or(1.0, |(warmth, level)| {
                warmth.correct(&mut levels, level, 1.0);
                warmth.gain(level)
            });
            (levels, gain)
        });
        rows.collect()
    }

    /// Whether the reference shows no touch at all: a recording of the warm-up alone.
    ///
    /// The noise of a load cell takes some rows beyond the limit of a touch, but none as far as a
    /// press does.
    pub(crate) fn is_unloaded(&self) -> bool {
        let noise = |k: usize| {
            let forces: Vec<Option<f64>> =
                self.samples.iter().map(|sample| components(sample).nth(k).flatten()).collect();
            let most = MOST_NOISE * jitter(&forces);
            forces.into_iter().flatten().all(|force| force.abs() <= most)
        };
        let contacts = self.samples.iter().map(|sample| sample.truth.contact);
        let known = contacts.clone().any(|contact| contact.is_some())
            || self.samples.iter().any(|sample| largest_force(sample).is_some());
        known && contacts.flatten().all(|touches| !touches) && (0..3 + 3 * SENSORS).all(noise)
    }

    /// First stretch in which nothing touches the finger.
    ///
    /// The reference decides where it is known; otherwise it is the longest still beginning.
    fn unloaded(&self) -> Option<Range<usize>> {
        let unknown = |s: &Sample| s.truth.contact.is_none() && largest_force(s).is_none();
        let found = self.touched().and_then(|touched| self.first_untouched(&touched));
        if found.is_some() || !self.samples.iter().any(unknown) {
            return found;
        }
        [4096, 2048, 1024, 512, 256, 128, 64, 32]
            .into_iter()
            .map(|rows| 0..rows)
            .find(|rows| rows.end <= self.samples.len() && self.is_still(rows.clone()))
    }

    /// Whether each row is touched, by its contact column or by a force; `None` if no row knows.
    ///
    /// A row without a reference, such as those before the load cell's log, may be touched.
    /// On the bench a sensor may be sheared without a normal force, which is a load without a
    /// contact.
    pub(crate) fn touched(&self) -> Option<Vec<bool>> {
        let forces: Vec<Option<f64>> = self.samples.iter().map(largest_force).collect();
        let peak = forces.iter().flatten().copied().fold(0.0, f64::max);
        let least = (SMALL_FORCE * peak).max(CLEAR_OF_NOISE * jitter(&forces));
        let rows = self.samples.iter().zip(&forces);
        let touched = rows.map(|(sample, force)| match (sample.truth.contact, force) {
            (None, None) => None,
            (contact, force) => Some(contact == Some(true) || force.is_some_and(|f| f > least)),
        });
        let touched: Vec<Option<bool>> = touched.collect();
        let known = touched.iter().any(Option::is_some);
        let touched: Option<Vec<bool>> =
            known.then(|| touched.into_iter().map(|row| row.unwrap_or(true)).collect());
        // A single row is an error of the reference, not a touch.
        let alone = |rows: &[bool], i: usize| {
            let beside = [i.checked_sub(1), Some(i + 1)];
            !beside.into_iter().flatten().any(|at| rows.get(at) == Some(&true))
        };
        touched.map(|rows| (0..rows.len()).map(|i| rows[i] && !alone(&rows, i)).collect())
    }

    /// Whether each row is loaded by its reference; `None` for a row without one.
    pub(crate) fn loaded(&self) -> Vec<Option<bool>> {
        let touched = self.touched().unwrap_or_default();
        let known = |s: &Sample| s.truth.contact.is_some() || largest_force(s).is_some();
        let rows = self.samples.iter().zip(touched);
        rows.map(|(sample, touched)| known(sample).then_some(touched)).collect()
    }

    /// Standard deviation of each force component of the reference while nothing is touched.
    ///
    /// Zero for a component without a reference, and for an exact one. The flanks of presses, up to
    /// the least force of a touch, are left out, unless hardly a row lies beyond them.
    pub(crate) fn reference_noise(&self) -> [f64; 3] {
        let Some(touched) = self.touched() else { return [0.0; 3] };
        let time = |i: usize| self.samples[i].scan.time.0;
        let mut left_out = touched.clone();
        for at in (0..touched.len()).filter(|i| touched[*i]) {
            // Beyond the next touched row that one's own flank begins.
            let near = |i: &usize| !touched[*i] && time(*i).abs_diff(time(at)) <= FLANK_US;
            let before = (0..at).rev().take_while(near);
            let after = (at + 1..touched.len()).take_while(near);
            before.chain(after).for_each(|i| left_out[i] = true);
        }
        match left_out.iter().filter(|left_out| !**left_out).count() {
            still if still < LEAST_ROWS => self.noise_of(&touched, deviation),
            _ => self.noise_of(&left_out, deviation),
        }
    }

    /// Noise of the reference with the flanks of short presses, about twice that without them.
    ///
    /// The model of the skin errs there by more than the reference, and fits shear worse by less
    /// noise (`total_force_alone_finds_where_the_matrix_is_touched`).
    pub(crate) fn noise_with_flanks(&self) -> [f64; 3] {
        let touched = self.touched().unwrap_or_else(|| vec![true; self.samples.len()]);
        self.noise_of(&touched, |values| spread(values).1)
    }

    /// Noise of each force component of the reference in the rows not `left_out`.
    fn noise_of(&self, left_out: &[bool], noise: fn(&[f64]) -> f64) -> [f64; 3] {
        let rows = self.samples.iter().zip(left_out).filter(|row| !row.1);
        let untouched: Vec<&Sample> = rows.map(|row| row.0).collect();
        array::from_fn(|axis| {
            let values: Vec<f64> = untouched.iter().filter_map(|s| s.truth.force[axis]).collect();
            noise(&values)
        })
    }

    fn first_untouched(&self, touched: &[bool]) -> Option<Range<usize>> {
        let mut begin = 0;
        for run in touched.chunk_by(|a, b| a == b) {
            let end = begin + run.len();
            let mut rows = begin..end.min(begin + MOST_ROWS);
            if begin > 0 {
                let settled = self.samples[begin].scan.time.0 + SETTLE_US;
                rows.start +=
                    self.samples[rows.clone()].partition_point(|s| s.scan.time.0 < settled);
            }
            if !run[0] && rows.len() >= LEAST_ROWS {
                return Some(rows);
            }
            begin = end;
        }
        None
    }

    /// Whether no channel drifts by more than its own jitter.
    ///
    /// The variance must not exceed twice that of white noise with the same steps between rows.
    /// White noise has half the mean square step as its variance.
    fn is_still(&self, rows: Range<usize>) -> bool {
        let levels: Vec<Vec<f64>> = self.samples[rows].iter().map(channels).collect();
        let n = levels.len() as f64;
        (0..levels[0].len()).all(|k| {
            let value = |row: &Vec<f64>| row.get(k).copied().unwrap_or_default();
            let mean = levels.iter().map(value).sum::<f64>() / n;
            let variance = levels.iter().map(|row| (value(row) - mean).powi(2)).sum::<f64>() / n;
            let jumps = levels.windows(2).map(|pair| (value(&pair[1]) - value(&pair[0])).powi(2));
            let jitter = jumps.sum::<f64>() / (2.0 * n);
            let step = 1.0 / 4096.0;
            variance <= 2.0 * jitter + 0.25 * step * step
        })
    }

    fn bias_of(
        &self,
        rows: Range<usize>,
        warmth: Option<&TemperatureCompensation>,
    ) -> Option<Bias> {
        let levels = self.warm_levels(warmth);
        let sound = sound(&self.samples[rows.clone()]);
        let sound: Vec<&Levels> = levels[rows]
            .iter()
            .zip(sound)
            .filter_map(|((l, _), sound)| sound.then_some(l))
            .collect();
        let mut taker = BiasTaker::new(u16::try_from(sound.len()).ok()?);
        let outcomes = sound.into_iter().filter_map(|levels| taker.add(levels, &Bias::default()));
        outcomes.last()?.ok().map(|taken| taken.bias)
    }
}

/// Median and standard deviation by the median of the distances from it.
fn spread(values: &[f64]) -> (f64, f64) {
    let middle = median(values.to_vec());
    (middle, 1.4826 * median(values.iter().map(|v| (v - middle).abs()).collect()))
}

/// Standard deviation of values without spikes; it errs by two thirds of what [`spread`] does.
fn deviation(values: &[f64]) -> f64 {
    let (middle, spread) = spread(values);
    let near = values.iter().map(|v| (v - middle).abs()).filter(|v| *v <= SPIKE * spread);
    let (squares, rows) = near.fold((0.0, 0.0), |(squares, rows), v| (squares + v * v, rows + 1.0));
    f64::sqrt(squares / f64::max(rows, 1.0))
}

/// Truth interpolated between two rows.
fn between(a: &Truth, b: &Truth, share: f64) -> Truth {
    let value = |a: Option<f64>, b: Option<f64>| Some(a? + share * (b? - a?));
    let triple = |a: [Option<f64>; 3], b: [Option<f64>; 3]| array::from_fn(|k| value(a[k], b[k]));
    let nearer = if share < 0.5 { a } else { b };
    Truth {
        force: triple(a.force, b.force),
        point: array::from_fn(|k| value(a.point[k], b.point[k])),
        point_sigma: value(a.point_sigma, b.point_sigma),
        torsion: value(a.torsion, b.torsion),
        contact: nearer.contact,
        slip: nearer.slip,
        sensors: array::from_fn(|k| triple(a.sensors[k], b.sensors[k])),
    }
}

/// Flags the unloaded rows without spikes: every channel is near its median.
fn sound(samples: &[Sample]) -> Vec<bool> {
    let levels: Vec<Vec<f64>> = samples.iter().map(channels).collect();
    let mut sound = vec![true; samples.len()];
    for k in 0..levels.first().map_or(0, Vec::len) {
        let values = || levels.iter().map(move |row| row.get(k).copied().unwrap_or_default());
        let middle = median(values().collect());
        let deviation = 1.4826 * median(values().map(|v| (v - middle).abs()).collect());
        let limit = (SPIKE * deviation).max(SMALL_SPIKE);
        sound.iter_mut().zip(values()).for_each(|(sound, v)| *sound &= (v - middle).abs() <= limit);
    }
    sound
}

/// Largest force component of the reference.
fn largest_force(sample: &Sample) -> Option<f64> {
    components(sample).flatten().map(f64::abs).reduce(f64::max)
}

/// Components of the forces on the finger and on its sensors.
fn components(sample: &Sample) -> impl Iterator<Item = Option<f64>> {
    sample.truth.force.iter().chain(sample.truth.sensors.iter().flatten()).copied()
}

/// Standard deviation of the reference, from the median step between rows.
///
/// For white noise the median step is 0.954 standard deviations. More than half the rows must
/// change by less than that for any other reason.
fn jitter(forces: &[Option<f64>]) -> f64 {
    let steps = forces.windows(2).filter_map(|pair| Some((pair[1]? - pair[0]?).abs()));
    let mut steps: Vec<f64> = steps.collect();
    steps.sort_unstable_by(f64::total_cmp);
    steps.get(steps.len() / 2).map_or(0.0, |median| median / 0.954)
}

/// All levels of a row, in a fixed order.
pub(crate) fn channels(sample: &Sample) -> Vec<f64> {
    let Levels { taxels, bridges, .. } = Levels::read(&sample.scan.codes);
    in_order(taxels, bridges)
}

/// Levels or signals of a row, in a fixed order.
pub(crate) fn in_order(
    taxels: Option<[f32; TAXELS]>,
    bridges: [Option<[f32; 3]>; SENSORS],
) -> Vec<f64> {
    let bridges = bridges.iter().flatten().flatten();
    taxels.iter().flatten().chain(bridges).map(|value| f64::from(*value)).collect()
}

/// Row of a trace with a truth and no codes.
#[cfg(test)]
pub(crate) fn bare_sample(micros: u64, truth: Truth) -> Sample {
    let codes = Codes {
        full_scale: FullScale::BITS_16,
        taxels: None,
        bridges: [None; SENSORS],
        reference: None,
        temperature: None,
    };
    Sample { scan: Scan { time: Micros(micros), lost: 0, codes }, truth }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn flanks_of_presses_are_no_noise_of_the_reference() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        // A second at rest, then presses of 0.2 s without a pause, with 6 mN of noise.
        let sample = |i: u32| {
            let turn = f64::from(i % 40) / 40.0 * std::f64::consts::TAU;
            let press = if i < 200 { 0.0 } else { 1.0 - turn.cos() };
            // The sum of twelve has a standard deviation of one.
            let mut noise =
                || 6e-3 * ((0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0);
            let force = [Some(noise()), Some(noise()), Some(press + noise())];
            bare_sample(u64::from(i) * 5000, Truth { force, ..Truth::default() })
        };
        let samples: Vec<Sample> = (0..4200).map(sample).collect();
        let recording = Recording { name: "presses".into(), samples };
        for still in recording.reference_noise() {
            assert!((still - 6e-3).abs() < 1e-3, "{still}");
        }
        assert!(recording.noise_with_flanks()[2] > 8e-3);
    }
}
