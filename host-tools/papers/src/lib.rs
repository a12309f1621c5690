//! Sensors of papers other than the finger's own: each law from force to signal, and back.
//!
//! | module | sensor | paper |
//! |---|---|---|
//! | [`line_of_four`] | four taxels in a row | [DeMaria2011] |
//! | [`feeler`], [`sheet`] | bright spot under a conical feeler; 10×12 of them | [Ohka2005] |
//! | [`column`] | columns on 2×2 cones, for combined loads | [Ohka2004] |
//!
//! The simulator computes light from these laws, the regression fits their coefficients to a table,
//! and the cycle bench counts the estimators. No image of a finger contains them. Keys:
//! `docs/references.md`.
#![no_std]
#![allow(rustdoc::broken_intra_doc_links, reason = "[DeMaria2011] is the key of a paper")]

pub mod column;
pub mod feeler;
pub mod line_of_four;
pub mod sheet;

/// Pairs each file of `scenes/` with its name.
macro_rules! scenes {
    ($($name:literal)*) => {
        [$(($name, include_str!(concat!("../scenes/", $name, ".toml")))),*]
    };
}

/// Scenes of these sensors for the simulator, by name.
pub const SCENES: [(&str, &str); 10] = scenes! {
    "line-fit"
    "line-trial"
    "micro-press"
    "micro-shear"
    "sheet-press"
    "sheet-shear"
    "column-press"
    "column-shear"
    "column-incline"
    "column-step"
};
