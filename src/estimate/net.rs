//! Feed-forward net of [DeMaria2011] with a linear skip path.
//!
//! The net has one hidden layer of tanh units and a linear output.

use heapless::Vec;
use serde::ser::SerializeSeq;
use serde::{Serialize, Serializer};

use super::tanh::{tanh, tanh_of_finite};
use crate::scan::TAXELS;

/// Largest number of hidden units in a record. [DeMaria2011] uses 12 (normal only) and 16 (three
/// components).
pub const MAX_HIDDEN: usize = 32;
/// Largest number of outputs: f_x, f_y, f_z.
pub const MAX_OUTPUTS: usize = 3;

/// Upper limit of a coefficient without one of its own. A taxel that sees a hundredth of full scale
/// per newton needs 1e8 in the fifth power of its curve.
pub(crate) const HUGE: f32 = 1e9;

/// Net y = V·tanh(W·x + a) + L·x + b, with weights as flat row-major slices.
///
/// The tanh units add curvature to the linear skip path L. Without L (empty) this is the net of
/// [DeMaria2011]; without units it is linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layers<'w> {
    /// W: one row per unit, one weight per input.
    pub hidden: &'w [f32],
    /// a: one element per unit.
    pub hidden_bias: &'w [f32],
    /// V: one row per output, one weight per unit.
    pub output: &'w [f32],
    /// L: one row per output, one weight per input; or empty.
    pub skip: &'w [f32],
    /// b: one element per output.
    pub output_bias: &'w [f32],
}

impl Layers<'_> {
    /// Computes the outputs `y` for the inputs `x`.
    ///
    /// If lengths do not match, the shortest wins, and nothing panics. Shapes are validated when a
    /// record is read, not here. The summation order is fixed, so that the bits are the same
    /// everywhere.
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

/// Returns bias + row·x.
#[inline]
fn dot(row: &[f32], x: &[f32], bias: f32) -> f32 {
    row.iter().zip(x).fold(bias, |sum, (w, x)| sum + w * x)
}

/// Returns bias + row·x of sixteen terms, in the order of [`dot`].
///
/// Written out, because a compiler that saves flash does not unroll the loop, which then takes half
/// as long again.
#[inline(always)]
fn dot_16(w: &[f32; TAXELS], x: &[f32; TAXELS], bias: f32) -> f32 {
    let [w0, w1, w2, w3, w4, w5, w6, w7, w8, w9, wa, wb, wc, wd, we, wf] = *w;
    let [x0, x1, x2, x3, x4, x5, x6, x7, x8, x9, xa, xb, xc, xd, xe, xf] = *x;
    let sum = bias + w0 * x0 + w1 * x1 + w2 * x2 + w3 * x3 + w4 * x4 + w5 * x5;
    let sum = sum + w6 * x6 + w7 * x7 + w8 * x8 + w9 * x9 + wa * xa + wb * xb;
    sum + wc * xc + wd * xd + we * xe + wf * xf
}

/// One hidden unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Unit {
    /// The unit's row of W.
    pub weights: [f32; TAXELS],
    /// The unit's element of a.
    pub bias: f32,
    /// The unit's column of V. A net with one output has it last, in the place of f_z.
    pub output: [f32; MAX_OUTPUTS],
}

/// Force net of one finger.
///
/// Inputs are 16 signals c_k; outputs are one (f_z) or three (f_x, f_y, f_z) forces in newtons.
///
/// Input and output scaling are folded into the weights. See [`Layers`]. All weights of a unit are
/// adjacent in memory, so that one address serves them and loads are sequential.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ForceNet {
    /// W, a and V.
    pub units: Vec<Unit, MAX_HIDDEN>,
    /// L, if there is a skip path; a net with one output uses the last row.
    pub skip: Option<[[f32; TAXELS]; MAX_OUTPUTS]>,
    /// b: one element per output, either one (f_z) or three (f_x, f_y, f_z).
    pub output_bias: Vec<f32, MAX_OUTPUTS>,
}

impl ForceNet {
    /// Makes a net of `layers`.
    ///
    /// # Errors
    /// The field of [`Layers`] whose length does not match 16 signals, one or three outputs, or the
    /// other fields.
    pub fn new(layers: &Layers<'_>) -> Result<Self, &'static str> {
        let Layers { hidden, hidden_bias, output, skip, output_bias } = *layers;
        let mut net = Self::default();
        net.fill([hidden, hidden_bias, output, skip, output_bias], |weight| weight)?;
        Ok(net)
    }

    /// Fills the net from the fields of [`Layers`] in their order. `number` converts an element to
    /// f32.
    pub(crate) fn fill<W: Copy>(
        &mut self,
        [hidden, hidden_bias, output, skip, output_bias]: [&[W]; 5],
        number: fn(W) -> f32,
    ) -> Result<(), &'static str> {
        let (rows, rest) = hidden.as_chunks::<TAXELS>();
        if !rest.is_empty() || rows.len() != hidden_bias.len() {
            return Err("hidden");
        }
        let outputs = output_bias.len();
        if !matches!(outputs, 1 | MAX_OUTPUTS) || output.len() != outputs * rows.len() {
            return Err("output");
        }
        let (straight, rest) = skip.as_chunks::<TAXELS>();
        if !rest.is_empty() || !(straight.is_empty() || straight.len() == outputs) {
            return Err("skip");
        }
        self.units.clear();
        for (j, (row, bias)) in rows.iter().zip(hidden_bias).enumerate() {
            let mut unit =
                Unit { weights: row.map(number), bias: number(*bias), ..Unit::default() };
            let column = output.iter().skip(j).step_by(rows.len());
            for (v, weight) in unit.output.iter_mut().skip(MAX_OUTPUTS - outputs).zip(column) {
                *v = number(*weight);
            }
            self.units.push(unit).map_err(|_| "hidden")?;
        }
        self.skip = (!straight.is_empty()).then_some([[0.0; TAXELS]; MAX_OUTPUTS]);
        let rows =
            self.skip.iter_mut().flat_map(|rows| rows.iter_mut().skip(MAX_OUTPUTS - outputs));
        for (row, weights) in rows.zip(straight) {
            *row = weights.map(number);
        }
        self.output_bias.clear();
        for bias in output_bias {
            self.output_bias.push(number(*bias)).map_err(|_| "output")?;
        }
        Ok(())
    }

    /// Returns W row by row, one row of 16 per unit.
    pub fn hidden(&self) -> impl Iterator<Item = f32> + Clone {
        self.units.iter().flat_map(|unit| unit.weights)
    }

    /// Returns a, one element per unit.
    pub fn hidden_bias(&self) -> impl Iterator<Item = f32> + Clone {
        self.units.iter().map(|unit| unit.bias)
    }

    /// Returns V row by row, one row per output.
    pub fn output(&self) -> impl Iterator<Item = f32> + Clone {
        let first = MAX_OUTPUTS - self.output_bias.len();
        let row = |k: usize| self.units.iter().filter_map(move |unit| unit.output.get(k).copied());
        (first..MAX_OUTPUTS).flat_map(row)
    }

    /// Returns L row by row, one row of 16 per output; empty without a skip path.
    pub fn straight(&self) -> &[f32] {
        let first = MAX_OUTPUTS - self.output_bias.len();
        self.skip.as_ref().and_then(|rows| rows.get(first..)).unwrap_or_default().as_flattened()
    }

    /// Checks that the net has units or a skip path and that the units' weights are finite. Without
    /// both the output would be constant.
    pub(crate) fn hidden_fits(&self) -> bool {
        !(self.units.is_empty() && self.skip.is_none())
            && self.hidden().chain(self.hidden_bias()).all(|w| w.abs() < HUGE)
    }

    /// Checks that there are one or three outputs with finite weights.
    pub(crate) fn output_fits(&self) -> bool {
        matches!(self.output_bias.len(), 1 | MAX_OUTPUTS)
            && self.output().chain(self.output_bias.iter().copied()).all(|w| w.abs() < HUGE)
    }

    /// Checks that the skip path, if any, is finite.
    pub(crate) fn skip_fits(&self) -> bool {
        self.skip.iter().flatten().flatten().all(|w| w.abs() < HUGE)
    }

    /// Returns forces in newtons: `[f_z]` or `[f_x, f_y, f_z]`.
    ///
    /// The bits are those of [`Layers::outputs`]. This path is faster, because signals and sums
    /// stay in registers.
    #[must_use]
    pub fn forces(&self, c: &[f32; TAXELS]) -> Vec<f32, MAX_OUTPUTS> {
        let mut sums = match self.output_bias[..] {
            [z] => [0.0, 0.0, z],
            [x, y, z] => [x, y, z],
            _ => return Vec::new(),
        };
        if let Some([l, m, n]) = &self.skip {
            let [x, y, z] = sums;
            sums = [dot_16(l, c, x), dot_16(m, c, y), dot_16(n, c, z)];
        }
        let (pairs, odd) = self.units.as_chunks::<2>();
        // An odd unit is paired with a unit of zero weights.
        let last = odd.first().map(|unit| [*unit, Unit::default()]);
        let (mut pairs, mut last) = (pairs.iter(), last.iter());
        while let Some([one, other]) = pairs.next().or_else(|| last.next()) {
            let arguments = [one, other].map(|unit| dot_16(&unit.weights, c, unit.bias));
            let [first, second] = tanh_of_finite(arguments);
            sums = other.add(second, one.add(first, sums));
        }
        match self.output_bias.len() {
            1 => Vec::from_array([sums[2]]),
            _ => Vec::from_array(sums),
        }
    }
}

impl Unit {
    /// Returns sums + V·activation.
    #[inline(always)]
    fn add(&self, activation: f32, [x, y, z]: [f32; MAX_OUTPUTS]) -> [f32; MAX_OUTPUTS] {
        let [u, v, w] = self.output;
        [x + activation * u, y + activation * v, z + activation * w]
    }
}

/// Serializes the net as a record holds it: the lists of [`Layers`].
impl Serialize for ForceNet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { units, output_bias, .. } = self;
        let hidden = List(units.len() * TAXELS, self.hidden());
        let hidden_bias = List(units.len(), self.hidden_bias());
        let output = List(units.len() * output_bias.len(), self.output());
        (hidden, hidden_bias, output, self.straight(), output_bias).serialize(serializer)
    }
}

/// A sequence of a known number of numbers.
struct List<I>(usize, I);

impl<I: Iterator<Item = f32> + Clone> Serialize for List<I> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(Some(self.0))?;
        self.1.clone().try_for_each(|number| list.serialize_element(&number))?;
        list.end()
    }
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
    fn outputs_match_the_formula() {
        let h0 = (0.1f64 + 0.5 - 0.5).tanh();
        let h1 = (-0.2f64 - 0.5 - 0.125).tanh();
        let bent = 0.7 + 2.0 * h0 - 3.0 * h1;
        assert!((output(NET) - bent).abs() < 1e-6);
        let skip: &[f32] = &[1.0, 8.0];
        assert!((output(Layers { skip, ..NET }) - (bent + 0.5 - 2.0)).abs() < 1e-6);
    }

    #[test]
    fn net_without_units_is_linear() {
        let bare = Layers { hidden: &[], hidden_bias: &[], output: &[], ..NET };
        assert!((output(Layers { skip: &[1.0, 8.0], ..bare }) - (0.7 + 0.5 - 2.0)).abs() < 1e-6);
        assert!((output(bare) - 0.7).abs() < 1e-6);
    }

    /// Pseudo-random numbers in [−scale, scale).
    pub(in crate::estimate) struct Numbers(pub u32);

    impl Numbers {
        pub fn next(&mut self, scale: f32) -> f32 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (self.0 as f32 / (1u64 << 31) as f32 - 1.0) * scale
        }

        pub fn net(&mut self, hidden: usize, outputs: usize, skip: bool) -> ForceNet {
            self.both(hidden, outputs, skip).1
        }

        /// Returns the lists of a net, and the net.
        fn both(&mut self, hidden: usize, outputs: usize, skip: bool) -> ([List; 5], ForceNet) {
            let mut list = |count: usize, scale| (0..count).map(|_| self.next(scale)).collect();
            let lists: [List; 5] = [
                list(hidden * TAXELS, 1.0),
                list(hidden, 0.5),
                list(hidden * outputs, 0.5),
                list(usize::from(skip) * outputs * TAXELS, 1.0),
                list(outputs, 0.1),
            ];
            let net = ForceNet::new(&layers(&lists)).unwrap();
            (lists, net)
        }
    }

    type List = std::vec::Vec<f32>;

    fn layers([hidden, hidden_bias, output, skip, output_bias]: &[List; 5]) -> Layers<'_> {
        Layers { hidden, hidden_bias, output, skip, output_bias }
    }

    #[test]
    fn force_net_equals_layers_bit_for_bit() {
        let mut numbers = Numbers(1);
        for (hidden, outputs, skip) in
            [(16, 3, false), (7, 3, true), (12, 1, false), (5, 1, true), (0, 3, true), (0, 1, true)]
        {
            let (lists, net) = numbers.both(hidden, outputs, skip);
            assert!(net.hidden_fits() && net.output_fits() && net.skip_fits());
            for _ in 0..100 {
                let c = core::array::from_fn(|_| numbers.next(0.5));
                let mut y = [0.0; MAX_OUTPUTS];
                layers(&lists).outputs(&c, &mut y[..outputs]);
                assert_eq!(net.forces(&c)[..], y[..outputs], "{hidden} {outputs} {skip}");
            }
        }
    }

    #[test]
    fn force_net_returns_its_lists() {
        for outputs in [1, 3] {
            let (lists, net) = Numbers(3).both(5, outputs, true);
            let [hidden, hidden_bias, output, skip, output_bias] = &lists;
            assert!(net.hidden().eq(hidden.iter().copied()));
            assert!(net.hidden_bias().eq(hidden_bias.iter().copied()));
            assert!(net.output().eq(output.iter().copied()));
            assert_eq!(net.straight(), skip);
            assert_eq!(net.output_bias[..], output_bias[..]);
        }
    }

    #[test]
    fn lists_of_wrong_length_are_refused() {
        let refused = |list: usize, length: usize| {
            let (mut lists, _) = Numbers(3).both(5, 3, true);
            lists[list].resize(length, 0.0);
            ForceNet::new(&layers(&lists)).unwrap_err()
        };
        for length in [0, 2, 79, 81, 96] {
            assert_eq!(refused(0, length), "hidden");
        }
        assert_eq!(refused(1, 4), "hidden");
        assert_eq!(refused(2, 16), "output");
        assert_eq!([refused(4, 0), refused(4, 2)], ["output"; 2]);
        assert_eq!([refused(3, 16), refused(3, 47), refused(3, 64)], ["skip"; 3]);
        let wide =
            [33 * 16, 33, 33, 0, 1].map(|count| List::from_iter(core::iter::repeat_n(0.0, count)));
        assert_eq!(ForceNet::new(&layers(&wide)), Err("hidden"));
    }

    #[test]
    fn sixteen_units_are_exact_to_a_millionth() {
        let mut numbers = Numbers(7);
        let wide = |x: f32| f64::from(x);
        let mut worst = 0.0f64;
        for _ in 0..100 {
            let net = numbers.net(16, 3, false);
            let c: [f32; TAXELS] = core::array::from_fn(|_| numbers.next(0.5));
            let mut exact =
                net.output_bias.iter().map(|bias| wide(*bias)).collect::<std::vec::Vec<_>>();
            for Unit { weights, bias, output } in &net.units {
                let terms = weights.iter().zip(&c).map(|(w, x)| wide(*w) * wide(*x));
                let h = (wide(*bias) + terms.sum::<f64>()).tanh();
                exact.iter_mut().zip(output).for_each(|(y, v)| *y += wide(*v) * h);
            }
            for (y, exact) in net.forces(&c).iter().zip(exact) {
                worst = worst.max((wide(*y) - exact).abs());
            }
        }
        assert!(worst < 1e-6, "{worst:e}");
    }
}
