//! The feed-forward net of 002, one hidden layer of tanh units and linear output, with a linear skip path.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::tanh::{tanh, tanh_of_bounded};
use crate::scan::TAXELS;

/// Most hidden units a record may hold. 002 uses 12 (normal only) and 16 (three components).
pub const MAX_HIDDEN: usize = 32;
/// Most outputs: f_x, f_y, f_z.
pub const MAX_OUTPUTS: usize = 3;

/// Weights below this cannot overflow a sum of inputs in [−2, 2]; no fit gives larger ones.
pub(super) const HUGE: f32 = 1e30;

/// y = V·tanh(W·x + a) + L·x + b, for weights given as flat row-major slices.
///
/// The linear skip path L lets the tanh units bend what a straight line already says. Without it (empty)
/// this is the net of 002, without units it is linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layers<'w> {
    /// W, one row of weights, as many as there are inputs, a unit.
    pub hidden: &'w [f32],
    /// a, one a unit.
    pub hidden_bias: &'w [f32],
    /// V, one row of weights, as many as there are units, an output.
    pub output: &'w [f32],
    /// L, one row of weights, as many as there are inputs, an output; or empty.
    pub skip: &'w [f32],
    /// b, one an output.
    pub output_bias: &'w [f32],
}

impl Layers<'_> {
    /// The outputs `y` for the inputs `x`.
    ///
    /// Where lengths do not fit each other the shortest wins, and nothing panics; shapes are validated
    /// when a record is read, not here. The summation order is fixed: the same bits everywhere.
    pub fn outputs(&self, x: &[f32], y: &mut [f32]) {
        for (y, bias) in y.iter_mut().zip(self.output_bias) {
            *y = *bias;
        }
        for (y, row) in y.iter_mut().zip(self.skip.chunks_exact(x.len().max(1))) {
            *y = dot(row, x, *y);
        }
        let rows = self.hidden.chunks_exact(x.len().max(1)).zip(self.hidden_bias);
        for (j, (row, bias)) in rows.enumerate() {
            let unit = tanh(dot(row, x, *bias));
            for (y, row) in y.iter_mut().zip(self.output.chunks_exact(self.hidden_bias.len())) {
                *y += unit * row.get(j).copied().unwrap_or_default();
            }
        }
    }
}

/// bias + row·x.
#[inline]
fn dot(row: &[f32], x: &[f32], bias: f32) -> f32 {
    row.iter().zip(x).fold(bias, |sum, (w, x)| sum + w * x)
}

/// The net of one finger: 16 signals c_k in, one (f_z) or three (f_x, f_y, f_z) forces in newtons out.
/// Input and output scaling are folded into the weights. See [`Layers`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForceNet {
    /// W, hidden × 16.
    pub hidden: Vec<f32, { MAX_HIDDEN * TAXELS }>,
    /// a, one a hidden unit.
    pub hidden_bias: Vec<f32, MAX_HIDDEN>,
    /// V, outputs × hidden.
    pub output: Vec<f32, { MAX_OUTPUTS * MAX_HIDDEN }>,
    /// L, outputs × 16; empty without a skip path.
    pub skip: Vec<f32, { MAX_OUTPUTS * TAXELS }>,
    /// b, one an output: either one (f_z) or three (f_x, f_y, f_z).
    pub output_bias: Vec<f32, MAX_OUTPUTS>,
}

impl ForceNet {
    /// Units and weights of the hidden layer fit each other and are finite; without units there must be
    /// a skip path, or the net would say the same whatever it sees.
    pub(crate) fn hidden_layer_fits(&self) -> bool {
        !(self.hidden_bias.is_empty() && self.skip.is_empty())
            && self.hidden.len() == self.hidden_bias.len() * TAXELS
            && self.hidden.iter().chain(&self.hidden_bias).all(|w| w.abs() < HUGE)
    }

    /// Outputs and their weights fit the hidden layer and are finite.
    pub(crate) fn output_layer_fits(&self) -> bool {
        matches!(self.output_bias.len(), 1 | 3)
            && self.output.len() == self.output_bias.len() * self.hidden_bias.len()
            && self.output.iter().chain(&self.output_bias).all(|w| w.abs() < HUGE)
    }

    /// The skip path, if any, fits the outputs and is finite.
    pub(crate) fn skip_fits(&self) -> bool {
        (self.skip.is_empty() || self.skip.len() == self.output_bias.len() * TAXELS)
            && self.skip.iter().all(|w| w.abs() < HUGE)
    }

    /// Forces in newtons: `[f_z]` or `[f_x, f_y, f_z]`. The bits of [`Layers::outputs`], in two thirds of its
    /// time: signals and sums stay in registers. A single output is for that taken for three alike.
    #[must_use]
    pub fn forces(&self, c: &[f32; TAXELS]) -> Vec<f32, MAX_OUTPUTS> {
        let ([mut x, mut y, mut z], rows) = match self.output_bias[..] {
            [only] => ([only; 3], Some([&self.output[..]; 3])),
            [x, y, z] => ([x, y, z], thirds(&self.output, self.hidden_bias.len())),
            _ => return Vec::new(),
        };
        if let [l, m, n] = self.skip.as_chunks::<TAXELS>().0 {
            x = dot(l, c, x);
            y = dot(m, c, y);
            z = dot(n, c, z);
        } else if let [l] = self.skip.as_chunks::<TAXELS>().0 {
            z = dot(l, c, z);
        }
        let [v, w, u] = rows.unwrap_or_default();
        let units = self.hidden.as_chunks::<TAXELS>().0.iter().zip(&self.hidden_bias);
        for ((row, bias), ((v, w), u)) in units.zip(v.iter().zip(w).zip(u)) {
            let unit = tanh_of_bounded(dot(row, c, *bias));
            x += unit * v;
            y += unit * w;
            z += unit * u;
        }
        match self.output_bias.len() {
            1 => Vec::from_array([z]),
            _ => Vec::from_array([x, y, z]),
        }
    }
}

/// Three rows of `length`.
fn thirds(rows: &[f32], length: usize) -> Option<[&[f32]; 3]> {
    let (first, rest) = rows.split_at_checked(length)?;
    let (second, third) = rest.split_at_checked(length)?;
    Some([first, second, third])
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    const X: [f32; 2] = [0.5, -0.25];
    const NET: Layers<'_> = Layers {
        hidden: &[1.0, 2.0, -1.0, 0.5],
        hidden_bias: &[0.1, -0.2],
        output: &[2.0, -3.0],
        skip: &[],
        output_bias: &[0.7],
    };

    fn output(net: Layers<'_>) -> f64 {
        let mut y = [0.0];
        net.outputs(&X, &mut y);
        f64::from(y[0])
    }

    #[test]
    fn a_net_written_out_by_hand_gives_what_the_formula_gives() {
        let h0 = (0.1f64 + 0.5 - 0.5).tanh();
        let h1 = (-0.2f64 - 0.5 - 0.125).tanh();
        let bent = 0.7 + 2.0 * h0 - 3.0 * h1;
        assert!((output(NET) - bent).abs() < 1e-6);
        let skip: &[f32] = &[1.0, 8.0];
        assert!((output(Layers { skip, ..NET }) - (bent + 0.5 - 2.0)).abs() < 1e-6);
    }

    #[test]
    fn without_units_it_is_linear_and_without_anything_it_is_its_bias() {
        let bare = Layers { hidden: &[], hidden_bias: &[], output: &[], ..NET };
        assert!((output(Layers { skip: &[1.0, 8.0], ..bare }) - (0.7 + 0.5 - 2.0)).abs() < 1e-6);
        assert!((output(bare) - 0.7).abs() < 1e-6);
    }

    /// Numbers in [−scale, scale).
    pub(in crate::estimate) struct Numbers(pub u32);

    impl Numbers {
        pub fn next(&mut self, scale: f32) -> f32 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (self.0 as f32 / (1u64 << 31) as f32 - 1.0) * scale
        }

        pub fn net(&mut self, hidden: usize, outputs: usize, skip: bool) -> ForceNet {
            ForceNet {
                hidden: (0..hidden * TAXELS).map(|_| self.next(1.0)).collect(),
                hidden_bias: (0..hidden).map(|_| self.next(0.5)).collect(),
                output: (0..hidden * outputs).map(|_| self.next(0.5)).collect(),
                skip: (0..usize::from(skip) * outputs * TAXELS).map(|_| self.next(1.0)).collect(),
                output_bias: (0..outputs).map(|_| self.next(0.1)).collect(),
            }
        }
    }

    #[test]
    fn a_fingers_net_gives_the_bits_of_the_general_one() {
        let mut numbers = Numbers(1);
        for (hidden, outputs, skip) in
            [(16, 3, false), (6, 3, true), (12, 1, false), (5, 1, true), (0, 3, true), (0, 1, true)]
        {
            let net = numbers.net(hidden, outputs, skip);
            assert!(net.hidden_layer_fits() && net.output_layer_fits() && net.skip_fits());
            let layers = Layers {
                hidden: &net.hidden,
                hidden_bias: &net.hidden_bias,
                output: &net.output,
                skip: &net.skip,
                output_bias: &net.output_bias,
            };
            for _ in 0..100 {
                let c = core::array::from_fn(|_| numbers.next(0.5));
                let mut y = [0.0; MAX_OUTPUTS];
                layers.outputs(&c, &mut y[..outputs]);
                assert_eq!(net.forces(&c)[..], y[..outputs], "{hidden} {outputs} {skip}");
            }
        }
    }

    #[test]
    fn sixteen_units_are_good_to_a_millionth() {
        let mut numbers = Numbers(7);
        let wide = |x: f32| f64::from(x);
        let mut worst = 0.0f64;
        for _ in 0..100 {
            let net = numbers.net(16, 3, false);
            let c: [f32; TAXELS] = core::array::from_fn(|_| numbers.next(0.5));
            let unit = |(row, bias): (&[f32], &f32)| {
                let sum = row.iter().zip(&c).fold(wide(*bias), |s, (w, x)| s + wide(*w) * wide(*x));
                sum.tanh()
            };
            let units: std::vec::Vec<f64> =
                net.hidden.chunks(TAXELS).zip(&net.hidden_bias).map(unit).collect();
            for ((y, row), bias) in
                net.forces(&c).iter().zip(net.output.chunks(16)).zip(&net.output_bias)
            {
                let exact = row.iter().zip(&units).fold(wide(*bias), |s, (v, h)| s + wide(*v) * h);
                worst = worst.max((wide(*y) - exact).abs());
            }
        }
        assert!(worst < 1e-6, "{worst:e}");
    }
}
