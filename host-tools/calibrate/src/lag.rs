//! Fit of the lags of skin and force sensors behind the reference force.
//!
//! Signals that are late by T tell the force of T ago, F − T·Ḟ. By least squares the reference is
//! therefore a function of the signals and T times its own rate. A press differs by its direction,
//! too, because rubber has hysteresis; a column of its own keeps that from being taken for a lag.
//!
//! A reference with a clock of its own is aligned by the load, which hides the lag ([`hidden`]).

mod hidden;

use std::borrow::Cow;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use taxel::condition::{LagCompensation, LagState, Signals};
use taxel::scan::{SENSORS, TAXELS};

use crate::prepared::{Prepared, Subject};
use crate::recording::Recording;
pub(crate) use hidden::hidden;

/// Least lag that is worth the noise of its compensation, and longest of any coating, seconds.
const WORTH: [f64; 2] = [0.25e-3, 0.02];
/// Least lag in its standard deviations. Errors of neighbouring rows are alike, so that the
/// deviation of independent ones is several times too small.
const CLEAR: f64 = 20.0;
/// Time to either side over which the rate of the reference is taken, seconds.
const BESIDE: f64 = 4e-3;
/// Least force of a row, as a share of the recordings' largest.
const LOADED: f64 = 0.05;
/// Fewest rows.
const LEAST_ROWS: usize = 200;

/// Fits the lags to the recordings of the finger; `None` if neither skin nor force sensors are
/// late.
///
/// A sensor on a bench of its own is fitted as it stands, because its reference is slow.
pub(crate) fn fit(recordings: &[Prepared<'_>], subjects: &[Subject]) -> Option<LagCompensation> {
    let fingers = recordings.iter().zip(subjects).filter(|(_, s)| **s == Subject::Finger);
    let fingers: Vec<&Prepared<'_>> = fingers.map(|(recording, _)| recording).collect();
    // Sixteen signals of contacts anywhere tell the normal force, and hardly the shear.
    let taxels = lag(&fingers, 2 * TAXELS, &[2], &|signals| {
        let c = signals.taxels?.map(f64::from);
        let sound = signals.health.dead | signals.health.saturated == 0;
        sound.then(|| c.into_iter().chain(c.map(|c| c * c)).collect())
    });
    let sensors = lag(&fingers, 3 * SENSORS, &[0, 1, 2], &|signals| {
        let any = signals.bridges.iter().any(Option::is_some);
        let all = signals.bridges.iter().flat_map(|u| u.unwrap_or_default()).map(f64::from);
        (any && signals.health.bridge_faults == 0).then(|| all.collect())
    });
    let of = |lag: Option<f64>| lag.unwrap_or_default() as f32;
    (taxels.is_some() || sensors.is_some())
        .then(|| LagCompensation { taxels: of(taxels), sensors: of(sensors) })
}

/// Recordings whose reference acts as late as their signals do once `lag` seconds are compensated.
///
/// A compensated signal still rounds off what changes within a lag ([`LagCompensation`]). A static
/// model that is fitted to it and to the exact force takes that for a property of the skin: the
/// reference passes the same lag and the same compensation instead.
pub(crate) fn followed<'r>(recordings: &'r [Prepared<'r>], lag: f32) -> Cow<'r, [Prepared<'r>]> {
    if lag <= 0.0 {
        return Cow::Borrowed(recordings);
    }
    let mut late = recordings.to_vec();
    late.iter_mut().for_each(|prepared| follow(prepared.recording.to_mut(), lag));
    Cow::Owned(late)
}

/// Replaces the forces of a recording by those that a lag and its compensation leave of them.
fn follow(recording: &mut Recording, lag: f32) {
    let compensation = LagCompensation { taxels: lag, sensors: lag };
    let (mut states, mut forces): (LagState, Option<[Late; FORCES]>) = Default::default();
    let mut before = recording.samples.first().map_or(0, |sample| sample.scan.time.0);
    for sample in &mut recording.samples {
        let now = sample.scan.time.0;
        let passed = now.saturating_sub(before);
        before = now;
        let truth = &mut sample.truth;
        let mut own = truth.force.iter().chain(truth.sensors.iter().flatten());
        let acts: [f64; FORCES] =
            std::array::from_fn(|_| own.next().copied().flatten().unwrap_or_default());
        let late = forces.get_or_insert(acts.map(Late::resting));
        let mut late = late.iter_mut().zip(acts).map(|(late, acts)| late.follow(acts, passed, lag));
        let mut next = || late.next().unwrap_or_default();
        let taxels = std::array::from_fn(|k| if k < 3 { next() } else { 0.0 });
        let bridges = std::array::from_fn(|_| Some(std::array::from_fn(|_| next())));
        let mut signals = Signals { taxels: Some(taxels), bridges, ..Signals::default() };
        compensation.advance(&mut states, u32::try_from(passed).unwrap_or(u32::MAX), &mut signals);
        let seen = signals.taxels.iter().flatten().take(3);
        let seen = seen.chain(signals.bridges.iter().flatten().flatten());
        let known = truth.force.iter_mut().chain(truth.sensors.iter_mut().flatten());
        for (force, seen) in known.zip(seen) {
            *force = force.map(|_| f64::from(*seen));
        }
    }
}

/// Components of the force on the finger and of those on its sensors.
const FORCES: usize = 3 + 3 * SENSORS;

/// A force after two equal low-passes that together take the lag, as [Ospina2017] eq. (1.25) has
/// them; between two rows the force is a straight line.
#[derive(Clone, Copy)]
struct Late {
    force: f64,
    passes: [f64; 2],
}

impl Late {
    fn resting(force: f64) -> Self {
        Self { force, passes: [force; 2] }
    }

    fn follow(&mut self, force: f64, passed: u64, lag: f32) -> f32 {
        // Halves of the lag in the time that has passed.
        let turns = passed as f64 * 1e-6 / (0.5 * f64::from(lag));
        let (mut from, mut to) = (self.force, force);
        for pass in &mut self.passes {
            let before = *pass;
            if turns > 0.0 {
                let left = (-turns).exp();
                let slope = (to - from) / turns;
                *pass = to - slope + left * (before - from + slope);
            }
            (from, to) = (before, *pass);
        }
        self.force = force;
        to as f32
    }
}

/// Line for the user.
pub(crate) fn told(lag: LagCompensation) -> String {
    let [taxels, sensors] = [lag.taxels, lag.sensors].map(|lag| 1e3 * lag);
    format!(
        "lag behind the force, compensated: taxels {taxels:.1} ms, force sensors {sensors:.1} ms"
    )
}

fn size([x, y, z]: [f64; 3]) -> f64 {
    x.hypot(y).hypot(z)
}

/// Features of a row's signals; `None` if a channel is faulty.
type Features<'f> = &'f dyn Fn(&Signals) -> Option<Vec<f64>>;

/// Lag of one kind of channel, from the force components `axes`.
fn lag(
    recordings: &[&Prepared<'_>],
    width: usize,
    axes: &[usize],
    features: Features<'_>,
) -> Option<f64> {
    let (mut weights, mut weighted) = (0.0, 0.0);
    for axis in axes {
        let mut equations = Equations::new(width + 2);
        recordings.iter().for_each(|recording| rows(recording, *axis, features, &mut equations));
        // The last column but one is the rate.
        if let Some((lag, sigma)) = equations.solve().map(|solved| solved.coefficient(width)) {
            weights += sigma.powi(-2);
            weighted += lag * sigma.powi(-2);
        }
    }
    let [least, longest] = WORTH;
    let (lag, sigma) = (weighted / weights, f64::sqrt(1.0 / weights));
    ((least..longest).contains(&lag) && lag > CLEAR * sigma).then_some(lag)
}

/// Adds the loaded rows of a recording, from signals to one component of its force.
fn rows(prepared: &Prepared<'_>, axis: usize, features: Features<'_>, equations: &mut Equations) {
    let samples = &prepared.recording.samples;
    let force = |i: usize| -> Option<[f64; 3]> {
        let [x, y, z] = samples.get(i)?.truth.force;
        // A recording with the normal force alone has no shear.
        Some([x.unwrap_or(0.0), y.unwrap_or(0.0), z?])
    };
    let known = |i: usize| samples[i].truth.force[axis].is_some();
    let seconds = |i: usize| samples[i].scan.time.0 as f64 * 1e-6;
    let most = (0..samples.len()).filter_map(force).map(size).fold(0.0, f64::max);
    let (mut before, mut after) = (0, 0);
    for at in 0..samples.len() {
        let now = seconds(at);
        // The nearest rows at least BESIDE away; beside a gap there are none.
        while before + 1 < at && seconds(before + 1) <= now - BESIDE {
            before += 1;
        }
        while after + 1 < samples.len() && seconds(after) < now + BESIDE {
            after += 1;
        }
        let span = seconds(after) - seconds(before);
        let near = before < at && at < after && span < 6.0 * BESIDE;
        let (Some(own), Some(first), Some(last)) = (force(at), force(before), force(after)) else {
            continue;
        };
        if !near || !known(at) || size(own) < LOADED * most {
            continue;
        }
        let Some(mut row) = features(&prepared.signals[at]) else { continue };
        let rate = (last[axis] - first[axis]) / span;
        row.extend([rate, size(own).copysign(rate)]);
        equations.add(row, own[axis]);
    }
}

/// Normal equations.
struct Equations {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    squares: f64,
    rows: usize,
}

impl Equations {
    fn new(width: usize) -> Self {
        Self {
            matrix: DMatrix::zeros(width, width),
            right: DVector::zeros(width),
            squares: 0.0,
            rows: 0,
        }
    }

    fn add(&mut self, row: Vec<f64>, force: f64) {
        let row = DVector::from_vec(row);
        self.matrix.ger(1.0, &row, &row, 1.0);
        self.right.axpy(force, &row, 1.0);
        self.squares += force * force;
        self.rows += 1;
    }

    /// Solves for all coefficients.
    fn solve(mut self) -> Option<Solution> {
        if self.rows < LEAST_ROWS || self.squares == 0.0 {
            return None;
        }
        // A column without signals gets no coefficient; each other is shrunk by a billionth.
        for i in 0..self.right.len() {
            let own = &mut self.matrix[(i, i)];
            *own = if *own == 0.0 { 1.0 } else { *own * (1.0 + 1e-9) };
        }
        let factor = Cholesky::new(self.matrix)?;
        let found = factor.solve(&self.right);
        let left = (self.squares - found.dot(&self.right)).max(0.0) / self.rows as f64;
        Some(Solution { found, factor, left })
    }
}

/// Least-squares coefficients, with the mean square that they leave.
struct Solution {
    found: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
    left: f64,
}

impl Solution {
    /// Coefficient of a column and its standard deviation.
    fn coefficient(&self, at: usize) -> (f64, f64) {
        let mut unit = DVector::zeros(self.found.len());
        unit[at] = 1.0;
        let variance = self.left * self.factor.solve(&unit)[at];
        // An exact fit has the deviation of rounding.
        (self.found[at], variance.max(1e-24).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taxel::condition::Bias;
    use taxel_files::trace::Truth;

    use crate::recording::bare_sample;

    /// Presses of 0.2 s, one after the other, at 1 kHz.
    fn presses() -> Recording {
        let sample = |i: u32| {
            let turn = f64::from(i % 200) / 200.0 * std::f64::consts::TAU;
            let (fz, fx) = (0.5 - 0.5 * turn.cos(), 0.2 * turn.sin());
            let truth = Truth { force: [Some(fx), None, Some(fz)], ..Truth::default() };
            bare_sample(u64::from(i) * 1000, truth)
        };
        Recording { name: "presses".into(), samples: (0..2000).map(sample).collect() }
    }

    /// Forces that a skin of two time constants of 2 ms and its compensation leave, with the
    /// skin in steps of a microsecond.
    fn seen(recording: &Recording, lag: f32) -> Vec<f64> {
        let compensation = LagCompensation { taxels: lag, sensors: 0.0 };
        let (mut state, mut skin) = (LagState::default(), [0.0; 2]);
        let mut last = 0.0;
        let seen = recording.samples.iter().map(|sample| {
            let force = sample.truth.force[2].unwrap();
            for step in 1..=1000 {
                let now = last + (force - last) * f64::from(step) / 1000.0;
                skin[0] += (now - skin[0]) / 2000.0;
                skin[1] += (skin[0] - skin[1]) / 2000.0;
            }
            last = force;
            let taxels = Some([skin[1] as f32; TAXELS]);
            let mut signals = Signals { taxels, ..Signals::default() };
            compensation.advance(&mut state, 1000, &mut signals);
            f64::from(signals.taxels.unwrap()[0])
        });
        seen.collect()
    }

    fn most(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).skip(200).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn followed_force_is_that_of_the_compensated_signals() {
        let (exact, mut followed) = (presses(), presses());
        follow(&mut followed, 4e-3);
        let normal = |r: &Recording| -> Vec<f64> {
            r.samples.iter().filter_map(|sample| sample.truth.force[2]).collect()
        };
        let seen = seen(&exact, 4e-3);
        let [off, left] = [&exact, &followed].map(|r| most(&normal(r), &seen));
        assert!(off > 2.5e-3, "a press of 0.2 s is rounded off by thousandths: {off}");
        assert!(left < 3e-4, "{left}");
        assert!(
            followed
                .samples
                .iter()
                .all(|s| s.truth.force[1].is_none() && s.truth.point == [None; 2])
        );
    }

    #[test]
    fn finger_without_lag_keeps_its_reference() {
        let recording = presses();
        let prepared = Prepared {
            recording: Cow::Borrowed(&recording),
            bias: Bias::default(),
            signals: Vec::new(),
        };
        let same = std::slice::from_ref(&prepared);
        let followed = followed(same, 0.0);
        assert_eq!(*followed[0].recording, recording);
    }
}
