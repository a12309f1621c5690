//! Types of quantities that must not be mixed: ADC codes, fractions of full scale, and SI units.
//!
//! Conversion happens at the edge: [`crate::condition`] turns codes into fractions, and
//! [`crate::estimate`] turns fractions into newtons and millimetres. Nothing converts back.

use serde::{Deserialize, Serialize};

/// One ADC reading, straight from the converter or its oversampler.
///
/// On the wire it is two bytes, little-endian (a varint would need three for most codes).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(transparent)]
pub struct Code(pub u16);

impl Serialize for Code {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        postcard::fixint::le::serialize(&self.0, serializer)
    }
}

impl<'de> Deserialize<'de> for Code {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        postcard::fixint::le::deserialize(deserializer).map(Code)
    }
}

/// Highest code of a channel: 4095 for a 12-bit converter, 65535 for values scaled to 16 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FullScale(core::num::NonZeroU16);

impl FullScale {
    /// Full scale of a plain 12-bit converter.
    pub const BITS_12: Self = Self::from_bits(12);
    /// Full scale of values scaled to 16 bits.
    pub const BITS_16: Self = Self::from_bits(16);

    const fn from_bits(bits: u32) -> Self {
        // `1 << 0 - 1` would be zero; the two callers above pass 12 and 16.
        match core::num::NonZeroU16::new(((1u32 << bits) - 1) as u16) {
            Some(top) => Self(top),
            None => Self(core::num::NonZeroU16::MAX),
        }
    }

    /// Makes a full scale of `top` codes; `None` for zero.
    #[must_use]
    pub const fn new(top: u16) -> Option<Self> {
        match core::num::NonZeroU16::new(top) {
            Some(top) => Some(Self(top)),
            None => None,
        }
    }

    /// Returns the highest code.
    #[must_use]
    pub const fn top(self) -> Code {
        Code(self.0.get())
    }

    /// Returns `code` as a fraction of full scale, 0 to 1 for codes up to the top.
    #[must_use]
    pub fn ratio(self, code: Code) -> Ratio {
        Ratio(f32::from(code.0) / f32::from(self.0.get()))
    }

    /// Returns one code as a fraction of full scale.
    ///
    /// A difference of codes times this step is the exact fraction to a relative error of 1.2e-7.
    /// This costs one multiplication instead of two divisions and a rounded difference.
    #[must_use]
    pub fn step(self) -> Ratio {
        Ratio(1.0 / f32::from(self.0.get()))
    }

    /// Returns the lowest code that may have been clipped.
    ///
    /// The band is the top 1/1024 of the range, because an oversampled value with some clipped
    /// samples averages just below the top code.
    #[must_use]
    pub const fn clipped(self) -> Code {
        Code(self.0.get() - self.0.get() / 1024)
    }

    /// Returns whether the reading may have been clipped.
    #[must_use]
    pub fn clips(self, code: Code) -> bool {
        code >= self.clipped()
    }
}

impl Serialize for FullScale {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.top().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for FullScale {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let top = Code::deserialize(deserializer)?;
        Self::new(top.0).ok_or_else(|| serde::de::Error::custom("full scale of zero"))
    }
}

/// Device time in microseconds since power-up; 64 bits never wrap in the life of a finger.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(transparent)]
pub struct Micros(pub u64);

impl Micros {
    /// Returns the microseconds since an earlier time: none after a restart of the clock, and at
    /// most those of 71 minutes.
    #[must_use]
    #[inline]
    pub fn since(self, earlier: Self) -> u32 {
        self.0.saturating_sub(earlier.0).try_into().unwrap_or(u32::MAX)
    }
}

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[serde(transparent)]
        pub struct $name(pub f32);

        impl core::ops::Add for $name {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }

        impl core::ops::Sub for $name {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self(self.0 - other.0)
            }
        }
    };
}

quantity!(
    /// Fraction of the converter's full scale. The same number is a fraction of the bridge supply,
    /// because bridge and ADC share a reference.
    Ratio
);
quantity!(
    /// Force in newtons; z is positive into the skin.
    Newtons
);
quantity!(
    /// Length in millimetres.
    Millimetres
);
quantity!(
    /// Moment in newton millimetres.
    NewtonMillimetres
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_scale_of_zero_is_no_full_scale() {
        assert_eq!(FullScale::new(0), None);
        assert_eq!(FullScale::BITS_12.top(), Code(4095));
        assert_eq!(FullScale::BITS_16.top(), Code(65535));
    }

    #[test]
    fn fractions_agree_at_both_ends_of_12_and_16_bits() {
        for full_scale in [FullScale::BITS_12, FullScale::BITS_16] {
            assert_eq!(full_scale.ratio(Code(0)), Ratio(0.0));
            assert_eq!(full_scale.ratio(full_scale.top()), Ratio(1.0));
        }
    }

    #[test]
    fn step_differences_match_quotients_to_rounding() {
        for top in [1u16, 3, 1000, 4095, 50_001, 65_535] {
            let step = FullScale::new(top).unwrap().step().0;
            for difference in (-65_535..=65_535).step_by(7) {
                let exact = f64::from(difference) / f64::from(top);
                let found = f64::from(difference as f32 * step);
                assert!((found - exact).abs() <= 1.2e-7 * exact.abs(), "{difference}/{top}");
            }
        }
    }

    #[test]
    fn only_top_thousandth_is_clipped() {
        assert!(FullScale::BITS_12.clips(Code(4095)));
        assert!(FullScale::BITS_12.clips(Code(4092)));
        assert!(!FullScale::BITS_12.clips(Code(4091)));
        assert!(!FullScale::BITS_16.clips(Code(65_000)));
    }
}
