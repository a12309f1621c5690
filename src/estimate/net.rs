//! The feed-forward net of 002: one hidden layer of tanh units, linear output.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::tanh::tanh;
use crate::scan::TAXELS;

/// Most hidden units a record may hold. 002 uses 12 (normal only) and 16 (three components).
pub const MAX_HIDDEN: usize = 32;
/// Most outputs: f_x, f_y, f_z.
pub const MAX_OUTPUTS: usize = 3;

/// Weights below this cannot overflow a sum of inputs in [−2, 2]; no fit gives larger ones.
const HUGE: f32 = 1e30;

/// y = V·tanh(W·x + a) + b for weights given as flat row-major slices.
///
/// `hidden` is W, one row of `x.len()` weights a unit; `hidden_bias` is a; `output` is V, one row of
/// `hidden_bias.len()` weights an output; `output_bias` is b. `units` is scratch for the hidden
/// activations. Where lengths do not fit each other the shortest wins, and nothing panics; shapes are
/// validated when a record is read, not here. The summation order is fixed: the same bits everywhere.
pub fn forward(
    x: &[f32],
    (hidden, hidden_bias): (&[f32], &[f32]),
    (output, output_bias): (&[f32], &[f32]),
    units: &mut [f32],
    y: &mut [f32],
) {
    for ((unit, row), bias) in
        units.iter_mut().zip(hidden.chunks_exact(x.len().max(1))).zip(hidden_bias)
    {
        *unit = tanh(dot(row, x, *bias));
    }
    for ((y, row), bias) in
        y.iter_mut().zip(output.chunks_exact(hidden_bias.len().max(1))).zip(output_bias)
    {
        *y = dot(row, units, *bias);
    }
}

fn dot(row: &[f32], x: &[f32], bias: f32) -> f32 {
    row.iter().zip(x).fold(bias, |sum, (w, x)| sum + w * x)
}

/// The net of one finger: 16 signals c_k in, one (f_z) or three (f_x, f_y, f_z) forces in newtons out.
/// Input and output scaling are folded into the weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ForceNet {
    /// W, hidden × 16.
    pub hidden: Vec<f32, { MAX_HIDDEN * TAXELS }>,
    /// a, one a hidden unit.
    pub hidden_bias: Vec<f32, MAX_HIDDEN>,
    /// V, outputs × hidden.
    pub output: Vec<f32, { MAX_OUTPUTS * MAX_HIDDEN }>,
    /// b, one an output: either one (f_z) or three (f_x, f_y, f_z).
    pub output_bias: Vec<f32, MAX_OUTPUTS>,
}

impl ForceNet {
    /// Units and weights of the hidden layer fit each other and are finite.
    pub(crate) fn hidden_layer_fits(&self) -> bool {
        !self.hidden_bias.is_empty()
            && self.hidden.len() == self.hidden_bias.len() * TAXELS
            && self.hidden.iter().chain(&self.hidden_bias).all(|w| w.abs() < HUGE)
    }

    /// Outputs and their weights fit the hidden layer and are finite.
    pub(crate) fn output_layer_fits(&self) -> bool {
        matches!(self.output_bias.len(), 1 | 3)
            && self.output.len() == self.output_bias.len() * self.hidden_bias.len()
            && self.output.iter().chain(&self.output_bias).all(|w| w.abs() < HUGE)
    }

    /// Forces in newtons: `[f_z]` or `[f_x, f_y, f_z]`.
    #[must_use]
    pub fn forces(&self, c: &[f32; TAXELS]) -> Vec<f32, MAX_OUTPUTS> {
        let mut units = [0.0; MAX_HIDDEN];
        let mut y = self.output_bias.clone();
        forward(
            c,
            (&self.hidden, &self.hidden_bias),
            (&self.output, &self.output_bias),
            &mut units,
            &mut y,
        );
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_net_written_out_by_hand_gives_what_the_formula_gives() {
        let x = [0.5, -0.25];
        let (hidden, hidden_bias) = ([1.0, 2.0, -1.0, 0.5], [0.1, -0.2]);
        let (output, output_bias) = ([2.0, -3.0], [0.7]);
        let mut y = [0.0];
        forward(&x, (&hidden, &hidden_bias), (&output, &output_bias), &mut [0.0; 2], &mut y);
        let h0 = (0.1f64 + 0.5 - 0.5).tanh();
        let h1 = (-0.2f64 - 0.5 - 0.125).tanh();
        assert!((f64::from(y[0]) - (0.7 + 2.0 * h0 - 3.0 * h1)).abs() < 1e-6);
    }
}
