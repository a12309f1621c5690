//! Interface of the image to its machine: semihosting operations and input memory.
//!
//! The operations have numbers that the specification leaves to applications.

use serde::{Deserialize, Serialize};
use taxel::scan::Scan;

use crate::kinds::KINDS;

/// Operation that announces a measured call; the parameter points at a [`Call`].
///
/// The machine measures the function's next call, from its first instruction to its return.
/// Measuring adds nothing.
pub const MEASURE: usize = 0x100;
/// Operation that ends a measured call; the parameter points at the [`Span`] of its result in
/// postcard.
pub const REPORT: usize = 0x101;
/// Operation that ends a call without measurement; the parameter points at its [`Compared`].
pub const COMPARE: usize = 0x102;

/// Address of the inputs: their length as a `u32`, then [`Inputs`] in postcard.
pub const INPUTS: usize = 0x9000_0000;

/// Range of bytes in the image's memory.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Span {
    address: usize,
    length: usize,
}

impl Span {
    /// Range of `bytes`.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self { address: bytes.as_ptr().expose_provenance(), length: bytes.len() }
    }
}

/// Announced call.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Call {
    /// Address of the function.
    pub function: usize,
    /// Name in reports.
    pub name: Span,
}

/// Result of a call without measurement.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Compared {
    /// Name in the error message if the result differs.
    pub name: Span,
    /// Result in postcard.
    pub result: Span,
}

/// Inputs of the stages.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Inputs<'a> {
    /// Calibration record of a finger.
    pub record: &'a [u8],
    /// Scans of that finger without contact, in postcard one after the other.
    pub free: &'a [u8],
    /// Scans of that finger in contact.
    pub touched: &'a [u8],
    /// Finger as shipped.
    pub whole: Whole<'a>,
}

/// Finger with every section that a default fit writes.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Whole<'a> {
    /// Calibration record of the finger.
    #[serde(borrow)]
    pub record: &'a [u8],
    /// Runs of scans, one for each of the [`KINDS`]; the first is without contact.
    #[serde(borrow)]
    pub runs: [&'a [u8]; KINDS.len()],
}

impl<'a> Inputs<'a> {
    /// Scans without contact.
    pub fn free(&self) -> impl Iterator<Item = Scan> + Clone + use<'a> {
        scans(self.free)
    }

    /// Scans in contact.
    pub fn touched(&self) -> impl Iterator<Item = Scan> + Clone + use<'a> {
        scans(self.touched)
    }
}

/// Scans in `bytes`, in postcard one after the other.
pub fn scans(mut bytes: &[u8]) -> impl Iterator<Item = Scan> + Clone {
    core::iter::from_fn(move || {
        let (scan, rest) = postcard::take_from_bytes(bytes).ok()?;
        bytes = rest;
        Some(scan)
    })
}
