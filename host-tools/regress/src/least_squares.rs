//! S of one force sensor by linear least squares, row by row ([Ospina2017] eqs (1.22)–(1.24)).

use nalgebra::{DMatrix, QR, SVD};

use crate::error::FitError;

/// Fewest rows of a usable recording.
const LEAST_ROWS: usize = 50;

/// Least RMS signal-to-noise ratio in every direction.
///
/// Noise of the regressors draws S towards zero by about 1/ratio²: at 5, by 4 % in the weakest
/// direction.
const LEAST_RATIO: f64 = 5.0;

/// A fitted S.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeastSquares {
    /// S in newtons per fraction of full scale: row i gives force component i.
    pub s: [[f64; 3]; 3],
    /// Ratio of the largest to the smallest singular value of the signals.
    ///
    /// Large values mean that the loads determine the directions unevenly.
    pub condition: f64,
    /// Signal-to-noise ratio in the weakest direction.
    pub ratio: f64,
    /// RMS error of each component in newtons.
    pub rms: [f64; 3],
}

/// Fits f = S·u to the rows, with u = bridge outputs − b.
///
/// `noise` is the standard deviation of u while unloaded.
///
/// # Errors
///
/// Too few rows, no load, or loads that do not span all three axes.
pub fn fit(
    part: &str,
    signals: &[[f64; 3]],
    forces: &[[f64; 3]],
    noise: f64,
) -> Result<LeastSquares, FitError> {
    let rows = signals.len().min(forces.len());
    if rows < LEAST_ROWS {
        return Err(FitError::TooFewRows { part: part.into(), rows, least: LEAST_ROWS });
    }
    let u = DMatrix::from_fn(rows, 3, |row, j| signals[row][j]);
    let f = DMatrix::from_fn(rows, 3, |row, i| forces[row][i]);
    let rms = |sum: f64| (sum / rows as f64).sqrt();
    if f.norm_squared() == 0.0 || rms(u.norm_squared()) < LEAST_RATIO * noise {
        return Err(FitError::NoLoad { part: part.into() });
    }

    let qr = QR::new(u.clone());
    let r = qr.r();
    let singular = SVD::new(r.clone(), false, false).singular_values;
    let (most, least) = (singular.max(), singular.min());
    let ratio = least / (rows as f64).sqrt() / noise.max(f64::MIN_POSITIVE);
    let collinear = || FitError::Collinear { part: part.into(), ratio, least: LEAST_RATIO };
    if ratio < LEAST_RATIO || least < 1e-9 * most {
        return Err(collinear());
    }
    let transposed = r.solve_upper_triangular(&(qr.q().transpose() * &f)).ok_or_else(collinear)?;
    let error = &u * &transposed - &f;
    Ok(LeastSquares {
        s: std::array::from_fn(|i| std::array::from_fn(|j| transposed[(j, i)])),
        condition: most / least,
        ratio,
        rms: std::array::from_fn(|i| rms(error.column(i).norm_squared())),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const S: [[f64; 3]; 3] = [[118.0, 3.0, -2.0], [-4.0, 120.0, 1.0], [9.0, -7.0, 60.0]];

    fn forces_of(s: [[f64; 3]; 3], u: &[[f64; 3]]) -> Vec<[f64; 3]> {
        u.iter().map(|u| s.map(|row| row.iter().zip(u).map(|(s, u)| s * u).sum())).collect()
    }

    /// Signals that vary in all three directions.
    fn wandering() -> Vec<[f64; 3]> {
        let wave = |t: f64, rate: f64| 0.01 * (rate * t).sin();
        (0..300)
            .map(|i| f64::from(i) * 0.1)
            .map(|t| [wave(t, 1.0), wave(t, 1.7), wave(t, 0.6)])
            .collect()
    }

    proptest! {
        #[test]
        fn matrix_is_recovered_from_noiseless_signals(s in prop::array::uniform3(prop::array::uniform3(-200.0..200.0f64))) {
            let u = wandering();
            let f = forces_of(s, &u);
            prop_assume!(f.iter().flatten().any(|f| *f != 0.0));
            let fit = fit("s0", &u, &f, 1e-5).unwrap();
            for (found, s) in fit.s.iter().flatten().zip(s.iter().flatten()) {
                prop_assert!((found - s).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn matrix_includes_crosstalk_and_rms_the_remainder() {
        let u = wandering();
        let mut f = forces_of(S, &u);
        f.iter_mut().enumerate().for_each(|(i, f)| f[1] += if i % 2 == 0 { 0.01 } else { -0.01 });
        let fit = fit("s0", &u, &f, 1e-5).unwrap();
        assert!((fit.rms[1] - 0.01).abs() < 1e-4 && fit.rms[0] < 1e-9, "{:?}", fit.rms);
        assert!((fit.s[2][0] - 9.0).abs() < 1e-6);
        assert!(fit.condition > 1.0 && fit.condition < 2.0, "{}", fit.condition);
    }

    #[test]
    fn unloaded_recording_is_refused() {
        let u = vec![[1e-6, -1e-6, 1e-6]; 300];
        assert!(matches!(fit("s0", &u, &vec![[0.0; 3]; 300], 1e-5), Err(FitError::NoLoad { .. })));
    }

    #[test]
    fn collinear_loads_are_refused_with_remedy() {
        let u: Vec<_> = wandering().iter().map(|u| [u[0], 0.5 * u[0], -u[0]]).collect();
        let error = fit("s1", &u, &forces_of(S, &u), 1e-5).unwrap_err();
        assert!(matches!(error, FitError::Collinear { .. }));
        assert!(error.to_string().contains("load it in x, y and z"), "{error}");
    }

    #[test]
    fn a_dozen_rows_are_refused() {
        let u = &wandering()[..12];
        let error = fit("s0", u, &forces_of(S, u), 1e-5).unwrap_err();
        assert_eq!(
            error.to_string(),
            "s0: 12 usable rows where at least 50 are needed; record for longer"
        );
    }
}
