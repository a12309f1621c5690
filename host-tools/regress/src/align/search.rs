//! Coarse search of an alignment: every offset and many rates, by cross-correlation.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

use super::{Series, median_step};

/// Largest relative difference of two clocks, including a wrong nominal rate.
const FARTHEST_RATE: f64 = 0.05;
/// Most points on which the correlation is searched.
const MOST_POINTS: usize = 8192;
/// Most rates that are tried.
pub(super) const MOST_RATES: usize = 401;

/// First principal component of a series: one value a row, about zero.
pub(super) struct Trace<'s> {
    pub times: &'s [f64],
    values: Vec<f64>,
}

impl<'s> Trace<'s> {
    /// Projects a series; `None` if it never changes.
    pub fn new(series: Series<'s>) -> Option<Self> {
        let width = series.rows.first()?.len();
        let rows = DMatrix::from_fn(series.rows.len(), width, |row, i| series.rows[row][i]);
        let means = rows.row_mean();
        let mut centred = rows;
        centred.row_iter_mut().for_each(|mut row| row -= &means);
        let eigen = SymmetricEigen::new(centred.tr_mul(&centred));
        let most = eigen.eigenvalues.imax();
        if eigen.eigenvalues[most] <= 1e-12 * means.norm_squared() * centred.nrows() as f64 {
            return None;
        }
        let values: DVector<f64> = centred * eigen.eigenvectors.column(most);
        Some(Self { times: series.times, values: values.as_slice().to_vec() })
    }

    /// Value at a time, interpolated between two rows; `None` beyond the ends.
    pub fn at(&self, t: f64) -> Option<f64> {
        let next = self.times.partition_point(|known| *known < t).max(1);
        let (a, b) = (self.times[next - 1], *self.times.get(next)?);
        let share = (t - a) / (b - a);
        (share >= 0.0).then(|| self.values[next - 1] * (1.0 - share) + self.values[next] * share)
    }

    fn span(&self) -> f64 {
        self.times[self.times.len() - 1] - self.times[0]
    }
}

/// Best offset and rate, with the correlation of the best clearly different offset.
pub(super) struct Coarse {
    pub offset: f64,
    pub rate: f64,
    pub correlation: f64,
    pub second: f64,
}

pub(super) fn search(own: &Trace<'_>, other: &Trace<'_>) -> Coarse {
    let span = own.span().max(other.span());
    let step = median_step(own.times).max(median_step(other.times)).max(span / MOST_POINTS as f64);
    let size = 2 * (span / step).ceil() as usize + 2;
    let size = size.next_power_of_two();
    let mut planner = FftPlanner::new();
    let (forth, back) = (planner.plan_fft_forward(size), planner.plan_fft_inverse(size));
    let spectrum = |value: &dyn Fn(usize) -> f64| {
        let mut points: Vec<Complex<f64>> = (0..size).map(|i| value(i).into()).collect();
        let energy: f64 = points.iter().map(|p| p.norm_sqr()).sum();
        forth.process(&mut points);
        (points, energy.max(f64::MIN_POSITIVE).sqrt())
    };
    let (fixed, own_energy) =
        spectrum(&|i| own.at(own.times[0] + i as f64 * step).unwrap_or_default());
    // Width of a press: the lag at which the autocorrelation falls to a half.
    let width = correlation_time(&fixed, &*back) as f64 * step;
    let count = (2.0 * FARTHEST_RATE * span / width.max(step)).ceil() as usize | 1;
    let mut best = Coarse { offset: 0.0, rate: 0.0, correlation: -1.0, second: 0.0 };
    for rate in rates(count.clamp(21, MOST_RATES)) {
        // Sample i of the other at the sensor's time of step i.
        let sample = |i: usize| {
            other.at(other.times[0] + (1.0 + rate) * i as f64 * step).unwrap_or_default()
        };
        let (mut product, energy) = spectrum(&sample);
        product.iter_mut().zip(&fixed).for_each(|(p, f)| *p *= f.conj());
        back.process(&mut product);
        let norm = 1.0 / (size as f64 * own_energy * energy);
        // The sign of a principal component is arbitrary.
        let height = |lag: usize| product[lag].re.abs() * norm;
        let Some(peak) = (0..size).max_by(|a, b| height(*a).total_cmp(&height(*b))) else {
            continue;
        };
        if height(peak) > best.correlation {
            let signed = if peak > size / 2 { peak as f64 - size as f64 } else { peak as f64 };
            let apart = |lag: usize| {
                let apart = lag.abs_diff(peak);
                apart.min(size - apart) as f64 * step > 2.0 * width
            };
            let second = (0..size).filter(|lag| apart(*lag)).map(height).fold(0.0, f64::max);
            // own(t0 + i·step) matches other(t0′ + (1 + rate)(i + lag)·step).
            let offset = other.times[0] + (1.0 + rate) * (signed * step - own.times[0]);
            best = Coarse { offset, rate, correlation: height(peak), second };
        }
    }
    best
}

/// Rates in even steps from the slowest clock to the fastest.
pub(super) fn rates(count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| FARTHEST_RATE * (2.0 * i as f64 / (count - 1) as f64 - 1.0))
}

/// Lag at which the autocorrelation has fallen to a half.
fn correlation_time(spectrum: &[Complex<f64>], back: &dyn rustfft::Fft<f64>) -> usize {
    let mut power: Vec<Complex<f64>> = spectrum.iter().map(|s| s.norm_sqr().into()).collect();
    back.process(&mut power);
    power.iter().position(|p| p.re < 0.5 * power[0].re).unwrap_or(1).max(1)
}
