//! What must hold for the fields of each section.
//!
//! Comparisons with a NaN are false, so each of these refuses NaN without naming it.

use core::slice::from_mut;

#[cfg(feature = "quantised")]
use heapless::VecView;

use super::section::{Checks, Coefficients, HUGE, finite};
use super::{Range, SensorCalibration, TaxelCalibration};
use crate::condition::{Bias, Warmth};
use crate::estimate::array::{Array, WrenchMethod};
use crate::estimate::field::{Field, Radial};
use crate::estimate::inverse::{Curves, Inverse};
use crate::estimate::limit_surface::LimitSurface;
use crate::estimate::net::ForceNet;
#[cfg(feature = "quantised")]
use crate::estimate::quantised::{Group, QuantisedNet, Rows};
use crate::estimate::slip::Slip;
use crate::estimate::wrench::{SensorPlaces, WrenchMatrix};
#[cfg(feature = "quantised")]
use crate::scan::TAXELS;

impl Coefficients for TaxelCalibration {
    const CHECKS: Checks<Self> = &[
        ("bias", |t| levels_fit(&t.bias.level)),
        ("noise", |t| noise_fits(t.bias.noise)),
        ("range", |t| ranges_fit(&t.range)),
        ("residual_n", |t| residuals_fit(&t.residual)),
    ];

    fn read(&mut self, bytes: &[u8]) -> Option<()> {
        let Self { bias, range, residual } = self;
        let lists: &mut [&mut [f32]] =
            &mut [&mut bias.level, from_mut(&mut bias.noise), range.as_flattened_mut(), residual];
        read_numbers(lists, bytes)?.is_empty().then_some(())
    }
}

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

#[cfg(feature = "quantised")]
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
        let rest = read_numbers(&mut [&mut self.scale], rest)?;
        read_list(&mut self.output_bias, rest)?.is_empty().then_some(())
    }
}

impl Coefficients for Inverse {
    const CHECKS: Checks<Self> = &[
        ("stray", |m| m.curves.stray.as_flattened().iter().all(|share| share.abs() < 1.0)),
        ("gap", |m| finite(m.curves.gap.as_flattened())),
        ("normal", |m| radial_fits(&m.field.normal)),
        ("shear", |m| radial_fits(&m.field.shear)),
        ("slip", |m| m.field.slip.abs() <= 1.0),
        ("error", |m| {
            let [floor, share] = m.error;
            (1e-9..1.0).contains(&floor) && (0.0..1.0).contains(&share)
        }),
        ("friction", |m| (0.01..10.0).contains(&m.friction)),
    ];
    const NEEDS_TAXELS: bool = true;

    fn read(&mut self, bytes: &[u8]) -> Option<()> {
        let Curves { stray, gap } = &mut self.curves;
        let Field { normal, shear, slip } = &mut self.field;
        let rest = read_numbers(
            &mut [
                stray.as_flattened_mut(),
                gap.as_flattened_mut(),
                &mut normal.depth,
                normal.terms.as_flattened_mut(),
                &mut shear.depth,
                shear.terms.as_flattened_mut(),
                from_mut(slip),
                &mut self.error,
            ],
            bytes,
        )?;
        let (last, rest) = postcard::take_from_bytes(rest).ok()?;
        (self.shear, self.friction) = last;
        rest.is_empty().then_some(())
    }
}

impl Coefficients for Slip {
    const CHECKS: Checks<Self> = &[
        ("usual", |s| {
            let [friction, spread] = s.usual;
            (0.05..=2.0).contains(&friction) && (0.0..=20.0).contains(&spread)
        }),
        ("radius", |s| {
            let [c, gamma] = s.surface.radius;
            (1e-3..1e3).contains(&c) && (0.0..=1.0).contains(&gamma)
        }),
        ("torque", |s| (1e-3..=1.0).contains(&s.surface.torque)),
        ("curve", |s| s.surface.curve.iter().all(|bulge| (0.5..=1.5).contains(bulge))),
        ("warn", |s| (0.0..=1.0).contains(&s.warn)),
        ("safety", |s| (1.0..=100.0).contains(&s.safety)),
    ];

    fn read(&mut self, bytes: &[u8]) -> Option<()> {
        let Self { usual, surface, warn, safety } = self;
        let LimitSurface { radius, torque, curve } = surface;
        let lists: &mut [&mut [f32]] =
            &mut [usual, radius, from_mut(torque), curve, from_mut(warn), from_mut(safety)];
        read_numbers(lists, bytes)?.is_empty().then_some(())
    }
}

impl Coefficients for Warmth {
    const CHECKS: Checks<Self> = &[
        ("reference", |w| (0.0..=1.0).contains(&w.reference)),
        ("range", |w| ranges_fit(&[w.range])),
        ("light, sensitivity", Self::shares_fit),
        ("offset", |w| w.offset.as_flattened().iter().all(|offset| offset.abs() <= 1e3)),
    ];

    fn read(&mut self, bytes: &[u8]) -> Option<()> {
        let Self { reference, range, light, sensitivity, offset } = self;
        let lists: &mut [&mut [f32]] = &mut [
            from_mut(reference),
            range,
            from_mut(light),
            from_mut(sensitivity),
            offset.as_flattened_mut(),
        ];
        read_numbers(lists, bytes)?.is_empty().then_some(())
    }
}

impl Coefficients for Array {
    const CHECKS: Checks<Self> = &[
        ("method", |a| match &a.method {
            WrenchMethod::Sum(places) => finite(places.0.as_flattened()),
            WrenchMethod::Matrix(matrix) => finite(matrix.0.as_flattened().as_flattened()),
        }),
        ("residual", |a| a.residual.iter().all(|sigma| (1e-9..1e3).contains(sigma))),
        ("moment_residual", |a| (1e-9..1e3).contains(&a.moment_residual)),
        ("surface", |a| a.surface.fits()),
    ];

    fn read(&mut self, bytes: &[u8]) -> Option<()> {
        let (method, rest) = bytes.split_first()?;
        let rest = match method {
            0 => {
                let mut places = SensorPlaces::default();
                let rest = read_numbers(&mut [places.0.as_flattened_mut()], rest)?;
                self.method = WrenchMethod::Sum(places);
                rest
            }
            1 => {
                let mut matrix = WrenchMatrix::default();
                let numbers = matrix.0.as_flattened_mut().as_flattened_mut();
                let rest = read_numbers(&mut [numbers], rest)?;
                self.method = WrenchMethod::Matrix(matrix);
                rest
            }
            _ => return None,
        };
        let lists = &mut [&mut self.residual[..], from_mut(&mut self.moment_residual)];
        let (surface, rest) = postcard::take_from_bytes(read_numbers(lists, rest)?).ok()?;
        self.surface = surface;
        rest.is_empty().then_some(())
    }
}

impl Coefficients for SensorCalibration {
    const CHECKS: Checks<Self> = &[
        ("bias", |s| levels_fit(&s.bias.level)),
        ("noise", |s| noise_fits(s.bias.noise)),
        ("sensitivity", |s| finite(s.sensitivity.0.as_flattened())),
        ("range", |s| ranges_fit(&s.range)),
        ("residual_n", |s| residuals_fit(&s.residual)),
    ];

    fn read(&mut self, bytes: &[u8]) -> Option<()> {
        let Self { bias, sensitivity, range, residual } = self;
        let lists: &mut [&mut [f32]] = &mut [
            &mut bias.level,
            from_mut(&mut bias.noise),
            sensitivity.0.as_flattened_mut(),
            range.as_flattened_mut(),
            residual,
        ];
        read_numbers(lists, bytes)?.is_empty().then_some(())
    }
}

/// Reads one of postcard's lists in place. Returns what follows it.
#[cfg(feature = "quantised")]
#[inline(never)]
fn read_list<'b>(list: &mut VecView<f32>, bytes: &'b [u8]) -> Option<&'b [u8]> {
    let (weights, rest) = split_list(bytes)?;
    list.clear();
    for weight in weights {
        list.push(f32::from_le_bytes(*weight)).ok()?;
    }
    Some(rest)
}

/// The numbers at the front of `bytes`, their count before them, and what follows them.
#[inline(never)]
fn split_list(bytes: &[u8]) -> Option<(&[[u8; 4]], &[u8])> {
    let (length, rest) = postcard::take_from_bytes::<u32>(bytes).ok()?;
    let (numbers, rest) = rest.split_at_checked(usize::try_from(length).ok()?.checked_mul(4)?)?;
    Some((numbers.as_chunks::<4>().0, rest))
}

/// The rows of weights at the front of `bytes`, and what follows them.
#[cfg(feature = "quantised")]
fn read_rows<const N: usize>(bytes: &[u8]) -> Option<(Rows<N>, &[u8])> {
    let mut rows = [[0; TAXELS]; N];
    let weights = rows.as_flattened_mut();
    let (own, rest) = bytes.split_at_checked(2 * weights.len())?;
    for (weight, bytes) in weights.iter_mut().zip(own.as_chunks::<2>().0) {
        *weight = i16::from_le_bytes(*bytes);
    }
    Some((Rows::new(&rows), rest))
}

/// Fills `numbers` from the front of `bytes`. Returns what follows them.
#[inline(never)]
fn read_numbers<'b>(lists: &mut [&mut [f32]], mut bytes: &'b [u8]) -> Option<&'b [u8]> {
    for numbers in lists {
        let (own, rest) = bytes.split_at_checked(4 * numbers.len())?;
        for (number, bytes) in numbers.iter_mut().zip(own.as_chunks::<4>().0) {
            *number = f32::from_le_bytes(*bytes);
        }
        bytes = rest;
    }
    Some(bytes)
}

fn radial_fits(radial: &Radial) -> bool {
    finite(&radial.depth) && finite(radial.terms.as_flattened())
}

/// A bias that does not come from a record.
pub(crate) fn bias_fits(bias: &Bias) -> bool {
    bias.taxels.is_none_or(|taxels| levels_fit(&taxels.level) && noise_fits(taxels.noise))
        && bias.bridges.iter().flatten().all(|b| levels_fit(&b.level) && noise_fits(b.noise))
}

/// A level is a fraction of full scale; a difference of two may reach 2.
#[inline(never)]
fn levels_fit(levels: &[f32]) -> bool {
    levels.iter().all(|level| level.abs() <= 2.0)
}

fn noise_fits(noise: f32) -> bool {
    (1e-9..1.0).contains(&noise)
}

#[inline(never)]
fn ranges_fit(ranges: &[Range]) -> bool {
    ranges.iter().all(|[low, high]| low < high) && finite(ranges.as_flattened())
}

fn residuals_fit(residuals: &[f32]) -> bool {
    residuals.iter().all(|residual| (0.0..HUGE).contains(residual))
}
