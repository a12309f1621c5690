//! Core of a robot fingertip: ADC codes in, frames of forces and contact positions out.
//!
//! Inputs are the codes of a 4×4 LED–phototransistor matrix and of up to four piezoresistive force
//! sensors. Outputs are newtons, millimetres and the reasons for missing values.
//!
//! The code runs unchanged on a Cortex-M and on a host: no HAL, no heap, no `unsafe`. The same
//! codes give the same frames **bit for bit**, because floats are only added, multiplied, divided
//! and compared, in a fixed order.
//!
//! ```text
//! scan ──▶ condition ──▶ estimate ──▶ frame ──▶ wire
//!            (Bias)    (Calibration)             │
//!                 finger ──▶ instrument ──▶ session
//! ```
//! Coefficients are `&self`, memory is `&mut` state. A missing value has a typed reason
//! ([`measured::NoValue`]); it is never NaN and never the last value.
//!
//! # Example
//! ```
//! use taxel::finger::Finger;
//! use taxel::measured::NoValue;
//! use taxel::scan::{Codes, Scan, TaxelCodes};
//! use taxel::units::{Code, FullScale, Micros};
//!
//! let (finger, mut state) = Finger::new(None);
//! let codes = Codes {
//!     full_scale: FullScale::BITS_12,
//!     taxels: Some(TaxelCodes { lit: [[Code(1800); 4]; 4], dark: [Code(200); 4] }),
//!     bridges: [None; 4],
//!     reference: None,
//!     temperature: None,
//! };
//! let estimate = finger.estimate(&mut state, &Scan { time: Micros(0), lost: 0, codes });
//! assert_eq!(estimate.force.z, Err(NoValue::Uncalibrated));
//! ```
#![no_std]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing,
        clippy::string_slice
    )
)]

#[cfg(test)]
extern crate std;

pub mod calibration;
pub mod condition;
pub mod crc32;
pub mod estimate;
pub mod finger;
pub mod frame;
pub mod instrument;
pub mod math;
pub mod measured;
pub mod scan;
pub mod self_test;
#[cfg(feature = "session")]
pub mod session;
pub mod store;
pub mod units;
pub mod wire;
