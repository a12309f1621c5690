//! The scenes that come with the simulator.

/// A scene by its file in `scenes/`, whose name it has.
macro_rules! scenes {
    ($($name:literal)*) => {
        &[$(($name, include_str!(concat!("../../scenes/", $name, ".toml")))),*]
    };
}

/// Scenes that come with the simulator, by name.
pub const BUILT_IN: &[(&str, &str)] = scenes! {
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
    "tour"
    "bench-s0"
    "line-fit"
    "line-trial"
    "line-slide"
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
    "micro-press"
    "micro-shear"
    "column-press"
    "column-shear"
    "column-incline"
    "column-step"
};
