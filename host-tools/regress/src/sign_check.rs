//! Detection of references with a flipped sign in some of several recordings.
//!
//! A law fitted to all recordings but one predicts that one. It is linear in the others'
//! references, so that its prediction with any of them flipped follows without another fit. With
//! the signs s of the recordings the unpredicted share of recording r is sᵀG_r·s. The signs with
//! the best mutual predictions show which recordings are flipped.

use std::cmp::Ordering;

use nalgebra::{DMatrix, DVector};

use crate::error::FitError;
use crate::polynomial::Expansion;
use crate::ridge::{Sums, outputs};
use crate::scaling::{Inputs, Scaling, thinned};
use crate::training::Recorded;

/// Decays of the laws, relative to a noise of one; rows are scaled to about one.
///
/// Shear in products of signals needs a weak decay, a few presses a strong one.
const DECAYS: [f64; 2] = [1e-2, 1.0];
/// Most rows of a recording that are used.
const ROWS: usize = 2000;
/// Most terms of a quadratic law; shear of a matrix of taxels is in the products alone.
const MOST_TERMS: usize = 200;
/// Least share of a flipped recording that the others predict with its sign flipped …
const FORETOLD: f64 = 0.3;
/// … and its least spread, as a share of the target's largest.
///
/// A target that hardly changes is predicted only by chance.
const MOVES: f64 = 0.2;

/// Least ratio of mean to mean size of a target in one direction: it presses or pulls.
const ONE_WAY: f64 = 0.5;

/// Inputs and targets of some rows of a recording.
type Thinned<'r> = (Vec<&'r [f64]>, Vec<&'r [f64]>);
/// Unpredicted part of a recording for each law, as a quadratic form of the signs.
type Forms = Vec<DMatrix<f64>>;

/// Checks that the recordings agree on the sign of every target.
///
/// # Errors
/// The recordings and targets whose sign is flipped.
pub fn same_sign(
    recordings: &[Recorded],
    names: &[String],
    targets: &[String],
) -> Result<(), FitError> {
    let thin: Vec<Thinned<'_>> = recordings.iter().map(|(x, y)| (slices(x), slices(y))).collect();
    if thin.iter().filter(|(x, _)| !x.is_empty()).count() < 2 {
        return Ok(());
    }
    let laws = laws(&thin);
    let turned: Vec<Vec<usize>> = (0..targets.len())
        .map(|k| {
            let y: Vec<DVector<f64>> = thin
                .iter()
                .map(|(_, y)| DVector::from_iterator(y.len(), y.iter().map(|y| y[k])))
                .collect();
            turned(&forms(&laws, &y), &y)
        })
        .collect();
    let Some(which) = turned.iter().find(|which| !which.is_empty()) else { return Ok(()) };
    let columns = targets.iter().zip(&turned).filter(|(_, turned)| *turned == which);
    let columns: Vec<&str> = columns.map(|(target, _)| target.as_str()).collect();
    let of = |which: &mut dyn Iterator<Item = usize>| {
        which.map(|r| names[r].as_str()).collect::<Vec<_>>().join(", ")
    };
    let others = of(&mut (0..names.len()).filter(|r| !which.contains(r)));
    Err(FitError::Mismatch {
        recording: of(&mut which.iter().copied()),
        problem: format!(
            "{} {} the opposite sign of {}",
            columns.join(", "),
            if columns.len() == 1 { "has" } else { "have" },
            if names.len() == 2 { &others } else { "the other recordings" }
        ),
        mend: "invert the sign in the recordings where it is wrong".into(),
    })
}

fn slices(rows: &[Vec<f64>]) -> Vec<&[f64]> {
    thinned(rows, ROWS).map(Vec::as_slice).collect()
}

/// Inputs of each recording for each law: linear and, if its terms are few, quadratic.
fn laws(recordings: &[Thinned<'_>]) -> Vec<Vec<DMatrix<f64>>> {
    let (x, y): (Vec<_>, Vec<_>) = recordings.iter().cloned().unzip();
    let scaling = Scaling::of(&x.concat(), &y.concat(), Inputs::Unlike);
    let width = scaling.inputs.len();
    let few = width * (width + 3) / 2 <= MOST_TERMS;
    let expansions = [Some(Expansion::None), few.then_some(Expansion::Quadratic)];
    let law = |expansion: Expansion| {
        let scaled = x.iter().map(|x| scaling.inputs(x));
        let expanded = scaled.map(|x| {
            let rows =
                x.row_iter().map(|row| expansion.terms(&row.iter().copied().collect::<Vec<_>>()));
            let rows: Vec<Vec<f64>> = rows.collect();
            DMatrix::from_fn(rows.len(), expansion.terms(&vec![0.0; width]).len(), |i, j| {
                rows[i][j]
            })
        });
        expanded.collect()
    };
    expansions.into_iter().flatten().map(law).collect()
}

/// [`Forms`] of each recording for a target; empty if the target hardly changes there.
fn forms(laws: &[Vec<DMatrix<f64>>], y: &[DVector<f64>]) -> Vec<Forms> {
    let centred: Vec<DVector<f64>> = y.iter().map(centred).collect();
    let spread = |y: &DVector<f64>| y.norm() / (y.len().max(1) as f64).sqrt();
    let most = centred.iter().map(spread).fold(0.0, f64::max);
    let moves = |r: usize| most > 0.0 && spread(&centred[r]) >= MOVES * most;
    let mut forms = vec![Forms::new(); y.len()];
    for x in laws {
        let target = |r: usize| DMatrix::from_column_slice(y[r].len(), 1, y[r].as_slice());
        let own: Vec<Sums> = (0..y.len()).map(|r| Sums::of(&x[r], &target(r))).collect();
        let Some(all) = own.iter().cloned().reduce(|a, b| a.with(&b)) else { continue };
        for r in (0..y.len()).filter(|r| moves(*r)) {
            // Each recording's contribution to the prediction of r, a column; r's own is its
            // reference.
            let mut parts = all.without(&own[r]);
            parts.cross =
                DMatrix::from_fn(parts.gram.nrows(), y.len(), |i, j| own[j].cross[(i, 0)]);
            for line in DECAYS.iter().filter_map(|decay| parts.solve(*decay)) {
                let mut said = outputs(&line, &x[r]);
                for (j, mut column) in said.column_iter_mut().enumerate() {
                    let said = self::centred(&column.clone_owned());
                    column.copy_from(&if j == r { -&centred[r] } else { said });
                }
                forms[r].push(said.tr_mul(&said) / centred[r].norm_squared());
            }
        }
    }
    forms
}

fn centred(y: &DVector<f64>) -> DVector<f64> {
    if y.is_empty() { y.clone() } else { y.add_scalar(-y.mean()) }
}

/// Share of a recording that no law predicts; one at most.
fn missed(forms: &Forms, signs: &DVector<f64>) -> f64 {
    forms.iter().map(|form| signs.dot(&(form * signs))).fold(1.0, f64::min)
}

/// Finds the flipped recordings.
///
/// Flips one after another as long as that improves the total and the recording's own prediction
/// surely.
fn turned(forms: &[Forms], y: &[DVector<f64>]) -> Vec<usize> {
    let mut signs = DVector::from_element(y.len(), 1.0);
    let total = |signs: &DVector<f64>| forms.iter().map(|forms| missed(forms, signs)).sum::<f64>();
    let mut least = total(&signs);
    loop {
        let tried = (0..y.len()).map(|r| {
            let mut tried = signs.clone();
            tried[r] = -tried[r];
            let surely = missed(&forms[r], &tried) <= 1.0 - FORETOLD;
            (if surely { total(&tried) } else { f64::INFINITY }, tried)
        });
        match tried.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((now, tried)) if now < least => (least, signs) = (now, tried),
            _ => break,
        }
    }
    let with = |sign: f64| (0..y.len()).filter(|r| signs[*r] == sign).collect::<Vec<_>>();
    let (kept, turned) = (with(1.0), with(-1.0));
    // The majority is taken as right. For equal halves, the half that presses is right, or that of
    // the first recording.
    let mean = |which: &[usize], of: fn(f64) -> f64| {
        which.iter().map(|r| y[*r].map(of).sum() / y[*r].len().max(1) as f64).sum::<f64>()
    };
    let pulls = |which: &[usize], other: &[usize]| {
        let share = |which| mean(which, |y| y) / mean(which, f64::abs);
        share(which) < -ONE_WAY && share(other) > ONE_WAY
    };
    let other = match turned.len().cmp(&kept.len()) {
        Ordering::Less => false,
        Ordering::Greater => true,
        Ordering::Equal if pulls(&turned, &kept) => false,
        Ordering::Equal => pulls(&kept, &turned) || turned.contains(&0),
    };
    if other { kept } else { turned }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three channels: a load, its position, and a mixture; a force, and shear in their product
    /// only.
    fn recording(rows: usize, from: f64) -> Recorded {
        let x: Vec<Vec<f64>> = (0..rows)
            .map(|row| from + row as f64 * 0.05)
            .map(|t| vec![30.0 + 30.0 * t.sin(), 20.0 * (1.7 * t).cos(), 4.0 * (0.6 * t).sin()])
            .collect();
        let y = x.iter().map(|x| vec![0.1 * x[0], (x[0] - 30.0) * x[1] / 300.0]).collect();
        (x, y)
    }

    fn judged(turned: &[(usize, usize)], rows: &[usize]) -> Result<(), String> {
        let mut all: Vec<Recorded> =
            rows.iter().enumerate().map(|(r, rows)| recording(*rows, 40.0 * r as f64)).collect();
        for (r, k) in turned {
            all[*r].1.iter_mut().for_each(|y| y[*k] = -y[*k]);
        }
        let names: Vec<String> = ["a", "b", "c", "d", "e"].map(|n| format!("{n}.csv")).into();
        let targets = ["fz_n", "fx_n"].map(String::from);
        same_sign(&all, &names[..rows.len()], &targets).map_err(|error| error.to_string())
    }

    #[test]
    fn recordings_of_equal_sign_pass() {
        for rows in [&[600][..], &[600, 60], &[300, 400, 500], &[200, 0, 900, 30]] {
            assert_eq!(judged(&[], rows), Ok(()));
        }
    }

    #[test]
    fn flipped_recordings_are_named_with_their_columns() {
        for (turned, rows, said) in [
            (
                &[(1, 0)][..],
                &[300, 400, 500][..],
                "b.csv: fz_n has the opposite sign of the other recordings",
            ),
            // The recording that pulls, though it is the first.
            (&[(0, 0)], &[300, 400], "a.csv: fz_n has the opposite sign of b.csv"),
            (&[(1, 1)], &[300, 400], "b.csv: fx_n has the opposite sign of a.csv"),
            (&[(2, 0), (2, 1)], &[300, 400, 2000], "c.csv: fz_n, fx_n have the opposite sign"),
            (
                &[(1, 1), (3, 1)],
                &[300, 900, 400, 500, 300],
                "b.csv, d.csv: fx_n has the opposite sign",
            ),
        ] {
            let error = judged(turned, rows).unwrap_err();
            assert!(error.starts_with(said), "{turned:?}: {error}");
        }
    }

    #[test]
    fn sign_check_ignores_recording_without_shear() {
        let mut all = [recording(400, 0.0), recording(400, 40.0)];
        all[1].1.iter_mut().for_each(|y| y[1] *= -0.05);
        let (names, targets) = (["a".into(), "b".into()], ["fz_n".into(), "fx_n".into()]);
        assert_eq!(same_sign(&all, &names, &targets), Ok(()));
    }
}
