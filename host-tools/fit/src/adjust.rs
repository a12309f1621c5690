//! In-place recalibration: bias and gains anew from a few presses with known weights.
//!
//! What ages is the light of the LEDs, the gain of the phototransistors and the softness of the skin; the
//! form of the response stays. So each taxel gets one gain g_k, and its signal is divided by it:
//!
//! - Light and phototransistor scale what a taxel reads unloaded as they scale its signal, so that the
//!   unloaded light is a first guess of g_k, [`OWN`] sure.
//! - The skin scales all signals alike, and nothing but a known weight tells how much: [`COMMON`] unsure.
//!
//! The gains are the most probable ones under these priors (Gauss–Newton), each press counting once however
//! long it lasts. A sensor's S gets one gain a row, from the presses whose force on that sensor is known.
//! Gains go into the weights: the record's form stays, and the finger does nothing more in a frame.

use nalgebra::{Const, DVector, Dyn, OMatrix, SMatrix, SVector};
use taxel::calibration::Calibration;
use taxel::condition::{Bias, Levels};
use taxel::estimate::net::ForceNet;
use taxel::finger::Finger;
use taxel::frame::Status;
use taxel::scan::{SENSORS, TAXELS};

use crate::error::FitError;
use crate::recording::Recording;

/// Standard deviation of what the unloaded light does not tell of a taxel's gain.
const OWN: f64 = 0.05;
/// Standard deviation of the gain that all taxels, or a row of S, have in common.
const COMMON: f64 = 0.2;
/// Fewest presses: one is left out to judge the others, and two must be left.
const LEAST_PRESSES: usize = 3;
/// Rows that a press is thinned to.
const ROWS: usize = 16;
/// Steps of Gauss–Newton: from a good guess it has converged long before.
const STEPS: usize = 10;
/// A gain that changes by more is no ageing any more: something else is wrong.
const AGED: f64 = 0.5;
/// What a press begins and ends with is left out: the weight is being put down.
const SETTLING: f64 = 0.2;

/// What came of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Adjusted {
    /// The calibration with new bias and gains.
    pub calibration: Calibration,
    /// Presses that were found.
    pub presses: usize,
    /// Gain of each taxel; empty where the finger has no net or the presses do not know its force.
    pub taxels: Vec<f64>,
    /// RMS error over the presses in newtons: with the new bias alone, and with gains from all other presses.
    pub error: Option<[f64; 2]>,
    /// Gain of each row of S, where the presses know it.
    pub sensors: [Option<[f64; 3]>; SENSORS],
    /// What the user should look at, in full sentences.
    pub warnings: Vec<String>,
}

/// A row under load.
struct Row {
    c: Option<[f32; TAXELS]>,
    u: [Option<[f32; 3]>; SENSORS],
    force: [Option<f64>; 3],
    sensors: [[Option<f64>; 3]; SENSORS],
}

type Press = Vec<Row>;
type Gains = SVector<f64, TAXELS>;
type Jacobian = OMatrix<f64, Dyn, Const<TAXELS>>;

/// Makes every contact in `recording` a press with a weight of `newtons` straight down, where nothing else is
/// known of it.
///
/// # Errors
/// There is no unloaded stretch.
pub fn weigh(
    calibration: &Calibration,
    recording: &mut Recording,
    newtons: f64,
) -> Result<(), FitError> {
    for rows in contacts(&renewed(calibration, &recording.bias()?), recording) {
        let settling = (SETTLING * rows.len() as f64) as usize;
        for row in rows.start + settling..rows.end - settling {
            recording.samples[row].truth.force = [Some(0.0), Some(0.0), Some(newtons)];
        }
    }
    Ok(())
}

/// Adjusts `calibration` to recordings of presses whose reference columns are known. `date` is the new
/// record's, seconds since 1970-01-01 UTC.
///
/// # Errors
/// The recordings lack what is needed; the line says what.
pub fn adjust(
    calibration: &Calibration,
    recordings: &[Recording],
    date: u64,
) -> Result<Adjusted, FitError> {
    let first = recordings.first().ok_or(FitError::NoRecording)?;
    let mut adjusted = Adjusted {
        calibration: Calibration { date, ..renewed(calibration, &first.bias()?) },
        presses: 0,
        taxels: Vec::new(),
        error: None,
        sensors: [None; SENSORS],
        warnings: Vec::new(),
    };
    let mut presses = Vec::new();
    for recording in recordings {
        let bias = recording.bias()?;
        let own = renewed(calibration, &bias);
        presses.extend(contacts(&own, recording).map(|rows| press(&bias, recording, rows)));
    }
    presses.retain(|press: &Press| !press.is_empty());
    adjusted.presses = presses.len();
    if presses.len() < LEAST_PRESSES {
        return Err(FitError::TooFewRows {
            part: "presses with a known force".into(),
            rows: presses.len(),
            least: LEAST_PRESSES,
        });
    }
    taxels(&mut adjusted, calibration, &presses);
    sensors(&mut adjusted, &presses);
    adjusted.calibration.validate().map_err(FitError::Record)?;
    Ok(adjusted)
}

/// With another bias, where there is one.
fn renewed(calibration: &Calibration, bias: &Bias) -> Calibration {
    let mut calibration = calibration.clone();
    if let (Some(taxels), Some(bias)) = (&mut calibration.taxels, bias.taxels) {
        taxels.bias = bias;
    }
    for (sensor, bias) in calibration.sensors.iter_mut().zip(bias.bridges) {
        if let (Some(sensor), Some(bias)) = (sensor, bias) {
            sensor.bias = bias;
        }
    }
    calibration
}

/// Rows of each contact, by the finger's own gate.
fn contacts(
    calibration: &Calibration,
    recording: &Recording,
) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let touched: Vec<bool> = recording
        .samples
        .iter()
        .map(|s| finger.estimate(&mut state, &s.scan).status.contains(Status::CONTACT))
        .collect();
    let mut begin = 0;
    let runs: Vec<_> = touched
        .chunk_by(|a, b| a == b)
        .filter_map(|run| {
            let rows = begin..begin + run.len();
            begin = rows.end;
            run[0].then_some(rows)
        })
        .collect();
    runs.into_iter()
}

/// The rows of a contact whose force is known, thinned.
fn press(bias: &Bias, recording: &Recording, rows: std::ops::Range<usize>) -> Press {
    let known: Vec<Row> = recording.samples[rows]
        .iter()
        .filter_map(|sample| {
            let signals = bias.apply(&Levels::read(&sample.scan.codes), None);
            let healthy = signals.health.dead == 0 && signals.health.saturated == 0;
            let row = Row {
                c: signals.taxels.filter(|_| healthy),
                u: signals.bridges,
                force: sample.truth.force,
                sensors: sample.truth.sensors,
            };
            let known = row.force[2].is_some() || row.sensors.iter().any(|s| s[2].is_some());
            known.then_some(row)
        })
        .collect();
    let step = known.len().div_ceil(ROWS).max(1);
    known.into_iter().step_by(step).collect()
}

fn taxels(adjusted: &mut Adjusted, before: &Calibration, presses: &[Press]) {
    let Some((old, net)) = before.taxels.as_ref().zip(before.force.as_ref()) else { return };
    let Some(new) = adjusted.calibration.taxels.as_ref().map(|taxels| taxels.bias) else { return };
    let known = |press: &&Press| press.iter().any(|row| row.c.is_some() && row.force[2].is_some());
    let presses: Vec<&Press> = presses.iter().filter(known).collect();
    if presses.len() < LEAST_PRESSES {
        adjusted.warnings.push(format!(
            "the net: {} presses with a known force on the finger where {LEAST_PRESSES} are needed; its \
             gains stay",
            presses.len()
        ));
        return;
    }
    let light = Gains::from_fn(|k, _| {
        let ratio = f64::from(new.level[k]) / f64::from(old.bias.level[k]);
        if ratio > 0.0 { ratio.ln() } else { 0.0 }
    });
    let problem = Problem { net, light, sigma: old.residual.map(|r| f64::from(r).max(1e-3)) };
    let left_out: Vec<f64> = (0..presses.len())
        .map(|i| {
            let others: Vec<&Press> =
                presses.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, p)| *p).collect();
            problem.square(&problem.solve(&others), presses[i])
        })
        .collect();
    let unchanged: Vec<f64> =
        presses.iter().map(|press| problem.square(&Gains::zeros(), press)).collect();
    let rms = |squares: &[f64]| (squares.iter().sum::<f64>() / presses.len() as f64).sqrt();
    adjusted.error = Some([rms(&unchanged), rms(&left_out)]);
    let gains = problem.solve(&presses).map(f64::exp);
    let spread = gains.iter().fold(0.0, |most: f64, gain| most.max((gain - 1.0).abs()));
    let refused = if !better(&left_out, &unchanged) {
        Some("gains from all but one press do not surely help with that one".to_owned())
    } else if spread > AGED {
        let percent = 100.0 * spread;
        Some(format!("a taxel's gain would change by {percent:.0} %, which is more than ageing"))
    } else {
        None
    };
    adjusted.taxels = vec![1.0; TAXELS];
    let left = if refused.is_none() { rms(&left_out) } else { rms(&unchanged) };
    match refused {
        Some(why) => {
            adjusted.warnings.push(format!("the net: {why}; they stay, the bias is new"));
        }
        None => {
            adjusted.taxels = gains.iter().copied().collect();
            fold(&mut adjusted.calibration, &gains);
        }
    }
    let expected = f64::from(old.residual[if net.output_bias.len() == 1 { 0 } else { 2 }]);
    if left > 5.0 * expected {
        adjusted.warnings.push(format!(
            "the net: {:.1} mN are left on presses not used, where the record's own residual was {:.1} mN; \
             fit anew for more",
            1e3 * left,
            1e3 * expected
        ));
    }
}

/// By more than one standard error of the mean difference: what is less may be chance.
fn better(squares: &[f64], than: &[f64]) -> bool {
    let n = squares.len() as f64;
    let gained: Vec<f64> = than.iter().zip(squares).map(|(than, square)| than - square).collect();
    let mean = gained.iter().sum::<f64>() / n;
    let variance = gained.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0);
    mean > (variance / n).sqrt()
}

/// A gain of the signals is the inverse of one of the weights they go through.
fn fold(calibration: &mut Calibration, gains: &Gains) {
    if let Some(net) = &mut calibration.force {
        for row in net.hidden.chunks_exact_mut(TAXELS).chain(net.skip.chunks_exact_mut(TAXELS)) {
            row.iter_mut().zip(gains).for_each(|(w, gain)| *w = (f64::from(*w) / gain) as f32);
        }
    }
    if let Some(taxels) = &mut calibration.taxels {
        for (range, gain) in taxels.range.iter_mut().zip(gains) {
            *range = range.map(|end| (f64::from(end) * gain) as f32);
        }
    }
}

/// The most probable logarithms of the gains.
struct Problem<'n> {
    net: &'n ForceNet,
    /// What the unloaded light says of them.
    light: Gains,
    /// How well the net fitted when it was made, newtons an output.
    sigma: [f64; 3],
}

impl Problem<'_> {
    /// Errors of a row, those components that are known, in units of the net's own.
    fn errors(&self, gains: &Gains, row: &Row) -> Vec<f64> {
        let Some(c) = &row.c else { return Vec::new() };
        let found = self.said(gains, c);
        let truth = if found.len() == 1 { &row.force[2..] } else { &row.force[..] };
        let known = found.iter().zip(truth).zip(&self.sigma);
        known.filter_map(|((f, t), s)| Some((f64::from(*f) - (*t)?) / s)).collect()
    }

    /// The net's outputs for signals divided by their gains.
    fn said(&self, gains: &Gains, c: &[f32; TAXELS]) -> heapless::Vec<f32, 3> {
        self.net.forces(&std::array::from_fn(|k| (f64::from(c[k]) * (-gains[k]).exp()) as f32))
    }

    /// Mean square error of f_z, the last output, over a press, newtons².
    fn square(&self, gains: &Gains, press: &Press) -> f64 {
        let error = |row: &Row| {
            let found = self.said(gains, row.c.as_ref()?);
            Some((f64::from(*found.last()?) - row.force[2]?).powi(2))
        };
        let squares: Vec<f64> = press.iter().filter_map(error).collect();
        squares.iter().sum::<f64>() / squares.len().max(1) as f64
    }

    fn solve(&self, presses: &[&Press]) -> Gains {
        // Covariance COMMON²·11ᵀ + OWN²·1, inverted by Sherman and Morrison.
        let share = COMMON.powi(2) / (OWN.powi(2) + TAXELS as f64 * COMMON.powi(2));
        let prior =
            (SMatrix::<f64, TAXELS, TAXELS>::identity() - SMatrix::repeat(share)) / OWN.powi(2);
        let mut gains = self.light;
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
            gains += step;
            if step.amax() < 1e-6 {
                break;
            }
        }
        gains
    }

    /// Errors of a row and how they change with the gains.
    fn linear(&self, gains: &Gains, row: &Row) -> (DVector<f64>, Jacobian) {
        const STEP: f64 = 1e-3;
        let errors = DVector::from_vec(self.errors(gains, row));
        let mut jacobian = Jacobian::zeros(errors.len());
        for k in 0..TAXELS {
            let mut moved = *gains;
            moved[k] += STEP;
            let moved = DVector::from_vec(self.errors(&moved, row));
            jacobian.set_column(k, &((moved - &errors) / STEP));
        }
        (errors, jacobian)
    }
}

/// One gain a row of S, each press counting once. It is what S says regressed on the truth that is inverted:
/// noise is in what S says, and the other way round it would draw the gain towards zero.
fn sensors(adjusted: &mut Adjusted, presses: &[Press]) {
    let bench = adjusted.calibration.net().is_none()
        && adjusted.calibration.sensors.iter().flatten().count() == 1;
    for i in 0..SENSORS {
        let Some(sensor) = &mut adjusted.calibration.sensors[i] else { continue };
        let truth = |row: &Row| if bench { row.force } else { row.sensors[i] };
        if !presses.iter().flatten().any(|row| truth(row).iter().any(Option::is_some)) {
            adjusted.warnings.push(format!(
                "s{i}: the presses do not know the force on it alone; its bias is new, its gains stay"
            ));
            continue;
        }
        let mut gains = [1.0; 3];
        for (axis, gain) in gains.iter_mut().enumerate() {
            let sigma = f64::from(sensor.residual[axis]).max(1e-3);
            let (mut product, mut square) = (COMMON.powi(-2), COMMON.powi(-2));
            for press in presses {
                let weight = 1.0 / (press.len() as f64 * sigma.powi(2));
                for row in press {
                    let (Some(u), Some(truth)) = (row.u[i], truth(row)[axis]) else { continue };
                    let found = f64::from(sensor.sensitivity.force(u)[axis]);
                    product += weight * found * truth;
                    square += weight * truth * truth;
                }
            }
            let axis = ["x", "y", "z"][axis];
            if product <= 0.0 {
                adjusted.warnings.push(format!(
                    "s{i}: in {axis} the force goes against what S says: is the reference's sign right? \
                     that gain stays"
                ));
                continue;
            }
            let found = square / product;
            if (found - 1.0).abs() > AGED {
                let percent = 100.0 * (found - 1.0);
                adjusted.warnings.push(format!(
                    "s{i}: the gain in {axis} would change by {percent:.0} %, which is more than ageing; it \
                     stays"
                ));
                continue;
            }
            *gain = found;
        }
        for (row, gain) in sensor.sensitivity.0.iter_mut().zip(gains) {
            *row = row.map(|s| (f64::from(s) * gain) as f32);
        }
        adjusted.sensors[i] = Some(gains);
    }
}
