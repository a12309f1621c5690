//! Figures that the papers print, shown next to those found.
//!
//! Forces are in newtons, positions in millimetres.

use serde::Serialize;

/// A line of a paper's table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Printed {
    /// Measured quantity.
    pub quantity: &'static str,
    /// Unit of the quantity.
    pub unit: &'static str,
    /// Source: paper and table.
    pub source: &'static str,
    /// Mean error.
    pub bias: Option<f64>,
    /// Standard deviation of the error.
    pub sigma: Option<f64>,
    /// Largest error.
    pub max: Option<f64>,
}

const fn force(
    quantity: &'static str,
    source: &'static str,
    [bias, max, sigma]: [f64; 3],
) -> Printed {
    let (bias, sigma, max) = (Some(bias), Some(sigma), Some(max));
    Printed { quantity, unit: "N", source, bias, sigma, max }
}

/// Printed figures of force sensors and of the 4×1 sensor.
///
/// [Ospina2017] tables 1.2 (bare) and 1.3 (coated): for each component the sensor with the least σ.
/// [DeMaria2011]: trial set of the 4×1 sensor.
pub(crate) const PRINTED: [Printed; 7] = [
    force("fx", "[Ospina2017] table 1.2, H02 (bare)", [2.29e-3, 28.47e-3, 5.66e-3]),
    force("fy", "[Ospina2017] table 1.2, H02 (bare)", [3.25e-3, 17.42e-3, 4.24e-3]),
    force("fz", "[Ospina2017] table 1.2, D12 (bare)", [-0.331e-3, 16.24e-3, 4.03e-3]),
    force("fx", "[Ospina2017] table 1.3, rA (coated)", [-3.36e-3, 46.31e-3, 11.82e-3]),
    force("fy", "[Ospina2017] table 1.3, rD (coated)", [-2.87e-3, 51.63e-3, 11.92e-3]),
    force("fz", "[Ospina2017] table 1.3, rB (coated)", [3.90e-3, 33.42e-3, 7.79e-3]),
    Printed {
        quantity: "x, y",
        unit: "mm",
        source: "[DeMaria2011], trial set of the 4×1 sensor",
        bias: None,
        sigma: None,
        max: Some(0.3),
    },
];

/// Largest error of a force's angle in [DeMaria2011], degrees.
pub(crate) const ANGLE_DEG: f64 = 10.0;

/// One of Harmon's requirements ([TactileEnc]) with the value found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Requirement {
    /// Text of the requirement.
    pub required: &'static str,
    /// Value found, with its quantity.
    pub found: Option<String>,
    /// Whether the requirement is met.
    pub met: Option<bool>,
}

/// Required sensitivity, "a few grams": three, in newtons.
pub(crate) const A_FEW_GRAMS: f64 = 3.0 * 9.81e-3;
/// Required dynamic range.
pub(crate) const RANGE: f64 = 1000.0;
/// Required spatial resolution, millimetres.
pub(crate) const SPATIAL: f64 = 2.0;
/// Required time response, hertz.
pub(crate) const RESPONSE: f64 = 100.0;
