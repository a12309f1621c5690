//! Contact mechanics: stress, strain and displacement in the skin under a contact.
//!
//! Coordinates are the finger's: x and y along the skin in mm, z down from its surface. Forces are
//! in newtons with z into the skin. Stresses are therefore in MPa, and pressure is a negative σ_zz.
//! From the formulas up:
//!
//! - [`HalfSpace`]: the material; stress, strain and displacement under a point load ([TactileEnc]
//!   eqs (1), (2); Johnson §3.2, §3.6), and contact sizes of indenters;
//! - [`plane`]: line, flat block and cylinder in plane strain, in closed form ([TactileEnc]);
//! - [`sphere`]: Hertz's sphere in closed form;
//! - [`traction`]: any contact as a superposition of point loads over it;
//! - [`convergence`]: error of superposition against the closed forms;
//! - [`Indenter`]: the tractions of a tip, sphere, punch, corner, cylinder, block or edge that is
//!   pressed, sheared (partial slip) and twisted;
//! - [`Facets`]: mean vertical displacement of each facet under a taxel.
//!
//! How well a half-space stands for a real skin, with numbers: `docs/simulator.md`.

pub mod convergence;
mod facets;
mod gauss;
mod halfspace;
mod indenter;
pub mod layer;
pub mod plane;
pub mod sphere;
pub mod traction;

pub use facets::Facets;
pub use halfspace::{HalfSpace, SILICONE_YOUNG_MPA};
pub use indenter::{Axis, Indenter};
pub use traction::{Patch, Rule};
