//! One gain a taxel, found with the skin model or else with the net.
//!
//! The gains are folded into all estimators of the taxels' signals. The skin model uses more of a
//! press than its force: with the right gains all sixteen displacements are those of one contact.

use std::borrow::Cow;

use nalgebra::{Const, DVector, Dyn, OMatrix, SMatrix, SVector};
use taxel::calibration::{Calibration, TaxelCalibration};
use taxel::estimate::inverse::{ContactFit, Inverse, InverseState};
use taxel::estimate::net::ForceNet;
use taxel::estimate::quantised::{Net, QuantisedNet};
use taxel::scan::TAXELS;

use super::{AGED, Adjusted, COMMON, Helped, LEAST_PRESSES, Press, Row};
use crate::inverse::neighbours;
use crate::quantise;
use taxel_regress::error::FitError;
use taxel_regress::metrics::surely_less;

/// Standard deviation of the part of a taxel's gain that the unloaded light does not show.
const OWN: f64 = 0.05;
/// Largest ratio of a net's error on the presses to its own residual without ageing.
///
/// A net's own error is similar in presses of one weight. Gains could remove it there and add it
/// elsewhere.
const YOUNG: f64 = 2.0;
/// Most steps of Gauss–Newton; from the first guess it converges in fewer.
const STEPS: usize = 10;
/// Shares of a step that are tried, until one reduces the squared errors.
const SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.1];
/// Share of the squared errors that a step has to remove for another one to follow.
const SETTLED: f64 = 1e-3;
/// Frames in which the skin model follows a row from a cold start. The start of its steps follows
/// the shear by a quarter a frame, and must stand still before derivatives are taken.
///
/// It settles in two from nearly equal signals.
const FRAMES: usize = 40;
const FEW_FRAMES: usize = 2;
/// Least standard deviation of a force, newtons.
const LEAST_SIGMA: f64 = 1e-3;

type Gains = SVector<f64, TAXELS>;
type Jacobian = OMatrix<f64, Dyn, Const<TAXELS>>;

/// Finds the gains and, where they surely help, folds them in.
///
/// # Errors
///
/// The 16-bit net cannot hold them.
pub(super) fn adjust(
    adjusted: &mut Adjusted,
    before: &Calibration,
    presses: &[Press],
) -> Result<(), FitError> {
    let Some(old) = before.taxels.as_ref() else { return Ok(()) };
    let Some(new) = adjusted.calibration.taxels.as_ref().map(|taxels| taxels.bias) else {
        return Ok(());
    };
    let skin = before.model.as_ref().map(Estimator::Skin);
    let net = net_of(before);
    let net = net.as_deref().map(Estimator::Net);
    let estimators: Vec<Estimator> = skin.into_iter().chain(net).collect();
    let Some(best) = estimators.first().copied() else { return Ok(()) };
    let known = |press: &&Press| press.iter().any(|row| row.c.is_some() && row.force[2].is_some());
    let presses: Vec<&Press> = presses.iter().filter(known).collect();
    if presses.len() < LEAST_PRESSES {
        adjusted.warnings.push(format!(
            "the taxels: {} presses with a known force on the finger where {LEAST_PRESSES} are needed; their \
             gains stay",
            presses.len()
        ));
        return Ok(());
    }
    let light = Gains::from_fn(|k, _| {
        let ratio = f64::from(new.level[k]) / f64::from(old.bias.level[k]);
        if ratio > 0.0 { ratio.ln() } else { 0.0 }
    });
    let sigma = old.residual.map(|r| f64::from(r).max(LEAST_SIGMA));
    let problem = Problem { estimator: best, light, sigma };
    let left_out: Vec<Gains> = (0..presses.len())
        .map(|i| {
            let others: Vec<&Press> =
                presses.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, p)| *p).collect();
            problem.solve(&others)
        })
        .collect();
    let gains = problem.solve(&presses).map(f64::exp);
    let rms = |squares: &[f64]| (squares.iter().sum::<f64>() / presses.len() as f64).sqrt();
    let mut squares = Vec::new();
    for estimator in &estimators {
        let each = presses.iter().zip(&left_out);
        let [before, after]: [Vec<f64>; 2] = [
            each.clone().map(|(press, _)| square(*estimator, &Gains::zeros(), press)).collect(),
            each.map(|(press, gains)| square(*estimator, gains, press)).collect(),
        ];
        let estimator = estimator.name();
        let (was, is) = (rms(&before), rms(&after));
        adjusted.helped.push(Helped { estimator, before: was, after: is });
        squares.push((estimator, before, after));
    }
    let spread = gains.iter().fold(0.0, |most: f64, gain| most.max((gain - 1.0).abs()));
    let unhelped = squares
        .iter()
        .filter(|(_, before, after)| !surely_less(after, before))
        .map(|(name, ..)| *name);
    let unhelped: Vec<&str> = unhelped.collect();
    let outputs = before.net.as_ref().map_or(3, Net::outputs);
    let expected = f64::from(old.residual[outputs.min(3) - 1]);
    let met = adjusted.helped.first().map_or(0.0, |helped| helped.before);
    let refused = if matches!(best, Estimator::Net(_)) && met <= YOUNG * expected {
        Some(format!(
            "the net's error on the presses is {:.1} mN, no more than twice the {:.1} mN on its own \
             recordings: no ageing is visible",
            1e3 * met,
            1e3 * expected
        ))
    } else if unhelped.contains(&best.name()) {
        Some("gains from all but one press do not reliably improve that one".to_owned())
    } else if spread > AGED {
        let percent = 100.0 * spread;
        Some(format!("a taxel's gain would change by {percent:.0} %, which is more than ageing"))
    } else {
        for name in unhelped {
            adjusted.warnings.push(format!(
                "the gains do not reliably improve the {name}; fit it again for more"
            ));
        }
        None
    };
    adjusted.taxels = vec![1.0; TAXELS];
    let left = adjusted.helped.first().map(|h| if refused.is_none() { h.after } else { h.before });
    match refused {
        Some(why) => {
            adjusted.warnings.push(format!("the taxels: {why}; they stay, the bias is new"));
        }
        None => {
            adjusted.taxels = gains.iter().copied().collect();
            fold(&mut adjusted.calibration, &gains)?;
        }
    }
    if let Some(left) = left.filter(|left| *left > 5.0 * expected) {
        adjusted.warnings.push(format!(
            "the {}: {:.1} mN are left on presses not used, where the record's own residual was {:.1} mN; \
             fit again for more",
            best.name(),
            1e3 * left,
            1e3 * expected
        ));
    }
    Ok(())
}

/// Estimator of the taxels' signals.
#[derive(Clone, Copy)]
enum Estimator<'r> {
    Net(&'r ForceNet),
    Skin(&'r Inverse),
}

impl Estimator<'_> {
    fn name(self) -> &'static str {
        match self {
            Self::Net(_) => "net",
            Self::Skin(_) => "model of the skin",
        }
    }

    fn normal(self, c: &[f32; TAXELS]) -> Option<f32> {
        match self {
            Self::Net(net) => net.forces(c).last().copied(),
            Self::Skin(model) => {
                let (_, touch) = follow(model, c, &mut InverseState::default(), FRAMES)?;
                Some(touch.load.normal())
            }
        }
    }

    /// Normalised errors of a row: known force components and, with the skin model, displacements.
    ///
    /// `state` is the model's state before the `frames` of this row.
    fn errors(
        self,
        c: &[f32; TAXELS],
        (row, sigma): (&Row, &[f64; 3]),
        state: &mut InverseState,
        frames: usize,
    ) -> Vec<f64> {
        match self {
            Self::Net(net) => {
                let found = net.forces(c);
                let truth = if found.len() == 1 { &row.force[2..] } else { &row.force[..] };
                let known = found.iter().zip(truth).zip(sigma);
                known.filter_map(|((f, t), s)| Some((f64::from(*f) - (*t)?) / s)).collect()
            }
            Self::Skin(model) => {
                let found = row.force[2].zip(follow(model, c, state, frames));
                let Some((normal, (u, touch))) = found else { return Vec::new() };
                let around = model.field.around(&touch.load);
                let trusted = f64::from(model.error[0] + model.error[1] * touch.load.normal());
                let missed = u.iter().zip(model.centres.0).map(|(u, facet)| {
                    let sinks =
                        if model.shear { around.sheared(facet).0 } else { around.pressed(facet).0 };
                    f64::from(u - sinks) / trusted
                });
                let sigma = f64::from(touch.sigma[2]).max(LEAST_SIGMA);
                let force = (f64::from(touch.load.normal()) - normal) / sigma;
                missed.chain([force]).collect()
            }
        }
    }
}

/// Displacements and touch after so many frames of the same signals.
fn follow(
    model: &Inverse,
    c: &[f32; TAXELS],
    state: &mut InverseState,
    frames: usize,
) -> Option<([f32; TAXELS], ContactFit)> {
    let u = model.curves.displacements(c);
    let mut frame =
        || if model.shear { model.sheared(state, &u, None) } else { model.pressed(state, &u) };
    let touch = (0..frames).map(|_| frame()).last()?.ok()?;
    Some((u, touch))
}

/// Net of the record in f32; a 16-bit net is converted.
fn net_of(calibration: &Calibration) -> Option<Cow<'_, ForceNet>> {
    calibration.net.as_ref().map(|net| match net {
        Net::Float(net) => Cow::Borrowed(net),
        Net::Quantised(net) => Cow::Owned(quantise::float(net)),
    })
}

/// Divides the signals by their gains; `gains` are logarithms.
fn younger(gains: &Gains, c: &[f32; TAXELS]) -> [f32; TAXELS] {
    std::array::from_fn(|k| (f64::from(c[k]) * (-gains[k]).exp()) as f32)
}

/// Mean square error of f_z over a press, newtons²; without an estimate the error is the force.
fn square(estimator: Estimator<'_>, gains: &Gains, press: &Press) -> f64 {
    let error = |row: &Row| {
        let found = estimator.normal(&younger(gains, row.c.as_ref()?)).unwrap_or_default();
        Some((f64::from(found) - row.force[2]?).powi(2))
    };
    let squares: Vec<f64> = press.iter().filter_map(error).collect();
    squares.iter().sum::<f64>() / squares.len().max(1) as f64
}

/// Folds the gains into the record: coefficients are divided as the signals are multiplied.
fn fold(calibration: &mut Calibration, gains: &Gains) -> Result<(), FitError> {
    if let Some(model) = &mut calibration.model {
        fold_model(model, gains);
    }
    let Some(taxels) = &mut calibration.taxels else { return Ok(()) };
    for (range, gain) in taxels.range.iter_mut().zip(gains) {
        *range = range.map(|end| (f64::from(end) * gain) as f32);
    }
    match &mut calibration.net {
        Some(Net::Float(net)) => fold_net(net, gains),
        Some(Net::Quantised(net)) => *net = requantised(net, taxels, gains)?,
        None => {}
    }
    Ok(())
}

fn fold_net(net: &mut ForceNet, gains: &Gains) {
    for row in
        net.units.iter_mut().map(|unit| &mut unit.weights).chain(net.skip.iter_mut().flatten())
    {
        row.iter_mut().zip(gains).for_each(|(w, gain)| *w = (f64::from(*w) / gain) as f32);
    }
}

fn requantised(
    net: &QuantisedNet,
    taxels: &TaxelCalibration,
    gains: &Gains,
) -> Result<QuantisedNet, FitError> {
    let mut float = quantise::float(net);
    fold_net(&mut float, gains);
    quantise::whole(&float, taxels)
}

/// Folds the gains into the skin model.
///
/// A curve's n-th coefficient scales with the n-th power of the signal. For stray light both the
/// receiving taxel and its source have gains.
fn fold_model(model: &mut Inverse, gains: &Gains) {
    let steepness = |model: &Inverse| -> f64 {
        model.curves.gap.iter().map(|gap| f64::from(gap[0]).powi(2)).sum()
    };
    let before = steepness(model);
    for (k, (gap, stray)) in model.curves.gap.iter_mut().zip(&mut model.curves.stray).enumerate() {
        for (power, coefficient) in (1..).zip(gap) {
            *coefficient = (f64::from(*coefficient) / gains[k].powi(power)) as f32;
        }
        for (share, neighbour) in stray.iter_mut().zip(neighbours(k)) {
            let other = neighbour.map_or(gains[k], |neighbour| gains[neighbour]);
            *share = (f64::from(*share) * gains[k] / other) as f32;
        }
    }
    // The error floor is the displacement noise due to the signals' noise, which stays.
    let floor = (steepness(model) / before.max(f64::MIN_POSITIVE)).sqrt();
    model.error[0] = (f64::from(model.error[0]) * floor) as f32;
}

/// Problem of the most probable logarithms of the gains.
struct Problem<'e> {
    estimator: Estimator<'e>,
    /// Logarithms estimated from the unloaded light.
    light: Gains,
    /// RMS error of the net on its own recordings, newtons, for each output.
    sigma: [f64; 3],
}

impl Problem<'_> {
    fn solve(&self, presses: &[&Press]) -> Gains {
        // Covariance COMMON²·11ᵀ + OWN²·1, inverted by Sherman and Morrison.
        let share = COMMON.powi(2) / (OWN.powi(2) + TAXELS as f64 * COMMON.powi(2));
        let prior =
            (SMatrix::<f64, TAXELS, TAXELS>::identity() - SMatrix::repeat(share)) / OWN.powi(2);
        let cost = |gains: &Gains| -> f64 {
            let off = gains - self.light;
            let rows = presses.iter().flat_map(|press| press.iter().map(|row| (row, press.len())));
            let misses = rows.map(|(row, rows)| self.miss(gains, row) / rows as f64);
            off.dot(&(prior * off)) + misses.sum::<f64>()
        };
        let mut gains = self.light;
        let mut left = cost(&gains);
        for _ in 0..STEPS {
            let mut curvature = prior;
            let mut slope = prior * (self.light - gains);
            for press in presses {
                let weight = 1.0 / press.len() as f64;
                for row in *press {
                    let (errors, jacobian) = self.linear(&gains, row);
                    curvature += jacobian.tr_mul(&jacobian) * weight;
                    slope -= jacobian.tr_mul(&errors) * weight;
                }
            }
            let Some(step) = curvature.cholesky().map(|c| c.solve(&slope)) else { break };
            let shorter = SHARES.iter().map(|share| gains + step * *share);
            let tried = shorter.map(|gains| (cost(&gains), gains));
            let Some(next) = tried.into_iter().find(|(cost, _)| *cost < left) else { break };
            let gained = left - next.0;
            (left, gains) = next;
            if gained < SETTLED * left {
                break;
            }
        }
        gains
    }

    /// Sum of the squared normalised errors of a row.
    fn miss(&self, gains: &Gains, row: &Row) -> f64 {
        let Some(c) = &row.c else { return 0.0 };
        let mut state = InverseState::default();
        let known = (row, &self.sigma);
        let errors = self.estimator.errors(&younger(gains, c), known, &mut state, FRAMES);
        errors.iter().map(|error| error.powi(2)).sum()
    }

    /// Errors of a row and their derivatives by the gains' logarithms.
    fn linear(&self, gains: &Gains, row: &Row) -> (DVector<f64>, Jacobian) {
        const STEP: f64 = 1e-3;
        let Some(c) = &row.c else { return (DVector::zeros(0), Jacobian::zeros(0)) };
        let known = (row, &self.sigma);
        let mut settled = InverseState::default();
        let errors = self.estimator.errors(&younger(gains, c), known, &mut settled, FRAMES);
        let errors = DVector::from_vec(errors);
        let mut jacobian = Jacobian::zeros(errors.len());
        for k in 0..TAXELS {
            let mut moved = *gains;
            moved[k] += STEP;
            let mut state = settled;
            let moved = self.estimator.errors(&younger(&moved, c), known, &mut state, FEW_FRAMES);
            if moved.len() == errors.len() {
                jacobian.set_column(k, &((DVector::from_vec(moved) - &errors) / STEP));
            }
        }
        (errors, jacobian)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folded_gains_restore_displacements() {
        let wave = |k: usize, by: f32| by * (1.7 * k as f32).sin();
        let mut model = Inverse::default();
        for k in 0..TAXELS {
            model.curves.gap[k] = [-3.0 + wave(k, 0.5), -4.0, wave(k, 8.0), 2.0, wave(k, 5.0)];
            model.curves.stray[k] = [0.02, 0.01, 0.015 + wave(k, 0.01), 0.005];
        }
        let gains = Gains::from_fn(|k, _| 1.0 + 0.3 * (2.3 * k as f64).sin());
        let young: [f32; TAXELS] = std::array::from_fn(|k| wave(3 * k, 0.2));
        let old = std::array::from_fn(|k| (f64::from(young[k]) * gains[k]) as f32);
        let wanted = model.curves.displacements(&young);
        fold_model(&mut model, &gains);
        for (found, wanted) in model.curves.displacements(&old).iter().zip(wanted) {
            assert!((found - wanted).abs() < 1e-5, "{found} {wanted}");
        }
    }
}
