//! Fields of each section: their members in the order of a record, and their checks.
//!
//! Comparisons with a NaN are false, so that every check rejects NaN.

use core::slice::from_mut;

use heapless::VecView;
use serde::Deserialize;

use super::section::{Checks, Coefficients, Part, bounded};
use super::{Range, SensorCalibration, TaxelCalibration};
use crate::condition::{
    Bias, DriftCompensation, LagCompensation, NOISE_LIMIT, TemperatureCompensation,
};
use crate::estimate::array::{Array, WrenchMethod};
use crate::estimate::field::TERMS;
use crate::estimate::intrinsic::Surface;
use crate::estimate::inverse::{Centres, Inverse};
use crate::estimate::net::{ForceNet, HUGE};
use crate::estimate::quantised::{Group, QuantisedNet, Rows};
use crate::estimate::slip::Slip;
use crate::estimate::wrench::{SensorPlaces, WrenchMatrix};
use crate::scan::TAXELS;

/// Largest sensitivity in newtons per full scale, far beyond the range of any sensor.
const MOST_SENSITIVE: f32 = 1e6;
/// Farthest position of a force sensor in mm.
const FARTHEST: f32 = 1e3;
/// Farthest centre of a facet in mm.
const FARTHEST_FACET: f32 = 10.0;
/// Largest end of a signal's range, as a fraction of full scale. Signals stay within 100, even of
/// a bridge with the largest offset per temperature.
const WIDEST: f32 = 100.0;

/// Implements [`Coefficients`] for a section whose fields have a fixed size.
///
/// Each line is a field: its name in files and messages, its members in the struct, and its check.
/// Members are read one after the other, as postcard writes the struct. Names are numbered from 0
/// on the wire: append only.
macro_rules! section {
    ($type:ty $(, needs_taxels: $needs:literal)? {
        $($name:literal: $($($place:tt).+),+ => |$($value:ident),+| $check:expr;)+
    }) => {
        impl Coefficients for $type {
            const CHECKS: Checks<Self> = &[$(($name, |section| {
                let ($($value,)+) = ($(&section.$($place).+,)+);
                $check
            })),+];
            $(const NEEDS_TAXELS: bool = $needs;)?

            fn read(&mut self, bytes: &[u8]) -> Option<()> {
                $($(let bytes = self.$($place).+.read(bytes)?;)+)+
                bytes.is_empty().then_some(())
            }
        }
    };
}

section! { TaxelCalibration {
    "bias": bias.level => |level| levels_fit(level);
    "noise": bias.noise => |noise| noise_fits(noise);
    "range": range => |range| ranges_fit(range);
    "residual_n": residual => |residual| residuals_fit(residual);
}}

section! { SensorCalibration {
    "bias": bias.level => |level| levels_fit(level);
    "noise": bias.noise => |noise| noise_fits(noise);
    "sensitivity": sensitivity.0 => |rows| bounded(rows.as_flattened(), MOST_SENSITIVE);
    "range": range => |range| ranges_fit(range);
    "residual_n": residual => |residual| residuals_fit(residual);
}}

section! { Inverse, needs_taxels: true {
    "stray": curves.stray => |stray| stray.as_flattened().iter().all(|share| share.abs() < 1.0);
    "gap": curves.gap => |gap| bounded(gap.as_flattened(), HUGE);
    "normal": field.normal.depth, field.normal.terms => |depth, terms| radial_fits(depth, terms);
    "shear": field.shear.depth, field.shear.terms => |depth, terms| radial_fits(depth, terms);
    "slip": field.slip => |slip| slip.abs() <= 1.0;
    "error": error => |error| (1e-9..1.0).contains(&error[0]) && (0.0..1.0).contains(&error[1]);
    "friction": shear, friction => |_shear, friction| (0.01..10.0).contains(friction);
    "centres": centres => |centres| bounded(centres.0.as_flattened(), FARTHEST_FACET);
}}

section! { Slip {
    "usual": usual => |usual| (0.05..=2.0).contains(&usual[0]) && (0.0..=20.0).contains(&usual[1]);
    "radius": surface.radius => |a| (1e-3..1e3).contains(&a[0]) && (0.0..=1.0).contains(&a[1]);
    "torque": surface.torque => |torque| (1e-3..=1.0).contains(torque);
    "curve": surface.curve => |curve| curve.iter().all(|bulge| (0.5..=1.5).contains(bulge));
    "warn": warn => |warn| (0.0..=1.0).contains(warn);
    "safety": safety => |safety| (1.0..=100.0).contains(safety);
}}

section! { TemperatureCompensation {
    "reference": reference => |level| (0.0..=1.0).contains(level);
    "range": range => |range| ranges_fit(&[*range]);
    "light, sensitivity": light, sensitivity => |light, bridges| TemperatureCompensation::shares_fit(&[*light, *bridges]);
    "offset": offset => |offset| offset.as_flattened().iter().all(|offset| offset.abs() <= 1e3);
}}

section! { LagCompensation {
    "taxels": taxels => |lag| LagCompensation::fits(*lag);
    "sensors": sensors => |lag| LagCompensation::fits(*lag);
}}

section! { DriftCompensation {
    "most": most => |most| DriftCompensation { most: *most }.fits();
}}

section! { Array {
    "method": method => |method| match method {
        WrenchMethod::Sum(places) => bounded(places.0.as_flattened(), FARTHEST),
        WrenchMethod::Matrix(matrix) => {
            bounded(matrix.0.as_flattened().as_flattened(), MOST_SENSITIVE * FARTHEST)
        }
    };
    "residual": residual => |residual| residual.iter().all(|sigma| (1e-9..1e3).contains(sigma));
    "moment_residual": moment_residual => |sigma| (1e-9..1e3).contains(sigma);
    "surface": surface => |surface| surface.fits();
}}

impl Coefficients for ForceNet {
    const CHECKS: Checks<Self> =
        &[("hidden", Self::hidden_fits), ("output", Self::output_fits), ("skip", Self::skip_fits)];
    const NEEDS_TAXELS: bool = true;

    fn read(&mut self, bytes: &[u8]) -> Option<()> {
        let (mut lists, mut rest) = ([[].as_slice(); 5], bytes);
        for list in &mut lists {
            (*list, rest) = split_list(rest)?;
        }
        self.fill(lists, f32::from_le_bytes).ok()?;
        rest.is_empty().then_some(())
    }
}

impl Coefficients for QuantisedNet {
    const CHECKS: Checks<Self> = &[
        ("signal", Self::signal_fits),
        ("hidden", Self::hidden_fits),
        ("shift", Self::shift_fits),
        ("output", Self::output_fits),
        ("skip", Self::skip_fits),
        ("scale", Self::scale_fits),
    ];
    const NEEDS_TAXELS: bool = true;

    fn read(&mut self, bytes: &[u8]) -> Option<()> {
        let ((signal, groups), mut rest) = postcard::take_from_bytes::<(f32, u8)>(bytes).ok()?;
        self.signal = signal;
        self.hidden.clear();
        for _ in 0..groups {
            let mut group = Group::default();
            (group.weights, rest) = read_rows(rest)?;
            for bias in &mut group.bias {
                let (bytes, tail) = rest.split_first_chunk()?;
                (*bias, rest) = (i32::from_le_bytes(*bytes), tail);
            }
            self.hidden.push(group).ok()?;
        }
        let ((shift, blocks), mut rest) = postcard::take_from_bytes::<(u8, u8)>(rest).ok()?;
        self.shift = shift;
        self.output.clear();
        for _ in 0..blocks {
            let rows;
            (rows, rest) = read_rows(rest)?;
            self.output.push(rows).ok()?;
        }
        let (skip, mut rest) = postcard::take_from_bytes::<bool>(rest).ok()?;
        self.skip = None;
        if skip {
            let rows;
            (rows, rest) = read_rows(rest)?;
            self.skip = Some(rows);
        }
        let rest = self.scale.read(rest)?;
        read_list(&mut self.output_bias, rest)?.is_empty().then_some(())
    }
}

/// Reads one of postcard's lists in place and returns the rest.
#[inline(never)]
fn read_list<'b>(list: &mut VecView<f32>, bytes: &'b [u8]) -> Option<&'b [u8]> {
    let (weights, rest) = split_list(bytes)?;
    list.clear();
    for weight in weights {
        list.push(f32::from_le_bytes(*weight)).ok()?;
    }
    Some(rest)
}

/// Splits a counted list of numbers from the front of `bytes` and returns both parts.
#[inline(never)]
fn split_list(bytes: &[u8]) -> Option<(&[[u8; 4]], &[u8])> {
    let (length, rest) = postcard::take_from_bytes::<u32>(bytes).ok()?;
    let (numbers, rest) = rest.split_at_checked(usize::try_from(length).ok()?.checked_mul(4)?)?;
    Some((numbers.as_chunks::<4>().0, rest))
}

/// Reads rows of weights from the front of `bytes` and returns them with the rest.
fn read_rows<const N: usize>(bytes: &[u8]) -> Option<(Rows<N>, &[u8])> {
    let mut rows = [[0; TAXELS]; N];
    let weights = rows.as_flattened_mut();
    let (own, rest) = bytes.split_at_checked(2 * weights.len())?;
    for (weight, bytes) in weights.iter_mut().zip(own.as_chunks::<2>().0) {
        *weight = i16::from_le_bytes(*bytes);
    }
    Some((Rows::new(&rows), rest))
}

/// Fills `numbers` from the front of `bytes` and returns the rest.
#[inline(never)]
fn read_numbers<'b>(numbers: &mut [f32], bytes: &'b [u8]) -> Option<&'b [u8]> {
    let (own, rest) = bytes.split_at_checked(4 * numbers.len())?;
    for (number, bytes) in numbers.iter_mut().zip(own.as_chunks::<4>().0) {
        *number = f32::from_le_bytes(*bytes);
    }
    Some(rest)
}

impl Part for f32 {
    fn read<'b>(&mut self, bytes: &'b [u8]) -> Option<&'b [u8]> {
        read_numbers(from_mut(self), bytes)
    }
}

impl<const N: usize> Part for [f32; N] {
    fn read<'b>(&mut self, bytes: &'b [u8]) -> Option<&'b [u8]> {
        read_numbers(self, bytes)
    }
}

impl<const N: usize, const M: usize> Part for [[f32; N]; M] {
    fn read<'b>(&mut self, bytes: &'b [u8]) -> Option<&'b [u8]> {
        read_numbers(self.as_flattened_mut(), bytes)
    }
}

/// A record without centres has the drawing's.
impl Part for Centres {
    fn read<'b>(&mut self, bytes: &'b [u8]) -> Option<&'b [u8]> {
        if bytes.is_empty() {
            *self = Self::default();
            return Some(bytes);
        }
        self.0.read(bytes)
    }
}

impl Part for bool {
    fn read<'b>(&mut self, bytes: &'b [u8]) -> Option<&'b [u8]> {
        read_value(self, bytes)
    }
}

impl Part for Surface {
    fn read<'b>(&mut self, bytes: &'b [u8]) -> Option<&'b [u8]> {
        read_value(self, bytes)
    }
}

impl Part for WrenchMethod {
    fn read<'b>(&mut self, bytes: &'b [u8]) -> Option<&'b [u8]> {
        let (method, bytes) = bytes.split_first()?;
        match method {
            0 => {
                let mut places = SensorPlaces::default();
                let rest = places.0.read(bytes)?;
                *self = Self::Sum(places);
                Some(rest)
            }
            1 => {
                let mut matrix = WrenchMatrix::default();
                let rest = read_numbers(matrix.0.as_flattened_mut().as_flattened_mut(), bytes)?;
                *self = Self::Matrix(matrix);
                Some(rest)
            }
            _ => None,
        }
    }
}

/// Reads one small value from the front of `bytes` and returns the rest.
fn read_value<'b, T: Deserialize<'b>>(value: &mut T, bytes: &'b [u8]) -> Option<&'b [u8]> {
    let rest;
    (*value, rest) = postcard::take_from_bytes(bytes).ok()?;
    Some(rest)
}

fn radial_fits(depth: &[f32; 2], terms: &[[f32; 3]; TERMS]) -> bool {
    bounded(depth, HUGE) && bounded(terms.as_flattened(), HUGE)
}

/// Checks a bias that does not come from a record, as one within a record is checked.
#[must_use]
pub fn bias_fits(bias: &Bias) -> bool {
    bias.taxels.is_none_or(|taxels| levels_fit(&taxels.level) && noise_fits(&taxels.noise))
        && bias.bridges.iter().flatten().all(|b| levels_fit(&b.level) && noise_fits(&b.noise))
}

/// Checks the range of levels, −2 to 2: fractions of full scale, and their sums and differences.
fn levels_fit(levels: &[f32]) -> bool {
    bounded(levels, 2.0)
}

fn noise_fits(noise: &f32) -> bool {
    (1e-9..=NOISE_LIMIT).contains(noise)
}

#[inline(never)]
fn ranges_fit(ranges: &[Range]) -> bool {
    ranges.iter().all(|[low, high]| low < high) && bounded(ranges.as_flattened(), WIDEST)
}

fn residuals_fit(residuals: &[f32]) -> bool {
    residuals.iter().all(|residual| (0.0..1e3).contains(residual))
}
