//! Forces of a recording from a reference with a clock of its own.

use std::borrow::Cow;

use taxel::condition::{LagCompensation, LagState, Levels, Signals};
use taxel_files::table::Table;
use taxel_files::trace::Sample;
use taxel_regress::align::{self, Alignment, Series};
use taxel_regress::error::FitError;
use taxel_regress::outliers::{Outliers, keep_sound};
use taxel_regress::shear::FORCES;

use crate::lag;
use crate::prepared::{Prepared, Subject};
use crate::recording::{Recording, channels, in_order};

/// Correlation below which a reference may be that of another recording.
///
/// Own logs reach it with touches up to 0.3 N under 6 mN of noise, at 10 Hz, and filtered over
/// 50 ms. A recording of a hundred presses has at most 0.93 with the log of another; with that of
/// a few, 0.97.
pub const DOUBTFUL: f64 = 0.98;
/// Correlation below which a reference is refused.
const LEAST_CORRELATION: f64 = 0.95;

impl Recording {
    /// Takes the forces from a reference with another clock; rows beyond it get none.
    ///
    /// A correlation below [`DOUBTFUL`] is that without wrong rows and without the noise of the
    /// reference.
    /// The finger's lag is the one given, of its calibration, or else is found. It is returned with
    /// the alignment; `None` if there is none, or if the offset of the clocks hides it.
    ///
    /// # Errors
    ///
    /// A column that is not a force of the finger, or the two cannot be aligned in time or do not
    /// show the same presses.
    pub fn align(
        &mut self,
        reference: &Table,
        lag: Option<LagCompensation>,
    ) -> Result<(Alignment, Option<f64>), FitError> {
        let axes = reference.names.iter().map(|name| {
            let axis = FORCES.iter().position(|force| force == name);
            axis.ok_or_else(|| FitError::Unaligned {
                recording: reference.path.display().to_string(),
                problem: format!("`{name}` is not a force of the finger"),
                mend: format!("its columns are {}", FORCES.join(", ")),
            })
        });
        let axes: Vec<usize> = axes.collect::<Result<_, _>>()?;
        let times: Vec<f64> = self.samples.iter().map(|s| s.scan.time.0 as f64 * 1e-6).collect();
        let levels = match lag {
            Some(lag) => prompt(&self.samples, lag),
            None => self.samples.iter().map(channels).collect(),
        };
        // `align` rejects stamps that cannot be spread.
        let clock = align::told_apart(&reference.times).unwrap_or(Cow::Borrowed(&reference.times));
        let other = Series { times: &clock, rows: &reference.rows };
        let name = reference.path.display().to_string();
        let sensor = Series { times: &times, rows: &levels };
        if levels.iter().any(|row| row.len() != levels[0].len()) {
            return Err(FitError::Unaligned {
                recording: self.name.clone(),
                problem: "some rows have channels that others lack".to_owned(),
                mend: "record again with all sensors connected".to_owned(),
            });
        }
        let mut alignment = align::align([&self.name, &name], sensor, other)?;
        self.read(&times, &alignment, (other, &axes, &name))?;
        if alignment.correlation < DOUBTFUL {
            alignment.correlation = self.belongs(sensor, (other, &name), &alignment)?;
        }
        if let Some(lag) = lag {
            let lag = f64::from(lag.taxels.max(lag.sensors));
            return Ok((alignment, (lag > 0.0).then_some(lag)));
        }
        // The lag of a force sensor on a bench of its own is not compensated.
        let prepared = Prepared::of(Cow::Borrowed(self), None);
        if !prepared.is_ok_and(|prepared| prepared.subject() == Subject::Finger) {
            return Ok((alignment, None));
        }
        let own_times: Vec<f64> = clock.iter().map(|t| alignment.own_time(*t)).collect();
        // A cubic through four readings has four fifths of their variance on average.
        let noise = self.reference_noise().map(|noise| f64::sqrt(1.25) * noise);
        let noise: Vec<f64> = axes.iter().map(|axis| noise[*axis]).collect();
        let hidden = lag::hidden(sensor, Series { times: &own_times, ..other }, &noise);
        if let Some(hidden) = hidden {
            alignment.offset += hidden;
            self.read(&times, &alignment, (other, &axes, &name))?;
        }
        Ok((alignment, hidden))
    }

    /// Correlation without the rows that a fit leaves out, and without the reference's noise.
    ///
    /// # Errors
    ///
    /// So low a one that the reference does not show the recording's presses.
    fn belongs(
        &self,
        sensor: Series<'_>,
        (other, name): (Series<'_>, &str),
        alignment: &Alignment,
    ) -> Result<f64, FitError> {
        let forces = self.samples.iter().map(|s| s.truth.force.iter().flatten().copied());
        let forces: Vec<Vec<f64>> = forces.map(Iterator::collect).collect();
        // A trace may have components of its own, which go on where the log has ended.
        let components = forces.iter().map(Vec::len).max().unwrap_or_default();
        let rows = sensor.times.iter().zip(sensor.rows).zip(forces);
        let (mut times, mut recorded) = (Vec::new(), (Vec::new(), Vec::new()));
        for ((time, levels), forces) in rows.filter(|(_, f)| !f.is_empty() && f.len() == components)
        {
            times.push(*time);
            recorded.0.push(levels.clone());
            recorded.1.push(forces);
        }
        let mut recorded = [recorded];
        if let Ok(outliers) = Outliers::find(&recorded, std::slice::from_ref(&self.name), None) {
            keep_sound(&mut times, &outliers.wrong[0]);
            outliers.remove_from(&mut recorded);
        }
        let sound = Series { times: &times, rows: &recorded[0].0 };
        let noise = self.reference_noise().into_iter().fold(0.0, f64::max);
        let spread: f64 = (0..components).map(|k| variance(&recorded[0].1, k)).sum();
        let found = align::correlation(sound, other, alignment).map_or(0.0, |found| {
            let left = ((1.0 - found * found) * spread - noise * noise).max(0.0);
            (1.0 - left / spread.max(f64::MIN_POSITIVE)).max(0.0).sqrt()
        });
        if found >= LEAST_CORRELATION {
            return Ok(found);
        }
        Err(FitError::Unaligned {
            recording: name.to_owned(),
            problem: format!(
                "its correlation with {} is {found:.2} where a log of the same presses has {DOUBTFUL} or more",
                self.name
            ),
            mend: "give each --data its own log, in the same order, and look for a load cell that came off".into(),
        })
    }

    /// Reads the forces of a reference, of these axes and this name, at its times of the rows.
    fn read(
        &mut self,
        times: &[f64],
        alignment: &Alignment,
        (other, axes, name): (Series<'_>, &[usize], &str),
    ) -> Result<(), FitError> {
        let times: Vec<f64> = times.iter().map(|t| alignment.time(*t)).collect();
        let forces = align::resample(other, &times);
        if forces.iter().all(Option::is_none) {
            return Err(align::apart(name, &times, other.times));
        }
        for (sample, forces) in self.samples.iter_mut().zip(forces) {
            for (at, axis) in axes.iter().enumerate() {
                sample.truth.force[*axis] = forces.as_ref().map(|forces| forces[at]);
            }
        }
        Ok(())
    }
}

/// Levels of every row with the lag compensated.
fn prompt(samples: &[Sample], lag: LagCompensation) -> Vec<Vec<f64>> {
    let (mut state, mut before) = (LagState::default(), None);
    let rows = samples.iter().map(|sample| {
        let now = sample.scan.time.0;
        let passed = now.saturating_sub(before.replace(now).unwrap_or(now));
        let Levels { taxels, bridges, .. } = Levels::read(&sample.scan.codes);
        let mut signals = Signals { taxels, bridges, ..Signals::default() };
        lag.advance(&mut state, u32::try_from(passed).unwrap_or(u32::MAX), &mut signals);
        in_order(signals.taxels, signals.bridges)
    });
    rows.collect()
}

/// Variance of component `k` of the rows.
fn variance(rows: &[Vec<f64>], k: usize) -> f64 {
    let count = rows.len().max(1) as f64;
    let values = || rows.iter().filter_map(|row| row.get(k));
    let mean = values().sum::<f64>() / count;
    values().map(|value| (value - mean).powi(2)).sum::<f64>() / count
}
