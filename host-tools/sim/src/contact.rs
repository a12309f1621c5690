//! Contact mechanics: what a force on the skin does below it.
//!
//! Coordinates are those of the finger: x and y along the skin in mm, z down from its surface; forces in
//! newtons, z into the skin; so stresses are MPa and pressure is a negative σ_zz. From the formulas up:
//!
//! - [`HalfSpace`]: the material; stress, strain and displacement under a point load ([TactileEnc] eqs (1), (2);
//!   Johnson §3.2, §3.6), and how far indenters go into it;
//! - [`plane`]: line, flat block and cylinder in plane strain, in closed form ([TactileEnc]);
//! - [`sphere`]: Hertz's sphere in closed form;
//! - [`traction`]: any contact as a superposition of point loads over it;
//! - [`convergence`]: how fast superposition goes to the closed forms;
//! - [`Indenter`]: the tractions of a tip, sphere, punch, corner, cylinder, block or edge that is pressed,
//!   sheared (partial slip) and twisted;
//! - [`Facets`]: what the optical taxels see of it: means of the vertical displacement.
//!
//! What a half-space is worth for a real skin, with numbers: `docs/simulator.md`.

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
