//! Numbers of a scene that have limits. A limit is checked while the file is read, where the parser
//! still knows the line.

use serde::de::{Deserialize, Deserializer, Error};

fn within<'de, D: Deserializer<'de>>(from: D, low: f64, high: f64) -> Result<f64, D::Error> {
    let value = f64::deserialize(from)?;
    check(value, low, high).map_err(D::Error::custom)
}

/// A NaN is in no range.
fn check(value: f64, low: f64, high: f64) -> Result<f64, String> {
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err(format!("{value} is out of range; allowed are {low} to {high}"))
    }
}

/// Low and high of a range that random numbers are drawn from.
fn span<'de, D: Deserializer<'de>>(from: D, low: f64, high: f64) -> Result<[f64; 2], D::Error> {
    let [from, to] = <[f64; 2]>::deserialize(from)?;
    for value in [from, to] {
        check(value, low, high).map_err(D::Error::custom)?;
    }
    if from <= to {
        Ok([from, to])
    } else {
        Err(D::Error::custom(format!("[{from}, {to}] runs backwards; write the lower one first")))
    }
}

/// One deserialiser per quantity, named after it.
macro_rules! ranges {
    ($($(#[$doc:meta])* $name:ident: $low:literal to $high:literal;)*) => {$(
        $(#[$doc])*
        pub fn $name<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
            within(from, $low, $high)
        }
    )*};
}

ranges! {
    /// Young's modulus in MPa, from gels to rubber.
    young: 0.001 to 100.0;
    /// Poisson's ratio of a material that does not grow thick when pulled.
    poisson: 0.0 to 0.5;
    /// Thickness, gap or side in mm.
    thickness: 0.1 to 20.0;
    /// Share of its stiffness that the first cycle takes from a skin; beyond a half it would snap.
    first_cycle: 0.0 to 0.4;
    /// Friction coefficient.
    friction: 0.0 to 10.0;
    /// Normal force in newtons; the finger's working range is 2 N (002), a sensor's limit 10 N (003).
    normal: 0.0 to 10.0;
    /// Tangential force in newtons.
    tangential: -10.0 to 10.0;
    /// Moment about the normal in N mm.
    torsion: -100.0 to 100.0;
    /// Stiffness of a spring in N/mm, from a hair to a robot.
    stiffness: 0.01 to 100.0;
    /// Mass in grams, up to an arm's.
    mass: 0.1 to 10000.0;
    /// Some duration in seconds.
    seconds: 0.001 to 86400.0;
    /// A moment of the scene in seconds.
    moment: 0.0 to 86400.0;
    /// A fraction of the converter's range.
    ratio: 0.0 to 1.0;
    /// Radius in mm of a fingertip that is wider than the pad.
    fingertip: 8.0 to 1000.0;
    /// Inclination of a plate in degrees.
    incline: -2.0 to 2.0;
    /// Height of a step in mm.
    step: -0.25 to 0.25;
    /// Error of a reference in newtons.
    reference: 0.0 to 1.0;
    /// Tolerated error as a share of the largest displacement.
    tolerance: 0.00001 to 0.5;
    /// Frequency of the mains' lamps in Hz.
    lamps: 1.0 to 10000.0;
    /// Temperature in °C at which silicone, diodes and bridges still work.
    celsius: -40.0 to 125.0;
    /// Frequency of a supply's ripple in Hz: from the mains to a switching converter.
    ripple: 1.0 to 1000000.0;
    /// Amplitude of a supply's ripple as a share of it; beyond, it is no supply.
    swing: 0.0 to 0.5;
    /// A phototransistor's load in ohms.
    load: 10.0 to 100000.0;
    /// Time constant of a phototransistor in microseconds.
    time_constant: 0.1 to 1000.0;
    /// Gain of the amplifiers of the bridges' midpoints.
    bridge_gain: 1.0 to 100.0;
    /// A distance that the contact point rolls, in mm.
    roll: 0.0 to 5.0;
}

const PAD: f64 = 5.0;

/// A coordinate on the pad, which is 10 mm square.
pub fn on_pad<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    let value = f64::deserialize(from)?;
    on_pad_value(value).map_err(D::Error::custom)
}

/// A point on the pad.
pub fn point_on_pad<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    let point = <[f64; 2]>::deserialize(from)?;
    for value in point {
        on_pad_value(value).map_err(D::Error::custom)?;
    }
    Ok(point)
}

fn on_pad_value(value: f64) -> Result<f64, String> {
    check(value, -PAD, PAD)
        .map_err(|_| format!("{value} mm is off the pad; allowed are -{PAD} to {PAD}"))
}

/// A stretch of coordinates on the pad.
pub fn span_on_pad<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    span(from, -PAD, PAD)
}

/// Normal forces in newtons.
pub fn span_of_normals<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    span(from, 0.0, 10.0)
}

/// Shares of the most that friction can hold.
pub fn span_of_shares<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    span(from, 0.0, 1.0)
}

/// Semi-axes in mm of a fingertip that is wider than the pad, corners too.
pub fn fingertip_axes<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 3], D::Error> {
    let axes = <[f64; 3]>::deserialize(from)?;
    for axis in axes {
        check(axis, 8.0, 1000.0).map_err(D::Error::custom)?;
    }
    Ok(axes)
}

/// Angles of a force to the skin, the lower one first.
pub fn span_of_angles<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    span(from, 10.0, 170.0)
}
