//! Fit of the lags of skin and force sensors behind the reference force.
//!
//! Signals that are late by T tell the force of T ago, F − T·Ḟ. By least squares the reference is
//! therefore a function of the signals and T times its own rate. A press differs by its direction,
//! too, because rubber has hysteresis; a column of its own keeps that from being taken for a lag.

use nalgebra::{Cholesky, DMatrix, DVector};
use taxel::condition::{LagCompensation, Signals};
use taxel::scan::{SENSORS, TAXELS};

use crate::prepared::{Prepared, Subject};

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

/// Fits the lags to the recordings of the finger; `None` if neither skin nor force sensors are late.
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

/// Line for the user.
pub(crate) fn told(lag: LagCompensation) -> String {
    let [taxels, sensors] = [lag.taxels, lag.sensors].map(|lag| 1e3 * lag);
    format!(
        "lag behind the force, compensated: taxels {taxels:.1} ms, force sensors {sensors:.1} ms"
    )
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
        if let Some((lag, sigma)) = equations.solve() {
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
    let size = |[x, y, z]: [f64; 3]| x.hypot(y).hypot(z);
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

/// Normal equations, whose last column but one is the rate.
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

    /// Returns the rate's coefficient and its standard deviation.
    fn solve(mut self) -> Option<(f64, f64)> {
        if self.rows < LEAST_ROWS || self.squares == 0.0 {
            return None;
        }
        let width = self.right.len();
        // A column without signals gets no coefficient; each other is shrunk by a billionth.
        for i in 0..width {
            let own = &mut self.matrix[(i, i)];
            *own = if *own == 0.0 { 1.0 } else { *own * (1.0 + 1e-9) };
        }
        let factor = Cholesky::new(self.matrix)?;
        let found = factor.solve(&self.right);
        let left = (self.squares - found.dot(&self.right)).max(0.0) / self.rows as f64;
        let at = width - 2;
        let mut unit = DVector::zeros(width);
        unit[at] = 1.0;
        let variance = left * factor.solve(&unit)[at];
        // An exact fit has the deviation of rounding.
        Some((found[at], variance.max(1e-24).sqrt()))
    }
}
