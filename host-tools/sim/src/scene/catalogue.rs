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
    "ripple"
    "fault"
    "fault-at-rest"
    "tour"
    "bench-s0"
    "mems"
    "array"
};

/// Returns the built-in scenes by name: the finger's and those of other papers' sensors.
pub fn built_in() -> impl Iterator<Item = (&'static str, &'static str)> {
    OWN.iter().copied().chain(taxel_papers::SCENES)
}
