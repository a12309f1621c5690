//! Files of taxel: what is written is read back, and every kind of damage is named.

mod calibrations;
#[cfg(feature = "recording")]
mod recordings;
mod traces;
