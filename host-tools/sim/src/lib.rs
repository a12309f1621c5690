//! Simulator of the virtual fingertip: from a scene to ADC codes and the truth.
//!
//! The modules follow the light and the strain through the finger:
//!
//! - [`path`][]: position and force of the indenter, limited by friction;
//! - [`contact`][]: displacement of each reflective facet, as finely as [`fidelity`] finds
//!   necessary;
//! - [`skin`][]: effects of rubber on that displacement;
//! - [`optics`][]: light on each phototransistor;
//! - [`response`][]: lag of the force sensors;
//! - [`bridge`][]: midpoint voltages of the force sensors;
//! - [`adc`][]: codes;
//! - [`systems`][]: the sensors of the papers, which use all of these;
//! - [`cost`][]: cost and error of each rung of the fidelity ladder.
//!
//! [`Scene`] is the TOML file that describes what to simulate, and [`Simulator`] runs it frame by
//! frame. Effects that a scene does not list under `effects` are not computed. A run is a function
//! of the scene and one seed: the same pair gives the same codes, bit for bit. Memory does not grow
//! with duration.

pub mod adc;
pub mod bridge;
pub mod contact;
pub mod cost;
pub mod electronics;
mod faults;
pub mod fidelity;
pub mod light;
pub mod load;
mod load_cell;
pub mod optics;
pub mod path;
pub mod plate;
mod ranges;
pub mod response;
pub mod scene;
mod seeds;
pub mod sheet;
mod simulator;
pub mod skin;
pub mod supply;
pub mod surface;
pub mod systems;

pub use load_cell::LoadCell;
pub use scene::{Effect, Scene};
pub use simulator::Simulator;
