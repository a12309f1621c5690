//! Channels that are linear combinations of others.

use nalgebra::{DMatrix, SymmetricEigen};

use crate::gaussian::Rows;
use crate::scaling::{Inputs, Scaling};
use crate::training::Recorded;

/// Largest share of the strongest combination at which channels count as collinear.
const SAME: f64 = 1e-6;
/// Least weight of a channel that takes part in a combination.
const PART: f64 = 0.2;

/// Scales the rows of all recordings together.
pub(crate) fn scaled(recordings: &[Recorded]) -> (Scaling, Rows) {
    let x: Vec<&[f64]> = recordings.iter().flat_map(|r| &r.0).map(Vec::as_slice).collect();
    let y: Vec<&[f64]> = recordings.iter().flat_map(|r| &r.1).map(Vec::as_slice).collect();
    let scaling = Scaling::of(&x, &y, Inputs::Unlike);
    let number = recordings.iter().enumerate();
    let stretch = number.flat_map(|(i, r)| std::iter::repeat_n(i, r.0.len())).collect();
    let rows = Rows { x: scaling.inputs(&x), y: scaling.targets(&y), stretch };
    (scaling, rows)
}

/// Conditioning of the channels, each scaled by its own spread.
///
/// Channels that never change are left out.
pub struct Conditioning {
    /// Condition number of the data.
    pub number: f64,
    /// Indices of the channels in the combination that varies least.
    pub weakest: Vec<usize>,
}

impl Conditioning {
    /// Whether the channels are collinear.
    pub fn is_collinear(&self) -> bool {
        self.number > 1.0 / SAME
    }
}

/// Computes the conditioning; `None` if fewer than two channels change.
pub fn conditioning(recordings: &[Recorded]) -> Option<Conditioning> {
    let (scaling, rows) = scaled(recordings);
    let moving: Vec<usize> =
        (0..scaling.inputs.len()).filter(|i| scaling.inputs[*i].spread > 0.0).collect();
    if moving.len() < 2 {
        return None;
    }
    let x: DMatrix<f64> = rows.x.select_columns(&moving);
    let eigen = SymmetricEigen::new(x.tr_mul(&x));
    let (least, most) = (eigen.eigenvalues.imin(), eigen.eigenvalues.max());
    let ratio = (eigen.eigenvalues[least].max(0.0) / most).sqrt();
    let weights = eigen.eigenvectors.column(least);
    let part = moving.iter().zip(weights.iter()).filter(|(_, w)| w.abs() > PART);
    let weakest = part.map(|(i, _)| *i).collect();
    Some(Conditioning { number: 1.0 / ratio.max(1e-15), weakest })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three varying channels and a nonlinear force.
    fn recording(rows: usize) -> Recorded {
        let x: Vec<Vec<f64>> = (0..rows)
            .map(|row| row as f64 * 0.05)
            .map(|t| vec![30.0 * t.sin(), 20.0 * (1.7 * t).cos(), 4.0 * (0.6 * t).sin()])
            .collect();
        let y = x.iter().map(|x| vec![0.1 * x[0] + (x[1] / 8.0).tanh()]).collect();
        (x, y)
    }

    #[test]
    fn dependent_channel_is_found_with_its_partners() {
        let mut recording = recording(300);
        let even = conditioning(std::slice::from_ref(&recording)).unwrap();
        assert!(even.number < 2.0 && !even.is_collinear(), "{}", even.number);
        recording.0.iter_mut().for_each(|x| x[2] = 0.5 * x[0] - 3.0);
        let found = conditioning(&[recording]).unwrap();
        assert!(found.weakest == [0, 2] && found.is_collinear(), "{:?}", found.weakest);
    }
}
