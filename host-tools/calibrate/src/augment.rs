//! Augmented training of a net: simulated touches of the skin model and recorded rows.
//!
//! A few presses leave a net to guess between them. The skin model, fitted to the same presses, has
//! few degrees of freedom and predicts the taxels' signals of any other touch. The net learns its
//! inverse from these and the recorded rows.

use std::sync::atomic::AtomicBool;

use nalgebra::{DVector, SMatrix, SVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::estimate::field::Load;
use taxel::estimate::inverse::Inverse;
use taxel::scan::TAXELS;

use crate::inverse::{Row, neighbours};
use crate::skin::Skin;
use taxel_regress::error::FitError;
use taxel_regress::network::{self, Build, Net, NetOptions, Progress};
use taxel_regress::scaling::{Inputs, thinned};

/// Training rows of the net: touches of the model, and recorded ones.
const TOUCHES: usize = 4000;
const RECORDED: usize = 1000;
/// Standard deviation of a touch's x and y from a recorded one, mm; presses are rarely closer.
const AWAY: f64 = 0.3;
/// Range of a touch's normal force, as a share of the recorded one.
const HARDER: std::ops::Range<f64> = 0.8..1.2;
/// Decay of the net's weights: the least that keeps units from growing until they nearly cancel.
///
/// 16 bits would lose their difference.
const DECAY: f64 = 1e-3;
/// Most Newton steps from a displacement to the signal of its curve, and the tolerance.
///
/// The tolerance is in units of the displacement.
const STEPS: usize = 40;
const LITTLE: f64 = 1e-5;
/// Largest Newton step, in full scale: curves turn back beyond the recorded signals.
const FARTHEST: f64 = 0.05;

/// Trains a net of one or three outputs.
///
/// # Errors
/// Stopped before the first step.
pub(crate) fn fit(
    part: &str,
    skin: &Skin,
    (outputs, build, options): (usize, Build, NetOptions),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Net, FitError> {
    let Skin { model, rows, .. } = skin;
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let recorded: Vec<&Row> = thinned(rows, RECORDED).collect();
    let mut taught: Vec<Row> = recorded.into_iter().cloned().collect();
    let touches = (0..TOUCHES).map(|_| touch(rows, model, &mut rng));
    taught.extend(touches.filter_map(|(force, point)| {
        Some(Row { signals: signals(model, force, point)?, force, point })
    }));
    let x: Vec<Vec<f64>> = taught.iter().map(|row| row.signals.to_vec()).collect();
    let y: Vec<Vec<f64>> = taught.iter().map(|row| row.force[3 - outputs..].to_vec()).collect();
    network::imitate(part, (&x, &y), (build, DECAY), (Inputs::Alike, options), progress, stop)
}

/// Draws force and position of a touch like the recorded ones.
///
/// It is sheared as much as a nearby touch, in any direction. Shearing a quarter of the touches
/// like any other row raises the net's shear error up to twofold on unseen simulated recordings.
/// That holds for presses and shear alike.
fn touch(rows: &[Row], model: &Inverse, rng: &mut ChaCha8Rng) -> ([f64; 3], [f64; 2]) {
    let own = &rows[rng.random_range(0..rows.len())];
    let normal = own.force[2] * rng.random_range(HARDER);
    let used = own.force[0].hypot(own.force[1]) / own.force[2];
    let shear = normal * used.min(f64::from(model.friction));
    let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
    let mut about = |at: f64| at + 3f64.sqrt() * AWAY * rng.random_range(-1.0..1.0);
    let point = own.point.map(&mut about);
    ([shear * cos, shear * sin, normal], point)
}

/// Signals of the taxels under a touch; `None` beyond the recorded range of a curve.
fn signals(model: &Inverse, force: [f64; 3], point: [f64; 2]) -> Option<[f64; TAXELS]> {
    let [fx, fy, fz] = force;
    let used = fx.hypot(fy) / (fz * f64::from(model.friction)).max(f64::MIN_POSITIVE);
    let load = Load {
        shear: [fx as f32, fy as f32],
        size: fz.cbrt() as f32,
        point: point.map(|at| at as f32),
        used: used as f32,
    };
    let around = model.field.around(&load);
    let mut own = SVector::<f64, TAXELS>::zeros();
    let mut stray = SMatrix::<f64, TAXELS, TAXELS>::identity();
    for (k, facet) in model.centres.0.into_iter().enumerate() {
        let sinks = if model.shear { around.sheared(facet).0 } else { around.pressed(facet).0 };
        own[k] = signal_of(f64::from(sinks), model.curves.gap.get(k)?)?;
        for (neighbour, share) in neighbours(k).into_iter().zip(model.curves.stray.get(k)?) {
            if let Some(neighbour) = neighbour {
                stray[(k, neighbour)] -= f64::from(*share);
            }
        }
    }
    Some(stray.lu().solve(&own)?.into())
}

/// Inverts a curve: the signal of a displacement.
fn signal_of(displacement: f64, curve: &[f32; 5]) -> Option<f64> {
    let a = curve.map(f64::from);
    let mut x = 0.0;
    for _ in 0..STEPS {
        let powers = DVector::from_fn(5, |n, _| f64::powi(x, n as i32));
        let left: f64 = displacement - x * a.iter().zip(&powers).map(|(a, p)| a * p).sum::<f64>();
        if left.abs() < LITTLE {
            return Some(x);
        }
        let slope: f64 =
            a.iter().zip(&powers).zip(1..).map(|((a, p), n)| f64::from(n) * a * p).sum();
        x += (left / slope).clamp(-FARTHEST, FARTHEST);
        if !x.is_finite() {
            return None;
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use taxel::estimate::field::{Field, Radial};
    use taxel::estimate::inverse::{Centres, Curves};
    use taxel::estimate::net::ForceNet;

    /// A half-space under curves that flatten, with stray light.
    fn model() -> Inverse {
        let normal = Radial {
            depth: [6.25, 2.0],
            terms: [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]],
        };
        let shear =
            Radial { depth: [6.25, 2.0], terms: [[2.5, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.0; 3]] };
        Inverse {
            curves: Curves {
                stray: [[0.01, 0.02, 0.015, 0.005]; TAXELS],
                gap: [[-3.0, -4.0, -8.0, 0.0, 0.0]; TAXELS],
            },
            field: Field { normal, shear, slip: 0.0 },
            error: [1e-4, 1e-3],
            shear: true,
            friction: 0.6,
            centres: Centres::default(),
        }
    }

    #[test]
    fn simulated_signals_restore_displacements() {
        let model = model();
        let (force, point) = ([0.2, -0.1, 0.9], [0.7, -1.1]);
        let seen = signals(&model, force, point).unwrap();
        assert!(seen.iter().all(|c| *c < 0.0), "nearer facets see more light: {seen:?}");
        let u = model.curves.displacements(&seen.map(|c| c as f32));
        let load = Load {
            shear: [0.2, -0.1],
            size: 0.9f32.cbrt(),
            point: [0.7, -1.1],
            used: 0.05f32.sqrt() / 0.54,
        };
        let around = model.field.around(&load);
        for (u, centre) in u.iter().zip(model.centres.0) {
            let (wanted, _) = around.sheared(centre);
            assert!((u - wanted).abs() < 1e-4, "{u} {wanted}");
        }
    }

    #[test]
    fn unreachable_displacement_gives_no_signal() {
        // This curve turns back at x = −0.5, where it reaches 0.5.
        let curve = [-2.0, -2.0, 0.0, 0.0, 0.0];
        let x = signal_of(0.4, &curve).unwrap();
        assert!((-2.0 * x - 2.0 * x * x - 0.4).abs() < 1e-4 && x > -0.5, "{x}");
        assert_eq!(signal_of(0.6, &curve), None);
    }

    #[test]
    fn augmented_net_interpolates_between_presses() {
        let model = model();
        let mut rows = Vec::new();
        for i in 0..600 {
            let (place, share) = (i % 3, f64::from(i) / 600.0);
            let fz = 0.2 + share;
            let force = [0.3 * fz * (7.0 * share).sin(), 0.3 * fz * (5.0 * share).cos(), fz];
            let point = [[-1.0, -1.0], [1.0, 0.0], [-0.5, 1.0]][place as usize];
            rows.push(Row { signals: signals(&model, force, point).unwrap(), force, point });
        }
        let skin =
            Skin { model, rows, left_out: 0, residual: [0.0; 3], place: None, held_out: false };
        let options = NetOptions { seed: 0, starts: 1, steps: 60 };
        let stop = AtomicBool::new(false);
        let build = Build { hidden: 12, skip: false };
        let taught = fit("net", &skin, (3, build, options), &mut |_| {}, &stop).unwrap();
        let (x, y): (Vec<Vec<f64>>, Vec<Vec<f64>>) =
            skin.rows.iter().map(|row| (row.signals.to_vec(), row.force.to_vec())).unzip();
        let alone =
            network::fit("net", (&x, &y), build, (Inputs::Alike, options), &mut |_| {}, &stop)
                .unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let touches: Vec<_> = (0..200).map(|_| touch(&skin.rows, &skin.model, &mut rng)).collect();
        let off = |forces: &dyn Fn(&[f32; TAXELS]) -> Vec<f32>| -> f64 {
            let squares = touches.iter().map(|(force, point)| {
                let seen = signals(&skin.model, *force, *point).unwrap().map(|c| c as f32);
                let found = forces(&seen).into_iter().zip(force);
                found.map(|(found, force)| (f64::from(found) - force).powi(2)).sum::<f64>()
            });
            (squares.sum::<f64>() / touches.len() as f64).sqrt()
        };
        let [of_taught, of_alone] = [&taught, &alone].map(|net| off(&|c| net.outputs(c)));
        assert!(of_taught < of_alone, "{of_taught} {of_alone}");

        // The 16-bit net is hardly worse.
        let range = [[-0.5, 0.5]; TAXELS];
        let held = taxel::calibration::TaxelCalibration { range, ..Default::default() };
        let float = ForceNet::new(&taught.layers()).unwrap();
        let whole = crate::quantise::whole(&float, &held).unwrap();
        let of_whole = off(&|c| whole.forces(c).to_vec());
        assert!(of_whole < 1.1 * of_taught, "{of_whole} {of_taught}");
    }
}
