//! How the image and the machine it runs on speak: the semihosting operations that the specification
//! leaves to applications, and the inputs that the machine puts into memory.

use serde::{Deserialize, Serialize};
use taxel::scan::Scan;

use crate::kinds::KINDS;

/// The next call of a function is measured, from its first instruction to its return. Nothing is added to
/// what is measured. The parameter points at a [`Call`].
pub const MEASURE: usize = 0x100;
/// A measured call is over; the parameter points at the [`Span`] of its result in postcard.
pub const REPORT: usize = 0x101;
/// A call that was not measured is over; the parameter points at its [`Compared`].
pub const COMPARE: usize = 0x102;

/// Where the machine puts the inputs: their length as a `u32`, then [`Inputs`] in postcard.
pub const INPUTS: usize = 0x9000_0000;

/// Bytes in the image's memory.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Span {
    address: usize,
    length: usize,
}

impl Span {
    /// Those of `bytes`.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self { address: bytes.as_ptr().expose_provenance(), length: bytes.len() }
    }
}

/// A call that is about to be made.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Call {
    /// Address of the function.
    pub function: usize,
    /// What is printed for it.
    pub name: Span,
}

/// What came of a call that was not measured.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Compared {
    /// What is printed for it where it is not what it should be.
    pub name: Span,
    /// In postcard.
    pub result: Span,
}

/// What the stages work on.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Inputs<'a> {
    /// Calibration record of a finger.
    pub record: &'a [u8],
    /// Scans of that finger while nothing touches it, in postcard one after the other.
    pub free: &'a [u8],
    /// Scans of it in contact.
    pub touched: &'a [u8],
    /// And as it is shipped.
    pub whole: Whole<'a>,
}

/// A finger with every section that a default fit writes.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Whole<'a> {
    /// Its calibration record.
    #[serde(borrow)]
    pub record: &'a [u8],
    /// A run of scans for each of the [`KINDS`], the first of which sees nothing.
    #[serde(borrow)]
    pub runs: [&'a [u8]; KINDS.len()],
}

impl<'a> Inputs<'a> {
    /// While nothing touches the finger.
    pub fn free(&self) -> impl Iterator<Item = Scan> + Clone + use<'a> {
        scans(self.free)
    }

    /// In contact.
    pub fn touched(&self) -> impl Iterator<Item = Scan> + Clone + use<'a> {
        scans(self.touched)
    }
}

/// Those in `bytes`, in postcard one after the other.
pub fn scans(mut bytes: &[u8]) -> impl Iterator<Item = Scan> + Clone {
    core::iter::from_fn(move || {
        let (scan, rest) = postcard::take_from_bytes(bytes).ok()?;
        bytes = rest;
        Some(scan)
    })
}
