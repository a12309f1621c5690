//! Lag of a finger whose reference has a clock of its own.

use taxel::scan::TAXELS;
use taxel_regress::align::{self, Series};

use super::{BESIDE, Equations, WORTH};

/// Least square of half a lag behind another clock, in its standard deviations.
const CLEAR_BEND: f64 = 8.0;
/// Largest share of a force's mean square that the channels leave beside the reference's noise.
/// The signals of the matrix bend, and what they leave where the force sensors are missing looks
/// like a lag.
const UNEXPLAINED: f64 = 0.002;
/// Fewest channels of force sensors that tell the force linearly: those of three sensors.
const LINEAR: usize = 9;
/// Least lag behind another clock, seconds: the force sensors are not quite linear.
const LEAST_HIDDEN: f64 = 1e-3;

/// Lag that an alignment by the load has taken for an offset of the clocks, in seconds; `None` if
/// none is clear.
///
/// With F the force at an instant, two equal low-passes of T/2 leave the signal s with
/// F = s + T·ṡ + ¼T²·s̈. A reference that is read δ too early, F(t − δ), is
/// s + (T − δ)·ṡ + (¼T² − T·δ + ½δ²)·s̈: the alignment makes the coefficient a of ṡ vanish, and
/// ½a² less that of s̈, ¼T², still tells the lag. The coefficients are those of the `channels`'
/// prediction of the force, which is linear, and with one or two force sensors quadratic in the
/// signals of the matrix. Only the `readings` themselves count, because a curve between them errs
/// where a press begins. Their times are those of the channels' clock, and `noise` is that of each
/// of their components.
pub(crate) fn hidden(channels: Series<'_>, readings: Series<'_>, noise: &[f64]) -> Option<f64> {
    let step = align::median_step(channels.times);
    let predictors = Predictors::of(channels.rows);
    let nearest: Vec<Option<usize>> =
        readings.times.iter().map(|t| nearest(channels.times, *t, step)).collect();
    let (mut weights, mut quarters, mut rates) = (0.0, 0.0, 0.0);
    for (axis, noise) in noise.iter().enumerate() {
        let known = nearest.iter().zip(readings.times).zip(readings.rows);
        let known = known.filter_map(|((row, t), force)| Some(((*row)?, *t, force[axis])));
        let known: Vec<_> = known.collect();
        let Some(found) = bent((channels.times, &predictors), &known, step, *noise) else {
            continue;
        };
        let [(rate, of_rate), (bend, of_bend)] = found;
        let weight = (of_bend.powi(2) + (rate * of_rate).powi(2)).recip();
        weights += weight;
        quarters += weight * (0.5 * rate * rate - bend);
        rates += weight * rate;
    }
    let (quarter, rate) = (quarters / weights, rates / weights);
    let lag = 2.0 * quarter.sqrt();
    let clear =
        quarter > CLEAR_BEND * weights.sqrt().recip() && (LEAST_HIDDEN..WORTH[1]).contains(&lag);
    clear.then_some(lag - rate)
}

/// Row nearest to a time, within `step`.
fn nearest(times: &[f64], t: f64, step: f64) -> Option<usize> {
    let after = times.partition_point(|own| *own < t);
    let away = |i: &usize| times.get(*i).map_or(f64::MAX, |own| (own - t).abs());
    let rows = [after.saturating_sub(1), after];
    rows.into_iter().min_by(|a, b| away(a).total_cmp(&away(b))).filter(|row| away(row) <= step)
}

/// Functions of the channels that predict a force.
struct Predictors<'r> {
    rows: &'r [Vec<f64>],
    /// Origin of the products, whose equations would be ill-conditioned about zero.
    mean: Vec<f64>,
    /// Whether products of the matrix's signals are among them.
    products: bool,
    width: usize,
}

impl<'r> Predictors<'r> {
    fn of(rows: &'r [Vec<f64>]) -> Self {
        let channels = rows.first().map_or(0, Vec::len);
        let products = (TAXELS + 1..TAXELS + LINEAR).contains(&channels);
        let mut mean = vec![0.0; channels];
        for row in rows.iter().filter(|_| products) {
            mean.iter_mut().zip(row).for_each(|(mean, level)| *mean += level / rows.len() as f64);
        }
        let width = channels + if products { TAXELS * (TAXELS + 1) / 2 } else { 0 };
        Self { rows, mean, products, width: width + 1 }
    }

    fn row(&self, i: usize) -> Vec<f64> {
        let centred = self.rows[i].iter().zip(&self.mean).map(|(level, mean)| level - mean);
        let mut row: Vec<f64> = centred.collect();
        for k in (0..TAXELS).filter(|_| self.products) {
            row.extend_from_within(k..TAXELS);
            let (own, last) = (row[k], row.len() - (TAXELS - k));
            row[last..].iter_mut().for_each(|other| *other *= own);
        }
        row.push(1.0);
        row
    }
}

/// Coefficients of rate and second derivative of the channels' prediction of a force, each with
/// its standard deviation, from readings: the nearest row, time and force of each.
///
/// The second derivative is that of the rows around, without the row itself, whose noise it would
/// smooth.
fn bent(
    (times, predictors): (&[f64], &Predictors<'_>),
    readings: &[(usize, f64, f64)],
    step: f64,
    noise: f64,
) -> Option<[(f64, f64); 2]> {
    let width = predictors.width;
    let mut plain = Equations::new(width);
    readings.iter().for_each(|(i, _, force)| plain.add(predictors.row(*i), *force));
    let plain = plain.solve()?.found;
    let told = |i: usize| predictors.row(i).iter().zip(&plain).map(|(x, w)| x * w).sum::<f64>();
    let near = ((BESIDE / step).round() as usize).max(1);
    let (beside, far) = (near as f64 * step, 2 * near);
    let mut equations = Equations::new(width + 3);
    for (i, t, force) in readings.iter().copied() {
        if i < far || i + far >= times.len() {
            continue;
        }
        // Beside a gap there is no derivative.
        if (times[i + far] - times[i - far] - 4.0 * beside).abs() > 0.5 * step {
            continue;
        }
        let [first, before, after, last] = [i - far, i - near, i + near, i + far].map(told);
        let rate = (after - before) / (2.0 * beside);
        let bend = (first - before - after + last) / (3.0 * beside * beside);
        let mut row = predictors.row(i);
        row.extend([told(i).abs().copysign(rate), rate, bend]);
        equations.add(row, force + (times[i] - t) * rate);
    }
    let most = UNEXPLAINED * equations.squares / equations.rows as f64 + noise * noise;
    let solved = equations.solve().filter(|solved| solved.left < most)?;
    Some([width + 1, width + 2].map(|at| solved.coefficient(at)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lag::Late;

    /// Times and rows.
    type Log = (Vec<f64>, Vec<Vec<f64>>);

    fn series((times, rows): &Log) -> Series<'_> {
        Series { times, rows }
    }

    /// Presses behind a lag, at 500 Hz, and a cell's readings of their force at 100 Hz, read
    /// `early` seconds too early.
    fn logged(force: fn(f64) -> f64, lag: f32, early: f64) -> [Log; 2] {
        let noise = |i: usize, size: f64| size * ((i * i) as f64 * 12.9898).sin();
        let mut late = Late::resting(0.0);
        let times: Vec<f64> = (0..20_000).map(|i| f64::from(i) * 2e-3).collect();
        let signals = times.iter().enumerate().map(|(i, t)| {
            let after = f64::from(late.follow(force(*t), 2000, lag));
            vec![0.3 * after + noise(i, 2e-4), 0.2 * after + noise(i + 5, 2e-4)]
        });
        let signals = signals.collect();
        let read: Vec<f64> = times.iter().step_by(5).copied().collect();
        let forces = read.iter().enumerate();
        let forces = forces.map(|(i, t)| vec![force(t - early) + noise(i, 6e-3)]).collect();
        [(times, signals), (read, forces)]
    }

    /// Presses of 0.2 s that begin softly, with rests.
    fn soft(t: f64) -> f64 {
        0.5 - 0.5 * ((t % 0.3037).min(0.2) * std::f64::consts::TAU / 0.2).cos()
    }

    /// Presses of 0.132 s that begin at their full speed.
    fn hard(t: f64) -> f64 {
        (t * std::f64::consts::TAU / 0.2637).sin().max(0.0)
    }

    #[test]
    fn lag_behind_another_clock_is_found() {
        let cases =
            [(soft as fn(f64) -> f64, 4e-3, 7e-4), (soft, 4.2e-3, 7e-4), (hard, 4e-3, 1e-3)];
        for (force, early, most) in cases {
            let [channels, readings] = logged(force, 4e-3, early);
            let found = hidden(series(&channels), series(&readings), &[0.0]).expect("a lag");
            assert!((found - early).abs() < most, "{early}: {found}");
        }
    }

    #[test]
    fn offset_of_clocks_alone_is_no_lag() {
        for force in [soft as fn(f64) -> f64, hard] {
            for early in [1e-4, -4e-4] {
                let [channels, readings] = logged(force, 1e-4, early);
                assert_eq!(hidden(series(&channels), series(&readings), &[0.0]), None, "{early}");
            }
        }
    }
}
