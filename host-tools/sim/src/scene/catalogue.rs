//! Built-in scenes.

/// Pairs each file of `scenes/` with its name.
macro_rules! scenes {
    ($($name:literal)*) => {
        &[$(($name, include_str!(concat!("../../scenes/", $name, ".toml")))),*]
    };
}

/// Scenes of the finger and of its force sensors, by name.
const OWN: &[(&str, &str)] = scenes! {
    "press"
    "press-4khz"
    "presses"
    "press-grid"
    "shear"
    "shear-ramp"
    "stick-slip"
    "roll"
    "torsion"
    "tap"
    "grasp"
    "two-contacts"
    "edge"
    "flicker"
    "temperature"
    "warm-up"
    "press-walls"
    "shear-walls"
    "skin-cycle"
    "ripple"
    "fault-dead-led"
    "fault-open-channel"
    "fault-shorted-channel"
    "fault-stuck-channel"
    "fault-saturated-adc"
    "fault-broken-arm"
    "fault-supply-dip"
    "fault-swapped-columns"
    "fault-at-rest"
    "tour"
    "bench-s0"
    "mems-bare"
    "mems-ra"
    "mems-rb"
    "mems-rc"
    "mems-rd"
    "mems-f02"
    "mems-tap"
    "mems-grasp"
    "mems-temperature"
    "array-plane"
    "array-sphere"
    "array-ellipsoid"
    "array-slide"
    "array-roll"
};

/// Returns the built-in scenes by name: the finger's and those of other papers' sensors.
pub fn built_in() -> impl Iterator<Item = (&'static str, &'static str)> {
    OWN.iter().copied().chain(taxel_papers::SCENES)
}
