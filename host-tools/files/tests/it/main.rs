//! Tests of taxel's files: they read back as written, and damage is an error.

mod calibrations;
#[cfg(feature = "recording")]
mod recordings;
#[cfg(feature = "recording")]
mod stretches;
mod traces;
