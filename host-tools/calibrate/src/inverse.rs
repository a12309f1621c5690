//! Fit of a finger's forward model: taxel curves, stray light and one contact's field.
//!
//! The model is [`taxel::estimate::inverse`]. Given the field, a taxel's signal is linear in the
//! powers of its displacement (its curve) and in its neighbours' signals (its stray light).
//! Levenberg–Marquardt therefore searches the field's coefficients only, and each step solves for
//! the rest (variable projection, Golub and Pereyra 1973). The curves for the chip, from signal to
//! displacement, are fitted last, to the displacements of that field.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};
use taxel::estimate::field::{Field, Radial};
use taxel::estimate::inverse::{Curves, Inverse};
use taxel::scan::{COLS, ROWS, TAXEL_CENTRES, TAXELS};

use taxel_regress::error::FitError;
use taxel_regress::network::Progress;

/// A row of a recording: signals, force and contact point.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Signal c_k of each taxel.
    pub signals: [f64; TAXELS],
    /// Force f_x, f_y, f_z in newtons.
    pub force: [f64; 3],
    /// Contact point x, y in mm.
    pub point: [f64; 2],
}

/// Approximate number of rows after thinning; more rows do not improve the field.
const MOST_ROWS: usize = 1400;
/// Fewest rows that determine curves, stray light and field.
const LEAST_ROWS: usize = 200;
/// Most steps, and the relative improvement below which the search ends.
const STEPS: usize = 40;
const LITTLE: f64 = 1e-4;

/// Share of a row's largest signal that adds to a signal's standard deviation.
const SHARE: f64 = 0.002;
/// Prior of stray light: a share of 0.015 ± 0.01 of the neighbour's signal.
const STRAY: [f64; 2] = [0.015, 0.01];
/// Number of powers in the polynomials from displacement to signal and back.
const POWERS: usize = 5;
/// Number of linear coefficients of a taxel: powers and four neighbours.
const LINEAR: usize = POWERS + 4;

/// Number of coefficients of a radial function: two depths and 4 × 3 terms.
const RADIAL: usize = 14;
/// Number of coefficients of the field: both functions and the slip share.
///
/// The slip share is that by which slip draws the traction in.
const FIELD: usize = 2 * RADIAL + 1;
/// Index of the first term of N, which fixes the unit of length.
const UNIT: usize = 2;

/// Start of the search: a point load 2.5 mm deep in a half-space with ν = ½.
fn half_space() -> SVector<f64, FIELD> {
    let mut p = SVector::zeros();
    // N = 1/ρ + z²/ρ³ = (1 + w)/ρ; T = z/ρ³.
    (p[0], p[1], p[2], p[5]) = (6.25, 2.0, 1.0, 1.0);
    (p[RADIAL], p[RADIAL + 1], p[RADIAL + 2]) = (6.25, 2.0, 2.5);
    p[FIELD - 1] = -0.3;
    p
}

/// Prior standard deviation of the coefficients from the start, and the step of their derivatives.
const SPREAD: f64 = 100.0;
const FEEL: f64 = 1e-5;

/// Fits the model to rows of signals, force and contact point.
///
/// `friction` is the friction coefficient of the recordings, `noise` that of a signal in full
/// scale, and `shear` is whether the recordings contain shear.
///
/// # Errors Too few rows, or stopped before the first step.
pub fn fit(
    part: &str,
    rows: &[Row],
    (friction, noise, shear): (f64, f64, bool),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Inverse, FitError> {
    if rows.len() < LEAST_ROWS {
        return Err(FitError::TooFewRows {
            part: part.into(),
            rows: rows.len(),
            least: LEAST_ROWS,
        });
    }
    let rows: Vec<&Row> = rows.iter().step_by(rows.len().div_ceil(MOST_ROWS)).collect();
    let problem = Problem::new(rows, friction, noise, shear);
    let mut at = half_space();
    let mut damping = 1e-3;
    let (mut left, mut slopes) = (problem.residuals(&at), None);
    for step in 0..STEPS {
        let error = (left.norm_squared() / left.len() as f64).sqrt();
        progress(Progress { part: part.into(), step, of: STEPS, error });
        if stop.load(Ordering::Relaxed) {
            if step == 0 {
                return Err(FitError::Stopped);
            }
            break;
        }
        let (matrix, gradient) = slopes.take().unwrap_or_else(|| problem.quadratic(&at, &left));
        let mut damped = matrix;
        for i in 0..FIELD {
            damped[(i, i)] += damping * (matrix[(i, i)] + 1.0);
        }
        let next = Cholesky::new(damped).map(|factor| at - factor.solve(&gradient));
        let found = next.map(|next| (next, problem.residuals(&next)));
        match found {
            Some((next, residuals)) if residuals.norm_squared() < left.norm_squared() => {
                let share = 1.0 - residuals.norm_squared() / left.norm_squared();
                (at, left) = (next, residuals);
                damping = (0.2 * damping).max(1e-9);
                if share < LITTLE {
                    break;
                }
            }
            _ => {
                slopes = Some((matrix, gradient));
                damping *= 5.0;
            }
        }
    }
    Ok(problem.finish(&at))
}

struct Problem<'r> {
    rows: Vec<&'r Row>,
    weights: Vec<f64>,
    friction: f64,
    noise: f64,
    /// Indices of the searched coefficients.
    free: Vec<usize>,
    shear: bool,
}

/// Taxels to the left and right, and in the row before and after.
pub(crate) fn neighbours(k: usize) -> [Option<usize>; 4] {
    let column = k % COLS;
    [
        (column > 0).then(|| k - 1),
        (column + 1 < COLS).then_some(k + 1),
        k.checked_sub(COLS),
        (k + COLS < ROWS * COLS).then_some(k + COLS),
    ]
}

/// P(w)/ρ^(2·half), as in [`taxel::estimate::field`], in f64.
fn radial(p: &[f64], distance2: f64, size2: f64, half: f64) -> f64 {
    let depth = (p[0] + p[1] * size2).max(0.3);
    let inverse2 = 1.0 / (distance2 + depth);
    let w = depth * inverse2;
    let terms = p[2..RADIAL].chunks_exact(3).rev();
    let sum = terms.fold(0.0, |sum, t| sum * w + t[0] + size2 * (t[1] + size2 * t[2]));
    sum * inverse2.powf(half)
}

impl<'r> Problem<'r> {
    fn new(rows: Vec<&'r Row>, friction: f64, noise: f64, shear: bool) -> Self {
        let most = |row: &Row| row.signals.iter().fold(0.0f64, |most, c| most.max(c.abs()));
        let weights = rows.iter().map(|row| 1.0 / (2.0 * noise + SHARE * most(row))).collect();
        let searched = if shear { FIELD } else { RADIAL };
        let free = (0..searched).filter(|p| *p != UNIT).collect();
        Self { rows, weights, friction, noise, free, shear }
    }

    fn displacements(&self, p: &SVector<f64, FIELD>, row: &Row) -> [f64; TAXELS] {
        let [fx, fy, fz] = row.force;
        let size2 = fz.max(0.0).cbrt().powi(2);
        let used = if fz > 0.0 { fx.hypot(fy) / (fz * self.friction) } else { 0.0 };
        let (normal, rest) = p.as_slice().split_at(RADIAL);
        let narrowed = size2 * (1.0 + p[FIELD - 1] * used).max(0.0);
        TAXEL_CENTRES.map(|centre| {
            let [dx, dy] =
                [f64::from(centre[0].0) - row.point[0], f64::from(centre[1].0) - row.point[1]];
            let distance2 = dx * dx + dy * dy;
            let pressed = fz * radial(normal, distance2, size2, 0.5);
            if !self.shear {
                return pressed;
            }
            pressed + (fx * dx + fy * dy) * radial(&rest[..RADIAL], distance2, narrowed, 1.5)
        })
    }

    /// Best curve and stray light of taxel k: coefficients of u … u⁵ and of the neighbours.
    fn linear(&self, k: usize, u: &[[f64; TAXELS]]) -> SVector<f64, LINEAR> {
        let mut matrix = SMatrix::<f64, LINEAR, LINEAR>::zeros();
        let mut right = SVector::<f64, LINEAR>::zeros();
        for ((row, u), weight) in self.rows.iter().zip(u).zip(&self.weights) {
            let features = features(k, u, row);
            let weight2 = weight * weight;
            matrix.ger(weight2, &features, &features, 1.0);
            right.axpy(weight2 * row.signals[k], &features, 1.0);
        }
        let [usual, spread] = STRAY;
        for i in POWERS..LINEAR {
            matrix[(i, i)] += 1.0 / (spread * spread);
            right[i] += usual / (spread * spread);
        }
        for i in 0..POWERS {
            matrix[(i, i)] *= 1.0 + 1e-12;
        }
        Cholesky::new(matrix).map_or_else(SVector::zeros, |factor| factor.solve(&right))
    }

    /// Normalised residuals of the signals for this field and its best curves.
    fn residuals(&self, p: &SVector<f64, FIELD>) -> DVector<f64> {
        let u: Vec<[f64; TAXELS]> =
            self.rows.iter().map(|row| self.displacements(p, row)).collect();
        let mut left = Vec::with_capacity(TAXELS * (self.rows.len() + 4) + FIELD);
        for k in 0..TAXELS {
            let linear = self.linear(k, &u);
            for ((row, u), weight) in self.rows.iter().zip(&u).zip(&self.weights) {
                left.push(weight * (row.signals[k] - features(k, u, row).dot(&linear)));
            }
            let [usual, spread] = STRAY;
            left.extend((POWERS..LINEAR).map(|i| (usual - linear[i]) / spread));
        }
        left.extend((p - half_space()).iter().map(|away| away / SPREAD));
        DVector::from_vec(left)
    }

    /// J^T J and J^T r around `p`.
    fn quadratic(
        &self,
        p: &SVector<f64, FIELD>,
        left: &DVector<f64>,
    ) -> (SMatrix<f64, FIELD, FIELD>, SVector<f64, FIELD>) {
        let columns: Vec<DVector<f64>> = self
            .free
            .iter()
            .map(|i| {
                let mut moved = *p;
                moved[*i] += FEEL;
                (self.residuals(&moved) - left) / FEEL
            })
            .collect();
        let jacobian = DMatrix::from_columns(&columns);
        let (inner, slope) = (jacobian.tr_mul(&jacobian), jacobian.tr_mul(left));
        let (mut matrix, mut gradient) = (SMatrix::identity(), SVector::zeros());
        for (a, i) in self.free.iter().enumerate() {
            gradient[*i] = slope[a];
            for (b, j) in self.free.iter().enumerate() {
                matrix[(*i, *j)] = inner[(a, b)];
            }
        }
        (matrix, gradient)
    }

    fn finish(&self, p: &SVector<f64, FIELD>) -> Inverse {
        let u: Vec<[f64; TAXELS]> =
            self.rows.iter().map(|row| self.displacements(p, row)).collect();
        let mut curves = Curves { stray: [[0.0; 4]; TAXELS], gap: [[0.0; POWERS]; TAXELS] };
        for k in 0..TAXELS {
            let linear = self.linear(k, &u);
            curves.stray[k] = std::array::from_fn(|i| linear[POWERS + i] as f32);
            curves.gap[k] = self.gap(k, &linear, &u);
        }
        let [normal, shear] = [0, RADIAL].map(|from| Radial {
            depth: [p[from] as f32, p[from + 1] as f32],
            terms: std::array::from_fn(|i| std::array::from_fn(|j| p[from + 2 + 3 * i + j] as f32)),
        });
        let field = Field { normal, shear, slip: p[FIELD - 1] as f32 };
        let error = self.error(&curves, &u);
        Inverse { curves, field, error, shear: self.shear, friction: self.friction as f32 }
    }

    /// Fits the curve from the signal without stray light to the displacement.
    fn gap(&self, k: usize, linear: &SVector<f64, LINEAR>, u: &[[f64; TAXELS]]) -> [f32; POWERS] {
        let mut matrix = SMatrix::<f64, POWERS, POWERS>::zeros();
        let mut right = SVector::<f64, POWERS>::zeros();
        for (row, u) in self.rows.iter().zip(u) {
            let stray: f64 = (0..4)
                .filter_map(|i| neighbours(k)[i].map(|j| linear[POWERS + i] * row.signals[j]))
                .sum();
            let powers = powers(row.signals[k] - stray);
            let weight = (0.002 + 0.01 * row.force[2]).powi(-2);
            matrix.ger(weight, &powers, &powers, 1.0);
            right.axpy(weight * u[k], &powers, 1.0);
        }
        for i in 0..POWERS {
            matrix[(i, i)] = matrix[(i, i)] * (1.0 + 1e-12) + 1e-12;
        }
        let found =
            Cholesky::new(matrix).map_or_else(SVector::zeros, |factor| factor.solve(&right));
        std::array::from_fn(|i| found[i] as f32)
    }

    /// Residuals of the displacements, by the arithmetic of the chip: [`Inverse::error`].
    fn error(&self, curves: &Curves, u: &[[f64; TAXELS]]) -> [f32; 2] {
        let slope = curves.gap.iter().map(|gap| f64::from(gap[0]).powi(2)).sum::<f64>();
        let floor = self.noise * (slope / TAXELS as f64).sqrt();
        // Rows are weighted by their force, because light touches contain mostly noise.
        let (mut excess, mut loads) = (0.0, 0.0);
        for (row, u) in self.rows.iter().zip(u) {
            let found = curves.displacements(&row.signals.map(|c| c as f32));
            let squares: f64 =
                found.iter().zip(u).map(|(found, u)| (f64::from(*found) - u).powi(2)).sum();
            let force2 = row.force[2].powi(2);
            excess += force2 * (squares / TAXELS as f64 - floor * floor);
            loads += force2 * force2;
        }
        let share = (excess.max(0.0) / loads.max(f64::MIN_POSITIVE)).sqrt();
        [(floor.max(1e-7)) as f32, share as f32]
    }
}

fn powers(x: f64) -> SVector<f64, POWERS> {
    let mut power = 1.0;
    SVector::from_fn(|_, _| {
        power *= x;
        power
    })
}

fn features(k: usize, u: &[f64; TAXELS], row: &Row) -> SVector<f64, LINEAR> {
    let mut features = SVector::<f64, LINEAR>::zeros();
    features.fixed_rows_mut::<POWERS>(0).copy_from(&powers(u[k]));
    for (i, j) in neighbours(k).into_iter().enumerate() {
        features[POWERS + i] = j.map_or(0.0, |j| row.signals[j]);
    }
    features
}
