//! Supply of LEDs and bridges, and the effect of its swings on readings.
//!
//! A bridge's midpoint is a share of the supply, so that its code stays the same on a converter
//! whose reference is the supply (ratiometric). Light is not a share of it: an LED behind a
//! resistor gets more current.

use crate::scene::{Effect, Scene};

/// Supply of [DeMaria2011] and [Ospina2017] in volts.
const NOMINAL_V: f64 = 5.0;
/// Forward voltage of an infrared LED at a few milliamperes; an assumption.
///
/// The value is 1.5 V at 100 mA (sheet of the SFH 4050), less 0.2 V for a fiftieth of the current
/// (2kT/q a factor of e). The reference finger takes off its resistance too, and has 1.25 V.
const FORWARD_V: f64 = 1.3;

/// Supply of one run.
#[derive(Clone, Debug)]
pub struct Supply {
    ratiometric: bool,
    /// Amplitude as a share of the supply, and angular frequency in radians per microsecond.
    ripple: Option<(f64, f64)>,
}

/// Scale factors relative to readings at a nominal supply.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales {
    /// Factor on the light of the LEDs.
    pub leds: f64,
    /// Factor on every voltage that does not follow the supply, as the converter sees it.
    pub fixed: f64,
    /// Factor on every voltage that is a share of the supply, as the converter sees it.
    pub share: f64,
}

impl Scales {
    /// Factors of a nominal supply.
    pub const NOMINAL: Self = Self { leds: 1.0, fixed: 1.0, share: 1.0 };
}

impl Supply {
    /// Creates the scene's supply.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        let speed = core::f64::consts::TAU * scene.electronics.ripple_hz * 1e-6;
        let ripple = scene.has(Effect::SupplyRipple);
        Self {
            ratiometric: scene.electronics.ratiometric,
            ripple: ripple.then_some((scene.electronics.ripple_ratio, speed)),
        }
    }

    /// Scale factors at `device_us`, while a fault leaves the share `dip` of the supply (1 without
    /// a fault).
    #[must_use]
    pub fn at(&self, device_us: f64, dip: f64) -> Scales {
        let ripple = self.ripple.map_or(0.0, |(swing, speed)| swing * (speed * device_us).sin());
        let supply = dip * (1.0 + ripple);
        if supply == 1.0 {
            return Scales::NOMINAL;
        }
        let reference = if self.ratiometric { supply } else { 1.0 };
        let leds = (NOMINAL_V * supply - FORWARD_V) / (NOMINAL_V - FORWARD_V);
        Scales { leds: leds.max(0.0), fixed: 1.0 / reference, share: supply / reference }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn supply(effects: &str, electronics: &str) -> Supply {
        let text = format!(
            "effects = [{effects}]\n[scan]\nrate_hz = 1000\nduration_s = 1\n[electronics]\n{electronics}\n"
        );
        Supply::new(&Scene::parse("test.toml", &text).unwrap())
    }

    #[test]
    fn steady_supply_changes_nothing() {
        assert_eq!(supply("", "ripple_ratio = 0.5").at(123.0, 1.0), Scales::NOMINAL);
    }

    #[test]
    fn ripple_cancels_in_ratiometric_bridges() {
        let ripple = "ripple_ratio = 0.01\nripple_hz = 100";
        let crest = 2500.0;
        let own = supply("'supply-ripple'", ripple).at(crest, 1.0);
        assert!((own.share - 1.0).abs() < 1e-15);
        // 50 mV of 5 V are 1.35 % of the 3.7 V that drive the LED.
        assert!((own.leds - 1.0135).abs() < 1e-4 && own.fixed < 1.0);
        let other = supply("'supply-ripple'", &format!("{ripple}\nratiometric = false"));
        let other = other.at(crest, 1.0);
        assert!((other.share - 1.01).abs() < 1e-12 && other.fixed == 1.0);
    }

    #[test]
    fn led_goes_out_below_its_forward_voltage() {
        assert_eq!(supply("", "").at(0.0, 0.25).leds, 0.0);
    }
}
