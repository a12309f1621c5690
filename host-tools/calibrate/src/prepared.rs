//! A finger's recording with its signals as on the chip, and its purpose in the fit.

use std::borrow::Cow;

use taxel::calibration::Calibration;
use taxel::condition::{Bias, Signals, TemperatureCompensation};
use taxel::scan::{COLS, Codes, Midpoints, SENSORS, TAXELS};
use taxel::units::Code;

use crate::recording::{Recording, in_order};
use taxel_regress::align::{self, Alignment, Series};
use taxel_regress::error::FitError;
use taxel_regress::shear::FORCES;

/// Least signal-to-noise ratio of a responding sensor, in one row of a hundred …
const ANSWERS: f32 = 8.0;
/// … and as a share of the signals of the strongest sensor.
const ANSWERS_SHARE: f32 = 0.02;

/// Largest lag of a skin behind the reference, seconds.
///
/// A relaxing skin of [Ospina2017] (fig. 1.23) has time constants of about 4 ms.
const LAGS: f64 = 0.02;

/// Body on which the reference force of the recordings acts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Subject {
    /// Found from each recording's signals.
    #[default]
    Found,
    /// The reference is the force on this sensor.
    Sensor(usize),
    /// The reference is the force on the finger.
    Finger,
}

/// Usefulness of a recording's reference force on a sensor.
pub(crate) enum Loads {
    /// The force on the sensor is not known.
    Unknown,
    /// The force is known, and not zero, in some rows.
    Known,
    /// The reference cannot fit S, for this reason.
    Unfit(String),
}

/// A recording with its signals as on the chip.
#[derive(Clone)]
pub(crate) struct Prepared<'r> {
    pub recording: Cow<'r, Recording>,
    pub bias: Bias,
    pub signals: Vec<Signals>,
}

impl<'r> Prepared<'r> {
    /// Prepares a recording, with a misaligned reference realigned in time.
    ///
    /// Returns a warning if the reference was realigned.
    ///
    /// # Errors
    ///
    /// There is no unloaded stretch.
    pub fn new(
        recording: &'r Recording,
        warmth: Option<&TemperatureCompensation>,
    ) -> Result<(Self, Option<String>), FitError> {
        let prepared = Self::of(Cow::Borrowed(recording), warmth)?;
        let Some(found) = prepared.misaligned() else { return Ok((prepared, None)) };
        let first = recording.samples.first().map_or(0.0, |s| s.scan.time.0 as f64 * 1e-6);
        let told = align::off_time(&recording.name, &found, first);
        let read = Cow::Owned(recording.with_truth_at(&found));
        Ok((Self::of(read, warmth)?, Some(told)))
    }

    /// Prepares a recording as it is.
    pub fn of(
        recording: Cow<'r, Recording>,
        warmth: Option<&TemperatureCompensation>,
    ) -> Result<Self, FitError> {
        let bias = recording.bias(warmth)?;
        let signals = recording.signals(&bias, warmth);
        Ok(Self { recording, bias, signals })
    }

    /// Computes the signals again, with drift and lag compensated.
    pub fn compensate(&mut self, compensation: &Calibration) {
        self.signals = self.recording.compensated(&self.bias, compensation);
    }

    /// Signal-to-noise ratio of a sensor: the 99th percentile over the recording.
    fn answer(&self, sensor: usize) -> f32 {
        let Some(bias) = self.bias.bridges[sensor] else { return 0.0 };
        percentile(self.signals.iter().filter_map(|s| s.bridges[sensor]), bias.noise)
    }

    /// Whether the sensor's signals stand out of their noise.
    pub fn responds(&self, sensor: usize) -> bool {
        self.answer(sensor) > ANSWERS
    }

    /// Whether the signals of the matrix stand out of their noise.
    fn matrix_responds(&self) -> bool {
        let noise = self.bias.taxels.map_or(1.0, |bias| bias.noise);
        percentile(self.signals.iter().filter_map(|s| s.taxels), noise) > ANSWERS
    }

    /// Columns of the matrix with the same code in every row.
    pub fn stuck_taxels(&self) -> Vec<String> {
        let lit = |k: usize| {
            let (row, column) = (k / COLS, k % COLS);
            let code = move |c: &Codes| Some(*c.taxels.as_ref()?.lit.get(row)?.get(column)?);
            self.stuck(code).then(|| format!("lit_r{row}c{column}"))
        };
        (0..TAXELS).filter_map(lit).collect()
    }

    /// Columns of a sensor's midpoints with the same code in every row.
    pub fn stuck_midpoints(&self, sensor: usize) -> Vec<String> {
        let of = |m: Midpoints| [m.a, m.b, m.c, m.d];
        let stuck = ["a", "b", "c", "d"].into_iter().enumerate().filter_map(|(i, name)| {
            let code = |c: &Codes| Some(of(c.bridges.get(sensor).copied().flatten()?)[i]);
            self.stuck(code).then(|| format!("bridge_s{sensor}_{name}"))
        });
        stuck.collect()
    }

    fn stuck(&self, code: impl Fn(&Codes) -> Option<Code>) -> bool {
        let codes = || self.recording.samples.iter().map(|sample| code(&sample.scan.codes));
        let first = codes().next().flatten();
        first.is_some() && codes().all(|code| code == first)
    }

    /// Alignment of the reference, if the signals show that another clock logged it.
    fn misaligned(&self) -> Option<Alignment> {
        let rows = self.recording.samples.iter().zip(&self.signals);
        let known = rows.filter_map(|(sample, signals)| {
            let force: Vec<f64> = sample.truth.force.iter().flatten().copied().collect();
            let channels = in_order(signals.taxels, signals.bridges);
            let time = sample.scan.time.0 as f64 * 1e-6;
            (!force.is_empty()).then_some((time, channels, force))
        });
        let (mut times, mut channels, mut forces) = (Vec::new(), Vec::new(), Vec::new());
        for (time, own, force) in known {
            times.push(time);
            channels.push(own);
            forces.push(force);
        }
        let alike = |rows: &[Vec<f64>]| rows.windows(2).all(|pair| pair[0].len() == pair[1].len());
        if times.is_empty() || !alike(&channels) || !alike(&forces) {
            return None;
        }
        let found = align::misaligned(Series { times: &times, rows: &channels }, &forces)?;
        let ends = [times.first(), times.last()].into_iter().flatten();
        ends.map(|t| (found.time(*t) - t).abs()).any(|off| off > LAGS).then_some(found)
    }

    /// Subject of the recording: the only responding sensor, otherwise the finger.
    pub fn subject(&self) -> Subject {
        if self.matrix_responds() {
            return Subject::Finger;
        }
        let answers: [f32; SENSORS] = std::array::from_fn(|sensor| self.answer(sensor));
        let most = answers.iter().copied().fold(0.0, f32::max);
        let mut responding = answers
            .iter()
            .enumerate()
            .filter(|(_, answer)| **answer > ANSWERS.max(ANSWERS_SHARE * most));
        match (responding.next(), responding.next()) {
            (Some((sensor, _)), None) => Subject::Sensor(sensor),
            _ => Subject::Finger,
        }
    }

    /// Usefulness of the reference force on this sensor.
    pub fn loads(&self, sensor: usize) -> Loads {
        let truths = || self.recording.samples.iter().map(|s| s.truth.sensors[sensor]);
        let known = || truths().filter(|truth| truth.iter().all(Option::is_some));
        let missing = |problem: String| Loads::Unfit(format!("{}: {problem}", self.recording.name));
        if !truths().flatten().any(|force| force.is_some()) {
            return Loads::Unknown;
        }
        if known().next().is_none() {
            let columns = FORCES.map(|force| format!("s{sensor}_{force}")).join(", ");
            return missing(format!("no row has all of {columns}"));
        }
        if !known().flatten().any(|force| force != Some(0.0)) {
            return missing(format!("s{sensor}_fx_n … s{sensor}_fz_n are zero throughout"));
        }
        match self.bias.bridges[sensor] {
            Some(_) => Loads::Known,
            None => missing(format!("columns bridge_s{sensor}_a … bridge_s{sensor}_d missing")),
        }
    }
}

/// Noise of each component of the reference at rest, over the rows of all recordings that have it.
pub(crate) fn reference_noise(recordings: &[&Prepared<'_>]) -> [f64; 3] {
    let (mut squares, mut rows) = ([0.0; 3], [0.0; 3]);
    for recording in recordings.iter().map(|prepared| &prepared.recording) {
        for (k, noise) in recording.reference_noise().into_iter().enumerate() {
            let known = recording.samples.iter().filter(|s| s.truth.force[k].is_some()).count();
            squares[k] += known as f64 * noise * noise;
            rows[k] += known as f64;
        }
    }
    std::array::from_fn(|k| f64::sqrt(squares[k] / f64::max(rows[k], 1.0)))
}

/// Largest [`Recording::noise_with_flanks`] of each component in any recording.
pub(crate) fn noise_with_flanks(recordings: &[&Prepared<'_>]) -> [f64; 3] {
    let each = recordings.iter().map(|prepared| prepared.recording.noise_with_flanks());
    each.fold([0.0; 3], |most, noise| std::array::from_fn(|k| most[k].max(noise[k])))
}

/// The 99th percentile of the RMS signal over its noise.
fn percentile<const N: usize>(signals: impl Iterator<Item = [f32; N]>, noise: f32) -> f32 {
    let rms = |u: [f32; N]| (u.iter().map(|u| u * u).sum::<f32>() / N as f32).sqrt() / noise;
    let mut ratios: Vec<f32> = signals.map(rms).collect();
    ratios.sort_by(f32::total_cmp);
    ratios.get(ratios.len() * 99 / 100).copied().unwrap_or_default()
}
