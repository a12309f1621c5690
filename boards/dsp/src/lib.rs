//! Steps of a net in 16-bit integers, and the square root, in Cortex-M4 instructions.
//!
//! These are two products in one SMLAD, a conversion that clips, tanh from a table, and VSQRT. Each
//! step exists twice: in `instructions.rs` with these instructions, in `portable.rs` for any other
//! processor. Both give the same bits: `cargo xtask cycles` compares them on an emulated core for
//! ten thousand inputs. A word holds two numbers, the first in its lower half.
#![no_std]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing
    )
)]

#[cfg(dsp)]
mod instructions;
#[cfg(not(dsp))]
mod portable;
mod tanh;

#[cfg(dsp)]
pub use instructions::{activations, narrowed, sqrt, sums_of_outputs};
#[cfg(not(dsp))]
pub use portable::{activations, narrowed, sqrt, sums_of_outputs};

/// Number of weights in a row.
pub const COLUMNS: usize = 16;
/// Number of hidden units that are computed at once.
pub const GROUP: usize = 4;
/// Number of rows in the last layer.
pub const OUTPUTS: usize = 3;

/// Sixteen signals or activations, four in two words.
pub type Lanes = [[u32; 2]; COLUMNS / 4];

/// N rows of sixteen weights in the order of the sums.
///
/// Four columns of each row come first, then the next four.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct Rows<const N: usize>([[[u32; 2]; N]; COLUMNS / 4]);

impl<const N: usize> Rows<N> {
    /// Packs weights that are given row by row.
    #[must_use]
    pub fn new(weights: &[[i16; COLUMNS]; N]) -> Self {
        Self(transposed(&weights.map(|row| lanes(&row))))
    }

    /// Weights, row by row.
    #[must_use]
    pub fn weights(&self) -> [[i16; COLUMNS]; N] {
        transposed(&self.0).map(|lanes| numbers(&lanes))
    }
}

impl<const N: usize> Default for Rows<N> {
    fn default() -> Self {
        Self([[[0; 2]; N]; COLUMNS / 4])
    }
}

/// Weights of four hidden units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Group {
    /// Bias a, with the rounding of the shift.
    pub bias: [i32; GROUP],
    /// Weights W.
    pub weights: Rows<GROUP>,
}

/// Inputs of the hidden units.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub struct Input {
    /// Signals x.
    pub x: Lanes,
    /// Right shift from a sum to the argument of tanh, bits: less than 32.
    pub shift: u32,
}

#[inline(always)]
fn word([low, high]: [i16; 2]) -> u32 {
    u32::from(low as u16) | u32::from(high as u16) << 16
}

fn lanes(numbers: &[i16; COLUMNS]) -> Lanes {
    let mut lanes = Lanes::default();
    for (lanes, [a, b, c, d]) in lanes.iter_mut().zip(numbers.as_chunks::<4>().0) {
        *lanes = [word([*a, *b]), word([*c, *d])];
    }
    lanes
}

fn numbers(lanes: &Lanes) -> [i16; COLUMNS] {
    let mut numbers = [0; COLUMNS];
    for ([low, high], word) in numbers.as_chunks_mut::<2>().0.iter_mut().zip(lanes.as_flattened()) {
        (*low, *high) = (*word as i16, (*word >> 16) as i16);
    }
    numbers
}

fn transposed<T: Copy + Default, const A: usize, const B: usize>(
    rows: &[[T; A]; B],
) -> [[T; B]; A] {
    core::array::from_fn(|i| rows.map(|row| row.get(i).copied().unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_return_their_weights() {
        let row = |first: i16| core::array::from_fn(|i| first - 3 * i as i16);
        let weights = [0, 100, 200].map(row);
        assert_eq!(Rows::new(&weights).weights(), weights);
    }
}
