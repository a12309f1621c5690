//! Simulator of the virtual fingertip: a scene in, ADC codes and the truth out.
//!
//! The way of a touch through the crate is the way of the light and the strain through the finger:
//! [`path`] says where the indenter is and how hard it pushes, friction limited; [`contact`] turns that
//! into the displacement of each reflective facet, as finely as [`fidelity`] finds the scene to need, [`skin`]
//! into what rubber makes of it; [`optics`] into light on each phototransistor; [`response`] into what the force
//! sensors follow of it in time, [`bridge`] into midpoint voltages of the force sensors; [`adc`] into codes.
//! [`systems`] are the sensors that all this is done for. [`Simulator`] walks them once a frame. [`Scene`] is
//! the TOML file that says what to simulate, [`cost`] what a rung of the ladder costs and is worth.
//!
//! What a scene does not list under `effects` is not computed. A run is a function of the scene and one
//! seed: the same pair gives the same codes, bit for bit, and memory does not grow with duration.

pub mod adc;
pub mod bridge;
pub mod contact;
pub mod cost;
pub mod electronics;
mod faults;
pub mod fidelity;
pub mod light;
pub mod load;
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

pub use scene::{Effect, Scene};
pub use simulator::Simulator;
