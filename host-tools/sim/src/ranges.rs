//! Numbers of a scene with a range, checked while the file is read.
//!
//! The parser then still has the line. The message for a value out of range, or for no number at
//! all, names the allowed range.

use std::fmt;

use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

/// Range of a number.
#[derive(Clone, Copy)]
struct Limits {
    low: f64,
    high: f64,
    /// Description of a value outside.
    outside: &'static str,
}

impl Limits {
    const fn new(low: f64, high: f64) -> Self {
        Self { low, high, outside: "out of range" }
    }

    /// Checks that `value` is in the range; a NaN is in no range.
    fn check(self, value: f64) -> Result<f64, String> {
        let Self { low, high, outside } = self;
        if (low..=high).contains(&value) {
            Ok(value)
        } else {
            Err(format!("{value} is {outside}; allowed are {low} to {high}"))
        }
    }

    fn number<'de, D: Deserializer<'de>>(self, from: D) -> Result<f64, D::Error> {
        self.check_any(Given::deserialize(from)?).map_err(D::Error::custom)
    }

    fn check_any(self, given: Given) -> Result<f64, String> {
        let Self { low, high, .. } = self;
        given
            .0
            .map_err(|what| format!("{what} instead of a number; allowed are {low} to {high}"))
            .and_then(|value| self.check(value))
    }
}

/// Whole number from `LOW` to `HIGH`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Whole<const LOW: u32, const HIGH: u32>(u32);

impl<const LOW: u32, const HIGH: u32> Whole<LOW, HIGH> {
    /// Creates the number from `value`, or from the nearest allowed one.
    pub const fn nearest(value: u32) -> Self {
        Self(if value < LOW {
            LOW
        } else if value > HIGH {
            HIGH
        } else {
            value
        })
    }

    /// The number itself.
    pub const fn get(self) -> u32 {
        self.0
    }
}

impl<'de, const LOW: u32, const HIGH: u32> Deserialize<'de> for Whole<LOW, HIGH> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Within<const LOW: u32, const HIGH: u32>;
        impl<const LOW: u32, const HIGH: u32> Visitor<'_> for Within<LOW, HIGH> {
            type Value = u32;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a whole number from {LOW} to {HIGH}")
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<u32, E> {
                let known = u32::try_from(value).ok().filter(|v| (LOW..=HIGH).contains(v));
                known.ok_or_else(|| {
                    E::custom(format!("{value} is out of range; allowed are {LOW} to {HIGH}"))
                })
            }
        }
        from.deserialize_any(Within::<LOW, HIGH>).map(Self)
    }
}

/// Reads a whole number that is one of `allowed`.
pub fn one_of<'de, D: Deserializer<'de>>(
    from: D,
    allowed: &'static [u16],
) -> Result<u16, D::Error> {
    struct OneOf(&'static [u16]);
    impl Visitor<'_> for OneOf {
        type Value = u16;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            let names: Vec<String> = self.0.iter().map(u16::to_string).collect();
            write!(f, "one of {}", names.join(", "))
        }

        fn visit_i64<E: Error>(self, value: i64) -> Result<u16, E> {
            let known = self.0.iter().copied().find(|allowed| i64::from(*allowed) == value);
            known.ok_or_else(|| E::invalid_value(serde::de::Unexpected::Signed(value), &self))
        }
    }
    from.deserialize_any(OneOf(allowed))
}

/// Number whose range depends on other keys, or the type of a value that is no number.
#[derive(Clone, Copy, Debug)]
pub struct Given(Result<f64, &'static str>);

impl Given {
    /// Returns the number if it is within the range.
    pub fn within(&self, low: f64, high: f64) -> Result<f64, String> {
        Limits::new(low, high).check_any(*self)
    }
}

impl<'de> Deserialize<'de> for Given {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Anything;
        impl<'de> Visitor<'de> for Anything {
            type Value = Given;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Given, E> {
                Ok(Given(Ok(value)))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Given, E> {
                Ok(Given(Ok(value as f64)))
            }

            fn visit_str<E>(self, _: &str) -> Result<Given, E> {
                Ok(Given(Err("a text")))
            }

            fn visit_bool<E>(self, _: bool) -> Result<Given, E> {
                Ok(Given(Err("true or false")))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<Given, A::Error> {
                while values.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Given(Err("an array")))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut keys: A) -> Result<Given, A::Error> {
                while keys.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Ok(Given(Err("a table or a date")))
            }
        }
        from.deserialize_any(Anything)
    }
}

/// Reads `N` numbers, each within the limits.
fn numbers<'de, const N: usize, D: Deserializer<'de>>(
    from: D,
    limits: Limits,
) -> Result<[f64; N], D::Error> {
    struct Numbers<const N: usize>(Limits);
    impl<'de, const N: usize> Visitor<'de> for Numbers<N> {
        type Value = [f64; N];

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            let Limits { low, high, .. } = self.0;
            write!(f, "{N} numbers from {low} to {high} in square brackets")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<[f64; N], A::Error> {
            let mut numbers = [0.0; N];
            let mut count = 0;
            while let Some(value) = values.next_element()? {
                let value = self.0.check_any(value).map_err(A::Error::custom)?;
                if let Some(number) = numbers.get_mut(count) {
                    *number = value;
                }
                count += 1;
            }
            if count == N { Ok(numbers) } else { Err(A::Error::invalid_length(count, &self)) }
        }
    }
    from.deserialize_any(Numbers::<N>(limits))
}

/// Reads the low and the high end of a range.
fn span<'de, D: Deserializer<'de>>(from: D, limits: Limits) -> Result<[f64; 2], D::Error> {
    let [from, to] = numbers(from, limits)?;
    if from <= to {
        Ok([from, to])
    } else {
        Err(D::Error::custom(format!("[{from}, {to}] runs backwards; write the lower one first")))
    }
}

/// Defines one deserialiser per quantity, named after the quantity.
macro_rules! ranges {
    ($($(#[$doc:meta])* $name:ident: $low:literal to $high:literal;)*) => {$(
        $(#[$doc])*
        pub fn $name<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
            Limits::new($low, $high).number(from)
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
    /// Normal force in newtons; the finger's working range is 2 N ([DeMaria2011]), a sensor's limit
    /// 10 N ([Ospina2017]).
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

/// Side of the pad in mm.
pub const PAD_MM: f64 = 10.0;
/// Range of a coordinate on the pad.
const PAD: Limits = Limits { low: -0.5 * PAD_MM, high: 0.5 * PAD_MM, outside: "off the pad" };

/// Reads a coordinate on the pad.
pub fn on_pad<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    PAD.number(from)
}

/// Reads a point on the pad.
pub fn point_on_pad<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    numbers(from, PAD)
}

/// Reads a range of coordinates on the pad.
pub fn span_on_pad<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    span(from, PAD)
}

/// Reads a range of normal forces in newtons.
pub fn span_of_normals<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    span(from, Limits::new(0.0, 10.0))
}

/// Reads a range of shares of the friction limit.
pub fn span_of_shares<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    span(from, Limits::new(0.0, 1.0))
}

/// Reads the semi-axes in mm of a fingertip that is wider than the pad, including its corners.
pub fn fingertip_axes<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 3], D::Error> {
    numbers(from, Limits::new(8.0, 1000.0))
}

/// Reads a range of angles between force and skin in degrees.
pub fn span_of_angles<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    span(from, Limits::new(10.0, 170.0))
}
