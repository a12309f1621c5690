//! Force net in 16-bit fixed point: half the time of a wide [`ForceNet`].
//!
//! Quantisation costs some ten-thousandths of the output (asserted below). With fewer than four
//! hidden units the net is not faster.
//!
//! Signals, weights and activations have 16 bits, sums 32. Each layer has one scale, the finest at
//! which no sum of its products can overflow 32 bits for any signals. [`QuantisedNet::hidden_fits`]
//! and its siblings prove that for a record before it is used.
//!
//! Two numbers share a word, so that one instruction of a Cortex-M4 adds two products:
//! [`taxel_dsp`].

use heapless::Vec;
use serde::{Serialize, Serializer};
pub use taxel_dsp::{GROUP, Group, Rows};
use taxel_dsp::{Input, Lanes};

use super::net::{ForceNet, HUGE, MAX_HIDDEN, MAX_OUTPUTS, Unit};
use crate::scan::TAXELS;

const MAX_GROUPS: usize = MAX_HIDDEN / GROUP;
/// Blocks of activations; each has as many as there are taxels.
const BLOCKS: usize = MAX_HIDDEN / TAXELS;

/// Largest signal or activation.
const LARGEST: i32 = i16::MAX as i32;
/// Value of an activation of 1.0.
pub const UNIT: f32 = 32_768.0;
/// Fraction bits of the argument of tanh, which covers [−8, 8).
pub const ARGUMENT_BITS: u8 = 18;
/// Largest shift of a sum, below its width.
const MAX_SHIFT: u8 = 31;

/// A [`ForceNet`] in 16 bits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct QuantisedNet {
    /// Value of a signal of 1.0; the largest signal in training fills 16 bits.
    pub signal: f32,
    /// W and a in groups of units; missing units of the last group are zero.
    pub hidden: Vec<Group, MAX_GROUPS>,
    /// Right shift from a sum of the hidden layer to the argument of tanh, in bits.
    pub shift: u8,
    /// V in blocks of sixteen activations and three rows. A net with one output uses the first row.
    pub output: Vec<Rows<MAX_OUTPUTS>, BLOCKS>,
    /// L, if there is a skip path.
    pub skip: Option<Rows<MAX_OUTPUTS>>,
    /// Newtons per unit of the sums over V, and over L.
    pub scale: [f32; 2],
    /// b: one element per output, either one (f_z) or three (f_x, f_y, f_z).
    pub output_bias: Vec<f32, MAX_OUTPUTS>,
}

impl QuantisedNet {
    /// Quantises `net` for signals up to `largest`.
    ///
    /// Returns `None` if its weights are too large for 16 bits. A single signal would then drive a
    /// unit a thousand times beyond the bend of tanh.
    #[must_use]
    pub fn new(net: &ForceNet, largest: f32) -> Option<Self> {
        let signal = LARGEST as f32 / largest;
        let fits =
            |shift: &u8| net.units.iter().all(|unit| whole_unit(unit, (signal, *shift)).is_some());
        let shift = (0..=MAX_SHIFT - ARGUMENT_BITS).rev().find(fits)?;
        let mut quantised =
            Self { signal, shift, output_bias: net.output_bias.clone(), ..Self::default() };
        for units in net.units.chunks(GROUP) {
            let (mut weights, mut bias) = ([[0; TAXELS]; GROUP], [0; GROUP]);
            for ((row, bias), unit) in weights.iter_mut().zip(&mut bias).zip(units) {
                (*row, *bias) = whole_unit(unit, (signal, shift))?;
            }
            quantised.hidden.push(Group { bias, weights: Rows::new(&weights) }).ok()?;
        }
        // A net with one output has it last in f32, and first here.
        let from = MAX_OUTPUTS - net.output_bias.len();
        let weights =
            |k: usize| net.units.iter().filter_map(move |unit| unit.output.get(from + k).copied());
        let output_one = layer_one((0..MAX_OUTPUTS).map(weights));
        for block in 0..net.units.len().div_ceil(TAXELS) {
            let row = |k: usize| whole(weights(k).skip(block * TAXELS), output_one);
            quantised.output.push(Rows::new(&core::array::from_fn(row))).ok()?;
        }
        let skip =
            |k: usize| net.straight().chunks_exact(TAXELS).nth(k).into_iter().flatten().copied();
        let skip_one = layer_one((0..MAX_OUTPUTS).map(skip));
        if net.skip.is_some() {
            let row = |k| whole(skip(k), skip_one);
            quantised.skip = Some(Rows::new(&core::array::from_fn(row)));
        }
        quantised.scale = [1.0 / (output_one * UNIT), 1.0 / (skip_one * signal)];
        Some(quantised)
    }

    /// Checks the scale of the signals.
    pub(crate) fn signal_fits(&self) -> bool {
        (1.0..1e9).contains(&self.signal)
    }

    /// Checks that there are units or a skip path, and that no sum of a unit can overflow 32 bits.
    pub(crate) fn hidden_fits(&self) -> bool {
        let units = |group: &Group| {
            group.weights.weights().iter().zip(group.bias).all(|(row, bias)| row_fits(row, bias))
        };
        !(self.hidden.is_empty() && self.skip.is_none()) && self.hidden.iter().all(units)
    }

    /// Checks that the shift is less than the width of a sum.
    pub(crate) fn shift_fits(&self) -> bool {
        self.shift <= MAX_SHIFT
    }

    /// Checks the number of outputs and weights, and that no sum can overflow 32 bits. There are
    /// one or three finite outputs and weights for every unit. The two blocks of activations go
    /// into one sum.
    pub(crate) fn output_fits(&self) -> bool {
        let blocks = (self.hidden.len() * GROUP).div_ceil(TAXELS);
        let sum = |rows: &Rows<MAX_OUTPUTS>| rows.weights().map(|row| absolute_sum(&row));
        let sums = |[a, b, c]: [i64; MAX_OUTPUTS], rows| {
            let [p, q, r] = sum(rows);
            [a + p, b + q, c + r]
        };
        matches!(self.output_bias.len(), 1 | MAX_OUTPUTS)
            && self.output.len() == blocks
            && self.output_bias.iter().all(|bias| bias.abs() < HUGE)
            && self.output.iter().fold([0; MAX_OUTPUTS], sums).iter().all(|sum| *sum <= BOUND)
    }

    /// Checks that no sum of the skip path can overflow 32 bits.
    pub(crate) fn skip_fits(&self) -> bool {
        self.skip.iter().flat_map(Rows::weights).all(|row| row_fits(&row, 0))
    }

    /// Checks the scales: a force is 2³¹ times a scale at most.
    pub(crate) fn scale_fits(&self) -> bool {
        self.scale.iter().all(|scale| scale.abs() < HUGE)
    }

    /// Returns forces in newtons: `[f_z]` or `[f_x, f_y, f_z]`. Larger signals are limited to the
    /// largest.
    #[must_use]
    pub fn forces(&self, c: &[f32; TAXELS]) -> Vec<f32, MAX_OUTPUTS> {
        let mut input = Input { x: Lanes::default(), shift: (self.shift & MAX_SHIFT).into() };
        // Loops here are above the compiler's limit for unrolling: unrolled by hand.
        if let ([first, last], [c, d]) = (input.x.as_chunks_mut().0, c.as_chunks().0) {
            *first = taxel_dsp::narrowed(c, self.signal);
            *last = taxel_dsp::narrowed(d, self.signal);
        }
        let mut groups = self.hidden.iter();
        let mut bent = [0; MAX_OUTPUTS];
        for rows in &self.output {
            let mut next = || match groups.next() {
                Some(group) => taxel_dsp::activations(group, &input),
                None => [0; 2],
            };
            let h: Lanes = [next(), next(), next(), next()];
            bent = taxel_dsp::sums_of_outputs(rows, &h, bent);
        }
        let [bend, slope] = self.scale;
        let force = |bias: f32, bent: i32| bias + bent as f32 * bend;
        let [p, q, r] = bent;
        let mut forces = match self.output_bias[..] {
            [z] => Vec::from_array([force(z, p)]),
            [x, y, z] => Vec::from_array([force(x, p), force(y, q), force(z, r)]),
            _ => Vec::new(),
        };
        if let Some(skip) = &self.skip {
            let straight = taxel_dsp::sums_of_outputs(skip, &input.x, [0; MAX_OUTPUTS]);
            for (force, straight) in forces.iter_mut().zip(straight) {
                *force += straight as f32 * slope;
            }
        }
        forces
    }
}

/// Serializes the net as a record holds it: integers in little-endian bytes.
impl Serialize for QuantisedNet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        fn bytes<const N: usize>(rows: &Rows<N>) -> [[[u8; 2]; TAXELS]; N] {
            rows.weights().map(|row| row.map(i16::to_le_bytes))
        }
        let group = |group: &Group| (bytes(&group.weights), group.bias.map(i32::to_le_bytes));
        let hidden: Vec<_, MAX_GROUPS> = self.hidden.iter().map(group).collect();
        let output: Vec<_, BLOCKS> = self.output.iter().map(bytes).collect();
        let skip = self.skip.as_ref().map(bytes);
        (self.signal, hidden, self.shift, output, skip, self.scale, &self.output_bias)
            .serialize(serializer)
    }
}

/// Net of a record, in f32 or in 16 bits.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "quantised",
    expect(
        clippy::large_enum_variant,
        reason = "a record has room for the larger; there is no heap"
    )
)]
pub enum Net {
    /// Net in f32.
    Float(ForceNet),
    /// Net in 16 bits.
    #[cfg(feature = "quantised")]
    Quantised(QuantisedNet),
}

impl Net {
    /// Returns the net if it is in f32.
    #[must_use]
    pub fn float(&self) -> Option<&ForceNet> {
        match self {
            Self::Float(net) => Some(net),
            #[cfg(feature = "quantised")]
            Self::Quantised(_) => None,
        }
    }

    /// Returns the net if it is in 16 bits.
    #[cfg(feature = "quantised")]
    #[must_use]
    pub fn quantised(&self) -> Option<&QuantisedNet> {
        match self {
            Self::Float(_) => None,
            Self::Quantised(net) => Some(net),
        }
    }

    /// Returns the number of outputs: one (f_z) or three.
    #[must_use]
    pub fn outputs(&self) -> usize {
        match self {
            Self::Float(net) => net.output_bias.len(),
            #[cfg(feature = "quantised")]
            Self::Quantised(net) => net.output_bias.len(),
        }
    }

    /// Returns forces in newtons: `[f_z]` or `[f_x, f_y, f_z]`.
    #[must_use]
    pub fn forces(&self, c: &[f32; TAXELS]) -> Vec<f32, MAX_OUTPUTS> {
        match self {
            Self::Float(net) => net.forces(c),
            #[cfg(feature = "quantised")]
            Self::Quantised(net) => net.forces(c),
        }
    }
}

/// Upper limit of the sum of absolute weights in one sum of products.
const BOUND: i64 = (i32::MAX / (LARGEST + 1)) as i64;

fn absolute_sum(row: &[i16; TAXELS]) -> i64 {
    row.iter().map(|w| i64::from(*w).abs()).sum()
}

/// Returns whether bias + row·x stays within 32 bits for every x.
fn row_fits(row: &[i16; TAXELS], bias: i32) -> bool {
    absolute_sum(row) * i64::from(LARGEST + 1) + i64::from(bias).abs() <= i64::from(i32::MAX)
}

/// Returns weights and bias of a unit if they fit 16 and 32 bits.
fn whole_unit(unit: &Unit, (signal, shift): (f32, u8)) -> Option<([i16; TAXELS], i32)> {
    let one = (1u32 << (shift + ARGUMENT_BITS).min(MAX_SHIFT)) as f32;
    let row = whole(unit.weights.into_iter(), one / signal);
    let half = 1i32 << shift.min(MAX_SHIFT) >> 1;
    let bias = ((unit.bias * one) as i32).saturating_add(half);
    let clips = row.iter().any(|w| i32::from(*w).abs() >= LARGEST);
    (!clips && row_fits(&row, bias)).then_some((row, bias))
}

/// Returns the largest scale of a linear layer's weights without overflow. No weight and no sum of
/// products overflows, with half a unit of rounding each.
fn layer_one<R: Iterator<Item = f32>>(rows: impl Iterator<Item = R> + Clone) -> f32 {
    let largest =
        |of: fn(f32, f32) -> f32| rows.clone().map(|row| row.fold(0.0, of)).fold(0.0f32, f32::max);
    let weight = largest(|most, w| most.max(w.abs()));
    let sum = largest(|sum, w| sum + w.abs());
    let of = |most: f32, bits: f32| if most > 0.0 { bits / most } else { f32::MAX };
    let one = of(weight, LARGEST as f32).min(of(sum, BOUND as f32 - MAX_HIDDEN as f32));
    if one < f32::MAX { one } else { 1.0 }
}

/// Returns the weights in units of 1/`one`, rounded; missing ones are zero.
fn whole(weights: impl Iterator<Item = f32>, one: f32) -> [i16; TAXELS] {
    let mut whole = [0; TAXELS];
    for (whole, weight) in whole.iter_mut().zip(weights) {
        let exact = weight * one;
        *whole = (exact + 0.5f32.copysign(exact)) as i16;
    }
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::net::tests::Numbers;

    /// Weights typical of fits: units that bend within the signals, forces of a newton.
    fn nets() -> impl Iterator<Item = (ForceNet, Numbers)> {
        let shapes = [(16, 3, false), (6, 3, true), (12, 1, false), (32, 3, true), (0, 3, true)];
        (0..200).map(move |seed| {
            let mut numbers = Numbers(seed + 1);
            let (hidden, outputs, skip) = shapes[seed as usize % shapes.len()];
            let mut net = numbers.net(hidden, outputs, skip);
            net.units.iter_mut().for_each(|unit| unit.weights = unit.weights.map(|w| w * 6.0));
            (net, numbers)
        })
    }

    /// Largest absolute value of output `k` of a net, without its bias.
    fn most(net: &ForceNet, k: usize) -> f32 {
        let from = MAX_OUTPUTS - net.output_bias.len();
        let bent: f32 = net.units.iter().map(|unit| unit.output[from + k].abs()).sum();
        let straight = net.straight().chunks(TAXELS).nth(k).unwrap_or_default();
        bent + straight.iter().map(|w| w.abs()).sum::<f32>()
    }

    #[test]
    fn forces_match_f32_to_a_thousandth_of_range() {
        let (mut worst, mut squares, mut count) = (0.0f32, 0.0, 0);
        for (net, mut numbers) in nets() {
            let quantised = QuantisedNet::new(&net, 0.5).unwrap();
            assert!(quantised.hidden_fits() && quantised.output_fits() && quantised.skip_fits());
            for _ in 0..50 {
                let c = core::array::from_fn(|_| numbers.next(0.5));
                let (found, exact) = (quantised.forces(&c), net.forces(&c));
                assert_eq!(found.len(), exact.len());
                for (k, (found, exact)) in found.iter().zip(exact).enumerate() {
                    let error = (found - exact).abs() / most(&net, k);
                    worst = worst.max(error);
                    squares += f64::from(error).powi(2);
                    count += 1;
                }
            }
        }
        let rms = (squares / f64::from(count)).sqrt();
        assert!(worst < 6e-4 && rms < 6e-5, "{worst:e} {rms:e}");
    }

    #[test]
    fn signals_beyond_the_largest_do_not_overflow() {
        for (net, mut numbers) in nets() {
            let quantised = QuantisedNet::new(&net, 0.5).unwrap();
            for scale in [0.6, 3.0, 1e6, 1e30] {
                let c: [f32; TAXELS] = core::array::from_fn(|_| numbers.next(scale));
                let clipped = quantised.forces(&c.map(|c| c.clamp(-0.500_02, 0.5)));
                assert_eq!(quantised.forces(&c), clipped);
                for (k, y) in clipped.iter().enumerate() {
                    assert!((y - net.output_bias[k]).abs() <= most(&net, k) * 1.001, "{y}");
                }
            }
        }
    }

    #[test]
    fn weights_beyond_sixteen_bits_are_refused() {
        let mut net = Numbers(1).net(4, 3, false);
        net.units[0].weights[5] = 1e9;
        assert_eq!(QuantisedNet::new(&net, 0.5), None);
    }
}
