//! The papers' own models, fitted to a table.
//!
//! These are the line of four of [DeMaria2011], the feeler of [Ohka2005], the column of [Ohka2004],
//! and gap curves. The crate `taxel_papers` documents and evaluates each model.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use taxel_papers::column::Column;
use taxel_papers::feeler::{BrightSpot, Shear};
use taxel_papers::line_of_four::{LinePolynomials, terms};

use crate::error::FitError;
use crate::model::Family;
use crate::training::Recorded;

/// Least number of rows for each unknown of a fit.
const LEAST_ROWS: usize = 4;
/// Singular values below this share of the largest count as zero.
const SINGULAR: f64 = 1e-10;
/// Shares of the rows initially assumed to stick.
const STICKING: [f64; 4] = [0.2, 0.4, 0.6, 0.8];
/// Most iterations of sorting rows into sticking and slipping.
const MAX_ROUNDS: usize = 50;

/// A model with its coefficients, in the units of the table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Law {
    /// [DeMaria2011] eqs (3)–(6): four displacements to p and θ.
    Row {
        /// Coefficients a_1 … a_8.
        point: [f32; 8],
        /// Coefficients b_1 … b_8.
        angle: [f32; 8],
    },
    /// [Ohka2005] eqs (3), (10)–(12): G, u_x, u_y to F_x, F_y, F_z.
    Feeler {
        /// Coefficient C.
        normal: f32,
        /// Coefficients β, K, α, γ of x.
        x: [f32; 4],
        /// Coefficients β, K, α, γ of y.
        y: [f32; 4],
    },
    /// [Ohka2004] eq. (18): S_1 … S_4 to F_x, F_y, F_z.
    Column {
        /// Coefficient α_v.
        normal: f32,
        /// Coefficient α_h0.
        shear: f32,
        /// Coefficient α_h.
        flattening: f32,
    },
    /// [DeMaria2011] eq. (2): each signal to the displacement of its own facet.
    ///
    /// A polynomial of powers one to three.
    Gap {
        /// Coefficients of powers one to three, for each channel.
        powers: Vec<[f32; 3]>,
    },
}

impl Law {
    /// Family of the law.
    #[must_use]
    pub fn family(&self) -> Family {
        match self {
            Self::Row { .. } => Family::Row,
            Self::Feeler { .. } => Family::Feeler,
            Self::Column { .. } => Family::Column,
            Self::Gap { .. } => Family::Gap,
        }
    }

    /// Estimates the targets for a row of inputs, by the core's arithmetic.
    #[must_use]
    pub fn estimate(&self, inputs: &[f32]) -> Vec<f32> {
        match self {
            Self::Row { point, angle } => {
                let row = LinePolynomials { point: *point, angle: *angle };
                let (p, theta) = row.contact(first(inputs));
                vec![p, theta]
            }
            Self::Feeler { normal, x, y } => {
                let [integral, ux, uy] = first(inputs);
                let spot = BrightSpot { normal: *normal, x: shear(*x), y: shear(*y) };
                spot.force(integral, [ux, uy]).to_vec()
            }
            Self::Column { normal, shear, flattening } => {
                let (normal, shear, flattening) = (*normal, *shear, *flattening);
                let column = Column { normal, shear, flattening, ..Column::PAPER };
                column.load(first(inputs)).force.to_vec()
            }
            Self::Gap { powers } => {
                let curve = |([a, b, c], x): (&[f32; 3], &f32)| x * (a + x * (b + x * c));
                powers.iter().zip(inputs).map(curve).collect()
            }
        }
    }
}

/// Returns the first N inputs; the fit has checked the width.
fn first<const N: usize>(inputs: &[f32]) -> [f32; N] {
    std::array::from_fn(|i| inputs.get(i).copied().unwrap_or_default())
}

fn shear([stuck, sheet, friction, adhesion]: [f32; 4]) -> Shear {
    Shear { stuck, sheet, friction, adhesion }
}

/// Fits the law of a family; `None` for a family without a law.
pub fn fit(family: Family, recordings: &[Recorded]) -> Option<Result<Law, FitError>> {
    let fit: fn(&Data<'_>) -> Result<Law, FitError> = match family {
        Family::Row => row,
        Family::Feeler => feeler,
        Family::Column => column,
        Family::Gap => gap,
        _ => return None,
    };
    let data = Data {
        part: family.to_string(),
        rows: recordings.iter().flat_map(|(x, y)| x.iter().zip(y)).collect(),
    };
    Some(fit(&data))
}

/// Inputs and targets of all rows.
struct Data<'d> {
    part: String,
    rows: Vec<(&'d Vec<f64>, &'d Vec<f64>)>,
}

impl Data<'_> {
    /// Rejects tables of another shape than the law's.
    fn shaped(&self, inputs: (usize, &str), targets: (usize, &str)) -> Result<(), FitError> {
        let (x, y) = self.rows.first().map_or((0, 0), |(x, y)| (x.len(), y.len()));
        if (x, y) == (inputs.0, targets.0) {
            return Ok(());
        }
        let problem = format!(
            "{x} inputs and {y} targets where it takes {} ({}) and gives {} ({})",
            inputs.0, inputs.1, targets.0, targets.1
        );
        Err(FitError::Shape { part: self.part.clone(), problem })
    }

    /// Solves for the weights of N terms that sum to a value, over the rows with terms.
    fn solve<const N: usize>(
        &self,
        terms: impl Fn(&[f64], &[f64]) -> Option<([f64; N], f64)>,
    ) -> Result<[f64; N], FitError> {
        let rows: Vec<([f64; N], f64)> =
            self.rows.iter().filter_map(|(x, y)| terms(x, y)).collect();
        solve(&self.part, &rows)
    }
}

/// Solves least squares with the columns scaled to one size.
fn solve<const N: usize>(part: &str, rows: &[([f64; N], f64)]) -> Result<[f64; N], FitError> {
    let least = LEAST_ROWS * N;
    if rows.len() < least {
        return Err(FitError::TooFewRows { part: part.into(), rows: rows.len(), least });
    }
    let mut matrix = DMatrix::from_fn(rows.len(), N, |row, i| rows[row].0[i]);
    let sizes: [f64; N] = std::array::from_fn(|i| matrix.column(i).norm());
    if sizes.contains(&0.0) {
        return Err(FitError::NoLoad { part: part.into() });
    }
    matrix.column_iter_mut().zip(sizes).for_each(|(mut column, size)| column /= size);
    let values = DVector::from_iterator(rows.len(), rows.iter().map(|row| row.1));
    let svd = matrix.svd(true, true);
    let (most, least) = (svd.singular_values.max(), svd.singular_values.min());
    if least < SINGULAR * most {
        return Err(FitError::Shape {
            part: part.into(),
            problem: "the loads leave some of its coefficients open; vary each quantity by itself"
                .into(),
        });
    }
    let solution = svd.solve(&values, 0.0).map_err(|_| FitError::NoLoad { part: part.into() })?;
    Ok(std::array::from_fn(|i| solution[i] / sizes[i]))
}

fn row(data: &Data<'_>) -> Result<Law, FitError> {
    data.shaped((4, "u_1 … u_4"), (2, "p, θ in degrees"))?;
    let of = |x: &[f64]| terms(std::array::from_fn(|i| x[i] as f32)).map(f64::from);
    let point = data.solve(|x, y| Some((of(x), y[0])))?;
    let angle = data.solve(|x, y| Some((of(x), y[1] - 90.0)))?;
    Ok(Law::Row { point: point.map(|a| a as f32), angle: angle.map(|b| b as f32) })
}

fn column(data: &Data<'_>) -> Result<Law, FitError> {
    data.shaped((4, "S_1 … S_4"), (3, "F_x, F_y, F_z"))?;
    let z = |s: &[f64]| s[0] + s[1] + s[2] + s[3];
    let [normal] = data.solve(|s, f| Some(([z(s)], f[2])))?;
    let x = |s: &[f64]| s[0] - s[1] - s[2] + s[3];
    let y = |s: &[f64]| s[0] + s[1] - s[2] - s[3];
    let both: Vec<([f64; 2], f64)> = data
        .rows
        .iter()
        .flat_map(|(s, f)| [(x(s), f[0]), (y(s), f[1])].map(|(a, f)| ([a, -a * z(s)], f)))
        .collect();
    let [shear, flattening] = solve(&data.part, &both)?;
    let [normal, shear, flattening] = [normal, shear, flattening].map(|value| value as f32);
    Ok(Law::Column { normal, shear, flattening })
}

fn gap(data: &Data<'_>) -> Result<Law, FitError> {
    let channels = data.rows.first().map_or(0, |(x, _)| x.len());
    data.shaped((channels, "signals"), (channels, "the displacement of each signal's facet"))?;
    let curve = |k: usize| data.solve(|x, u| Some(([1, 2, 3].map(|n| x[k].powi(n)), u[k])));
    let powers = (0..channels).map(|k| curve(k).map(|powers| powers.map(|p| p as f32)));
    Ok(Law::Gap { powers: powers.collect::<Result<_, _>>()? })
}

fn feeler(data: &Data<'_>) -> Result<Law, FitError> {
    data.shaped((3, "G, u_x, u_y"), (3, "F_x, F_y, F_z"))?;
    let [normal] = data.solve(|x, f| Some(([x[0]], f[2])))?;
    let axis = |k: usize| -> Result<[f32; 4], FitError> {
        let rows: Vec<[f64; 3]> = data
            .rows
            .iter()
            .map(|(x, f)| [x[k + 1].abs(), normal * x[0], f[k] * x[k + 1].signum()])
            .collect();
        Ok(bilinear(&format!("{}: {}", data.part, ["x", "y"][k]), &rows)?.map(|value| value as f32))
    };
    Ok(Law::Feeler { normal: normal as f32, x: axis(0)?, y: axis(1)? })
}

/// β, K, α, γ from rows of |u|, F_z and the force along u.
///
/// The coefficients decide which rows stick, and the sticking rows decide the coefficients. Both
/// are iterated from several starts; the best result is kept.
fn bilinear(part: &str, rows: &[[f64; 3]]) -> Result<[f64; 4], FitError> {
    let mut order: Vec<f64> = rows.iter().map(|row| row[0]).collect();
    order.sort_by(f64::total_cmp);
    let mut best = None;
    let mut why = FitError::NoLoad { part: part.into() };
    for share in STICKING {
        let Some(limit) = order.get((share * order.len() as f64) as usize) else { continue };
        let mut sticks: Vec<bool> = rows.iter().map(|row| row[0] <= *limit).collect();
        let mut found = None;
        for _ in 0..MAX_ROUNDS {
            match pieces(part, rows, &sticks) {
                Ok(coefficients) => found = Some(coefficients),
                Err(error) => {
                    (found, why) = (None, error);
                    break;
                }
            }
            let law = found.map(|f| f.map(|f| f as f32)).map(shear);
            let next = rows.iter().map(|[u, normal, _]| {
                law.is_some_and(|law| {
                    let threshold = f64::from(law.friction) * normal + f64::from(law.adhesion);
                    f64::from(law.stuck) * u <= threshold
                })
            });
            let next: Vec<bool> = next.collect();
            if next == sticks {
                break;
            }
            sticks = next;
        }
        let Some(found) = found else { continue };
        let law = shear(found.map(|f| f as f32));
        let error: f64 = rows
            .iter()
            .map(|[u, normal, force]| {
                (f64::from(law.force(*u as f32, *normal as f32)) - force).powi(2)
            })
            .sum();
        if best.is_none_or(|(least, _)| error < least) {
            best = Some((error, found));
        }
    }
    best.map(|(_, found)| found).ok_or(why)
}

/// Fits both linear pieces: β·u while sticking, K·u + (1 − K/β)(αF_z + γ) while slipping.
fn pieces(part: &str, rows: &[[f64; 3]], sticks: &[bool]) -> Result<[f64; 4], FitError> {
    let of = |stuck: bool| rows.iter().zip(sticks).filter(move |(_, s)| **s == stuck).map(|r| r.0);
    let stuck: Vec<([f64; 1], f64)> = of(true).map(|[u, _, f]| ([*u], *f)).collect();
    let slips: Vec<([f64; 3], f64)> = of(false).map(|[u, n, f]| ([*u, *n, 1.0], *f)).collect();
    let [beta] = solve(&format!("{part}, sticking"), &stuck)?;
    let [sheet, friction, adhesion] = solve(&format!("{part}, slipping"), &slips)?;
    let lost = 1.0 - sheet / beta;
    Ok([beta, sheet, friction / lost, adhesion / lost])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(i: usize) -> f64 {
        (12.9898 * (i * i) as f64).sin()
    }

    /// Varying inputs and the law's targets for them, with noise of a hundredth.
    fn recorded(inputs: impl Fn(f64) -> Vec<f64>, law: &Law) -> Recorded {
        let x: Vec<Vec<f64>> = (0..900).map(|i| inputs(f64::from(i) * 0.07)).collect();
        let y = x.iter().enumerate().map(|(i, x)| {
            let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
            let y = law.estimate(&x).into_iter().map(f64::from).enumerate();
            y.map(|(k, y)| y + 0.01 * y.abs().min(1.0) * noise(3 * i + k)).collect()
        });
        (x.clone(), y.collect())
    }

    fn close(found: &[f32], wanted: &[f32], share: f32) {
        for (found, wanted) in found.iter().zip(wanted) {
            assert!((found / wanted - 1.0).abs() < share, "{found} for {wanted}");
        }
    }

    #[test]
    fn feeler_fit_recovers_four_constants() {
        let paper = [1.7, 0.067, 0.25, 0.56];
        let law = Law::Feeler { normal: 0.03, x: paper, y: [1.5, 0.08, 0.3, 0.4] };
        let inputs = |t: f64| {
            vec![
                150.0 + 100.0 * (0.3 * t).sin(),
                4.0 * t.sin() * (0.11 * t).cos(),
                3.0 * (1.3 * t).cos(),
            ]
        };
        let found = fit(Family::Feeler, &[recorded(inputs, &law)]).unwrap().unwrap();
        let Law::Feeler { normal, x, y } = found else { panic!("{found:?}") };
        close(&[normal], &[0.03], 0.01);
        close(&x, &paper, 0.05);
        close(&y, &[1.5, 0.08, 0.3, 0.4], 0.05);
        // Without slip the rows do not determine K, α and γ.
        let gentle = |t: f64| vec![150.0 + 100.0 * (0.3 * t).sin(), 0.1 * t.sin(), 0.1 * t.cos()];
        let refused = fit(Family::Feeler, &[recorded(gentle, &law)]).unwrap();
        assert!(refused.is_err(), "{refused:?}");
    }

    #[test]
    fn column_row_and_gap_fits_recover_coefficients() {
        let areas = |t: f64| [0.3, 0.9, 1.7, 2.3].map(|w| 0.3 + 0.2 * (w * t).sin()).to_vec();
        let law = Law::Column { normal: 0.25, shear: 0.20, flattening: 0.081 };
        let found = fit(Family::Column, &[recorded(areas, &law)]).unwrap().unwrap();
        let Law::Column { normal, shear, flattening } = found else { panic!("{found:?}") };
        close(&[normal, shear, flattening], &[0.25, 0.20, 0.081], 0.03);

        let point = [3.0, -5.0, 2.0, 4.0, -1.0, 6.0, 0.5, 9.0];
        let law = Law::Row { point, angle: point.map(|a| 7.0 * a) };
        let found = fit(Family::Row, &[recorded(areas, &law)]).unwrap().unwrap();
        let inputs = [0.2f32, 0.4, 0.3, 0.15];
        for (found, wanted) in found.estimate(&inputs).iter().zip(law.estimate(&inputs)) {
            assert!((found - wanted).abs() < 0.02 * wanted.abs(), "{found} {wanted}");
        }

        let law = Law::Gap { powers: vec![[2.0, -0.5, 0.3], [1.5, 0.4, -0.2]] };
        let two = |t: f64| vec![0.9 * t.sin(), 0.8 * (1.7 * t).cos()];
        let found = fit(Family::Gap, &[recorded(two, &law)]).unwrap().unwrap();
        let Law::Gap { powers } = found else { panic!("{found:?}") };
        close(powers.as_flattened(), &[2.0, -0.5, 0.3, 1.5, 0.4, -0.2], 0.03);
    }

    #[test]
    fn wrong_shape_and_underdetermined_loads_are_refused() {
        let law = Law::Column { normal: 0.25, shear: 0.20, flattening: 0.081 };
        let same = |t: f64| vec![0.3 + 0.2 * t.sin(); 4];
        let error = |family, data: Recorded| fit(family, &[data]).unwrap().unwrap_err().to_string();
        // Without shear A_x and A_y are zero.
        assert!(error(Family::Column, recorded(same, &law)).contains("no load"));
        let shape = error(Family::Row, recorded(same, &law));
        assert!(shape.contains("4 inputs and 3 targets where it takes 4 (u_1"), "{shape}");
        assert!(fit(Family::Ridge, &[]).is_none());
    }
}
