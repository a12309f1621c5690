//! Scaling of inputs and targets to about one, so that they share a decay and a distance.

use nalgebra::DMatrix;

/// Relation of a model's inputs to each other, which decides their scaling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inputs {
    /// Channels of one kind, with one unit and one noise: they are scaled together.
    ///
    /// A channel that hardly changes is not amplified until its noise and drift weigh as much as
    /// the others' signal.
    Alike,
    /// Quantities of different kinds: each is scaled by its own spread.
    Unlike,
}

/// Mean and spread of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scale {
    pub mean: f64,
    pub spread: f64,
}

impl Scale {
    /// Measures a column; a constant one has no spread.
    pub fn of(column: impl Iterator<Item = f64> + Clone) -> Self {
        let n = column.clone().count().max(1) as f64;
        let mean = column.clone().sum::<f64>() / n;
        // The mean is rounded; a constant column must still get no spread.
        let first = column.clone().next();
        let rests = column.clone().all(|v| Some(v) == first);
        let square = column.map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        Self { mean, spread: if rests { 0.0 } else { square.sqrt() } }
    }

    /// Scales a value to about one; zero for a column that never changes.
    pub fn scaled(&self, value: f64) -> f64 {
        if self.spread > 0.0 { (value - self.mean) / self.spread } else { 0.0 }
    }
}

/// Scales of all columns.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scaling {
    pub inputs: Vec<Scale>,
    pub targets: Vec<Scale>,
}

impl Scaling {
    /// Computes the scales of some rows; every row is as wide as the first.
    pub fn of<R: AsRef<[f64]>>(x: &[R], y: &[R], kind: Inputs) -> Self {
        let mut inputs = scales(x);
        if kind == Inputs::Alike {
            let squares: f64 = inputs.iter().map(|scale| scale.spread.powi(2)).sum();
            let common = (squares / inputs.len() as f64).sqrt();
            inputs.iter_mut().filter(|s| s.spread > 0.0).for_each(|s| s.spread = common);
        }
        Self { inputs, targets: scales(y) }
    }

    /// Whether some target is the same in every row.
    pub fn a_target_rests(&self) -> bool {
        self.targets.iter().any(|target| target.spread == 0.0)
    }

    /// Scaled inputs, a row a moment.
    pub fn inputs<R: AsRef<[f64]>>(&self, x: &[R]) -> DMatrix<f64> {
        matrix(x, &self.inputs)
    }

    /// Scaled targets, a row a moment.
    pub fn targets<R: AsRef<[f64]>>(&self, y: &[R]) -> DMatrix<f64> {
        matrix(y, &self.targets)
    }
}

fn matrix<R: AsRef<[f64]>>(rows: &[R], scales: &[Scale]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), scales.len(), |row, i| scales[i].scaled(rows[row].as_ref()[i]))
}

fn scales<R: AsRef<[f64]>>(rows: &[R]) -> Vec<Scale> {
    let width = rows.first().map_or(0, |row| row.as_ref().len());
    (0..width).map(|i| Scale::of(rows.iter().map(|row| row.as_ref()[i]))).collect()
}

/// Keeps every k-th row, so that at most `most` are left.
///
/// A recording at kilohertz repeats itself from row to row.
pub fn thinned<R>(rows: &[R], most: usize) -> impl Iterator<Item = &R> {
    rows.iter().step_by(rows.len().div_ceil(most).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alike_inputs_share_one_scale() {
        let rows: [&[f64]; 2] = [&[1.0, 70.0, 5.0], &[3.0, 84.0, 5.0]];
        let spreads = |kind| {
            let scaling = Scaling::of(&rows, &rows, kind);
            scaling.inputs.iter().map(|s| s.spread).collect::<Vec<_>>()
        };
        let common = (50.0f64 / 3.0).sqrt();
        assert_eq!(spreads(Inputs::Alike), [common, common, 0.0]);
        assert_eq!(spreads(Inputs::Unlike), [1.0, 7.0, 0.0]);
    }

    #[test]
    fn constant_column_scales_to_zero_despite_rounding() {
        let rows = vec![vec![0.1]; 7];
        let scaling = Scaling::of(&rows, &rows, Inputs::Unlike);
        assert!(scaling.a_target_rests());
        assert_eq!(scaling.inputs(&rows).amax(), 0.0);
    }
}
