//! Normal equations of the skin model's coefficients, without the loads and places of the rows.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use taxel::scan::TAXELS;

use super::{ALL, Bundle, Press, Seen, arm_off, features, held, huber_weight, normalised, prior};
use super::{LINEAR, OWN, POWERS, spread_over_cores};
use crate::inverse::forward::{FIELD, LOAD, half_space};

/// Normal equations of all coefficients, and what the eliminated unknowns need back.
pub(in crate::inverse) struct Equations {
    /// Lower triangle.
    pub(super) matrix: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    pub(super) back: Vec<PressBack>,
}

/// Solution of a press's place without the coefficients, and its dependence on them.
pub(super) struct PressBack {
    pub own: SVector<f64, 2>,
    pub by_all: SMatrix<f64, ALL, 2>,
    pub variance: f64,
    pub rows: Vec<RowBack>,
}

/// Solution of a row's load without the other unknowns, and its dependence on them.
pub(super) struct RowBack {
    pub own: SVector<f64, LOAD>,
    /// Change of the load per change of the signals.
    gain: SMatrix<f64, LOAD, TAXELS>,
    line: Box<Linearised>,
    pub variance: f64,
}

impl RowBack {
    /// Returns the change of the load by steps of the coefficients and of the press's place.
    pub fn by_others(
        &self,
        step: &SVector<f64, ALL>,
        away: &SVector<f64, 2>,
    ) -> SVector<f64, LOAD> {
        let Linearised { by_place, by_field, features, .. } = &*self.line;
        let mut signals = by_place * away;
        for k in 0..TAXELS {
            signals[k] += by_field.column(k).dot(&step.fixed_rows::<FIELD>(0))
                + features[k].dot(&step.fixed_rows::<OWN>(FIELD + k * OWN));
        }
        self.gain * signals
    }
}

/// A row linearised at the present unknowns.
pub(super) struct Linearised {
    /// Residuals, in standard deviations of the signals.
    pub(super) error: SVector<f64, TAXELS>,
    /// Their derivatives by the load, scaled by the load's prior deviations.
    pub(super) by_load: SMatrix<f64, TAXELS, LOAD>,
    by_place: SMatrix<f64, TAXELS, 2>,
    /// Their derivatives by the field, a column for each taxel.
    by_field: SMatrix<f64, FIELD, TAXELS>,
    /// Their derivatives by the taxel's own coefficients.
    features: [SVector<f64, OWN>; TAXELS],
}

/// Sums over the rows and presses.
struct Sums {
    /// Lower triangle, column by column.
    matrix: Vec<[f64; ALL]>,
    right: SVector<f64, ALL>,
    back: Vec<PressBack>,
}

impl Bundle<'_> {
    /// Builds the normal equations at the present unknowns.
    pub fn equations(&self) -> Equations {
        let spread = self.spread();
        let parts = spread_over_cores(&self.presses, |presses| {
            let mut sums =
                Sums { matrix: vec![[0.0; ALL]; ALL], right: SVector::zeros(), back: Vec::new() };
            presses.iter().for_each(|press| self.add_press(press, &spread, &mut sums));
            sums
        });
        let mut all = Equations {
            matrix: DMatrix::zeros(ALL, ALL),
            right: DVector::zeros(ALL),
            back: Vec::new(),
        };
        for Sums { matrix, right, back } in parts {
            let values = all.matrix.iter_mut().zip(matrix.as_flattened());
            values.for_each(|(all, part)| *all += part);
            all.right += right;
            all.back.extend(back);
        }
        let away = half_space() - self.field;
        for i in 0..FIELD {
            all.matrix[(i, i)] += held(i);
            all.right[i] += away[i] * held(i);
        }
        for size2 in self.held_sizes() {
            let (off, slopes) = (arm_off(&self.field, *size2), self.arm_slopes(*size2));
            for j in 0..FIELD {
                (j..FIELD).for_each(|i| all.matrix[(i, j)] += slopes[i] * slopes[j]);
                all.right[j] -= off * slopes[j];
            }
        }
        for (k, taxel) in self.taxels.iter().enumerate() {
            for (n, value) in taxel.iter().enumerate() {
                let (i, [usual, weight]) = (FIELD + k * OWN + n, prior(n));
                all.matrix[(i, i)] += weight;
                all.right[i] += (usual - value) * weight;
            }
        }
        all
    }

    fn add_press(&self, press: &Press<'_>, spread: &SVector<f64, LOAD>, sums: &mut Sums) {
        let mut place_matrix = SMatrix::<f64, 2, 2>::identity() / self.labels.press.powi(2);
        let mut place_right = -press.away / self.labels.press.powi(2);
        let mut place_all = SMatrix::<f64, ALL, 2>::zeros();
        let mut rows = Vec::new();
        for seen in &press.rows {
            let line = self.linearise(press, seen, spread);
            let scaled = normalised(&seen.away, spread);
            let squares = line.error.norm_squared() + scaled.norm_squared();
            let weight = huber_weight(squares, self.labels.huber());
            // The load's own equations: prior and signals.
            let own = SMatrix::<f64, LOAD, LOAD>::identity() + line.by_load.tr_mul(&line.by_load);
            let inverse = own.try_inverse().unwrap_or_else(SMatrix::zeros);
            let gain = inverse * line.by_load.transpose();
            let own = gain * line.error - inverse * scaled;
            // Equations of the others, from what the load leaves of the signals.
            let left = (SMatrix::identity() - line.by_load * gain) * weight;
            let error = (line.error - line.by_load * own) * weight;
            let by_place = left * line.by_place;
            place_matrix += line.by_place.tr_mul(&by_place);
            place_right += line.by_place.tr_mul(&error);
            add_row(sums, &line, &left, &error);
            for (k, features) in line.features.iter().enumerate() {
                for (place, share) in by_place.row(k).iter().enumerate() {
                    let mut all = place_all.column_mut(place);
                    all.rows_mut(0, FIELD).axpy(*share, &line.by_field.column(k), 1.0);
                    all.rows_mut(FIELD + k * OWN, OWN).axpy(*share, features, 1.0);
                }
            }
            let variance = inverse[(3, 3)] + inverse[(4, 4)];
            rows.push(RowBack { own, gain, line, variance });
        }
        let inverse = place_matrix.try_inverse().unwrap_or_else(SMatrix::zeros);
        let solved = place_all * inverse;
        let own = inverse * place_right;
        sums.right -= place_all * own;
        let [x, y] = [0, 1].map(|place| solved.column(place).into_owned());
        for (j, column) in sums.matrix.iter_mut().enumerate() {
            let [by_x, by_y] = [0, 1].map(|place| place_all[(j, place)]);
            for (i, value) in column.iter_mut().enumerate().skip(j) {
                *value -= x[i] * by_x + y[i] * by_y;
            }
        }
        sums.back.push(PressBack { own, by_all: solved, variance: inverse.trace(), rows });
    }

    pub(super) fn linearise(
        &self,
        press: &Press<'_>,
        seen: &Seen<'_>,
        spread: &SVector<f64, LOAD>,
    ) -> Box<Linearised> {
        let mut found = Box::new(Linearised {
            error: SVector::zeros(),
            by_load: SMatrix::zeros(),
            by_place: SMatrix::zeros(),
            by_field: SMatrix::zeros(),
            features: [SVector::zeros(); TAXELS],
        });
        let weight = 1.0 / seen.sigma;
        for (k, u) in self.displaced(&Self::load(press, seen)).enumerate() {
            let mut features = features(k, u.value, seen.row);
            let taxel = &self.taxels[k];
            found.error[k] = weight * (seen.row.signals[k] - features.dot(taxel));
            let mut slope = 0.0;
            for n in (0..POWERS).rev() {
                slope = slope * u.value + (n + 1) as f64 * taxel[n];
            }
            let slope = weight * slope;
            for j in 0..LOAD {
                found.by_load[(k, j)] = slope * u.by_load[j] * spread[j];
            }
            for j in 0..2 {
                found.by_place[(k, j)] = slope * u.by_load[3 + j];
            }
            found.by_field.set_column(k, &(u.by_field * slope));
            // A facet that moves is a contact that moves the other way.
            features *= weight;
            for j in 0..2 {
                features[LINEAR + j] = -slope * u.by_load[3 + j];
            }
            found.features[k] = features;
        }
        found
    }
}

/// Adds AᵀPA and Aᵀe of a row, where P is `left`, and A its derivatives by all coefficients.
fn add_row(
    sums: &mut Sums,
    line: &Linearised,
    left: &SMatrix<f64, TAXELS, TAXELS>,
    error: &SVector<f64, TAXELS>,
) {
    let (of_field, of_taxels) = sums.matrix.split_at_mut(FIELD);
    // Columns of the field: FᵀP of each taxel, from which its other columns follow.
    let mut by_left = SMatrix::<f64, FIELD, TAXELS>::zeros();
    for (i, left) in left.column_iter().enumerate() {
        for (k, left) in left.iter().enumerate() {
            add(by_left.column_mut(i).as_mut_slice(), *left, line.by_field.column(k).as_slice());
        }
    }
    for (j, column) in of_field.iter_mut().enumerate() {
        let (field, taxels) = column.split_at_mut(FIELD);
        for (k, part) in taxels.as_chunks_mut::<OWN>().0.iter_mut().enumerate() {
            let share = by_left[(j, k)];
            add(&mut field[j..], share, &line.by_field.column(k).as_slice()[j..]);
            add(part, share, line.features[k].as_slice());
        }
    }
    for (l, columns) in of_taxels.as_chunks_mut::<OWN>().0.iter_mut().enumerate() {
        let mut block = [[0.0; OWN]; TAXELS];
        for (k, block) in block.iter_mut().enumerate().skip(l) {
            add(block, left[(k, l)], line.features[k].as_slice());
        }
        for (column, share) in columns.iter_mut().zip(&line.features[l]) {
            add(&mut column[FIELD + l * OWN..], *share, block[l..].as_flattened());
        }
    }
    let (field, taxels) = sums.right.as_mut_slice().split_at_mut(FIELD);
    for (k, part) in taxels.as_chunks_mut::<OWN>().0.iter_mut().enumerate() {
        add(field, error[k], line.by_field.column(k).as_slice());
        add(part, error[k], line.features[k].as_slice());
    }
}

/// Adds a multiple of some values to others.
fn add(to: &mut [f64], factor: f64, values: &[f64]) {
    to.iter_mut().zip(values).for_each(|(to, value)| *to += factor * value);
}
