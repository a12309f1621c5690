//! Scenes: TOML files that describe what to simulate.
//!
//! A key's name ends in the unit of its number. A key left out has a default. A key that is
//! misspelt, out of range or contradictory is an error with its line.

use std::fmt;
use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use crate::contact::{Indenter, SILICONE_YOUNG_MPA};
use crate::ranges::{self, Given, Whole};
use crate::response::Coating;

mod acts;
mod catalogue;
mod changes;
mod check;
mod device;
mod electronics;
mod fault;
mod fidelity;
mod indenter;
mod light;
mod limits;
mod read;
mod temperature;
mod trials;

pub use acts::{Act, Press, Random, Roll, Slide, Spring, Tap};
pub use catalogue::built_in;
pub use changes::{Changes, REAL};
pub use device::{Bits, Device, Kind, Taxel};
pub use electronics::Electronics;
pub use fault::{Broken, Fault, Place};
pub use fidelity::Fidelity;
pub use light::Light;
pub use temperature::{REFERENCE_C, Temperature, ZERO_C, softness};
pub use trials::{Grid, Plate};

/// Effect that a scene may list under `effects`; effects not listed are not computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Effect {
    /// Shot noise of the phototransistors and noise of the converter.
    Noise,
    /// Steady part of the room light that reaches the phototransistors.
    Ambient,
    /// Part of the room light that swings with the mains.
    Flicker,
    /// Sunlight from the moment `sun_at_s` of the scene on.
    Sun,
    /// Delay of the phototransistors: a reading still holds some of the row before.
    Settling,
    /// Ripple of the supply.
    SupplyRipple,
    /// Spread of gain and gap between optical pairs, and of offset between columns.
    GainSpread,
    /// Stray light between neighbouring pairs.
    OpticalCrosstalk,
    /// Mismatch of the resistors of a bridge, so that the bridge does not rest at zero.
    BridgeMismatch,
    /// Spread of the force sensors' sensitivities, and cross-talk of their axes.
    BridgeCrosstalk,
    /// Skin bonded to a rigid frame with a window open under each facet, in place of a half-space.
    Walls,
    /// Stiffening of the skin under large strain.
    Stiffening,
    /// Softening of the skin by its first loading up to the largest load so far.
    Hysteresis,
    /// Delay and relaxation of the facets, as the skin's `follows` sets them.
    SkinResponse,
    /// Delay and relaxation of the force sensors, as their `coating` sets them.
    Response,
    /// Effects of temperature: the finger has the temperature of `[temperature]` instead of the
    /// reference.
    Temperature,
    /// Slow creep of the skin under load.
    Creep,
    /// Warming of the LEDs by their own current after the start.
    SelfHeating,
    /// Integral non-linearity of the converter.
    Nonlinearity,
    /// Diffuse reflection by the facets, in place of a mirror's.
    DiffuseFacet,
    /// Error of the bench's load cell and placement, in the truth.
    BenchError,
}

/// Writes the name as in a scene.
impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, letter) in format!("{self:?}").char_indices() {
            let hyphen = if i > 0 && letter.is_uppercase() { "-" } else { "" };
            write!(f, "{hyphen}{}", letter.to_ascii_lowercase())?;
        }
        Ok(())
    }
}

/// Parsed scene.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Description in one line.
    #[serde(default)]
    pub description: String,
    /// Effects to model beyond the ideal finger.
    #[serde(default)]
    pub effects: Vec<Spanned<Effect>>,
    /// Key of [`Scene::fidelity`].
    fidelity: Option<Spanned<Fidelity>>,
    /// Key of [`Scene::tolerance`].
    tolerance: Option<Spanned<Given>>,
    /// Timing of the samples.
    pub scan: Scan,
    /// The finger.
    #[serde(default)]
    pub device: Device,
    /// Skin of the finger.
    #[serde(default)]
    pub material: Material,
    /// Deformable layer of the finger.
    #[serde(default)]
    pub layer: Layer,
    /// Key of [`Scene::indenter`].
    #[serde(default)]
    indenter: indenter::Table,
    /// Friction between indenter and skin.
    #[serde(default)]
    pub friction: Friction,
    /// Light of the room.
    #[serde(default)]
    pub light: Light,
    /// Electronics between a photocurrent or a bridge and its code.
    #[serde(default)]
    pub electronics: Electronics,
    /// Key of [`Scene::temperature`].
    #[serde(default)]
    temperature: Temperature,
    /// Bench: present where the force acts on a single force sensor and not on the skin.
    pub bench: Option<Bench>,
    /// Presses at one contact point.
    #[serde(default)]
    pub press: Vec<Spanned<Press>>,
    /// Slides over the skin.
    #[serde(default)]
    pub slide: Vec<Spanned<Slide>>,
    /// Taps at one contact point.
    #[serde(default)]
    pub tap: Vec<Spanned<Tap>>,
    /// Rolls over the skin.
    #[serde(default)]
    pub roll: Vec<Spanned<Roll>>,
    /// Rows of random presses.
    #[serde(default)]
    pub random: Vec<Spanned<Random>>,
    /// Presses on a grid.
    #[serde(default)]
    pub grid: Vec<Spanned<Grid>>,
    /// Plates on columns.
    #[serde(default)]
    pub plate: Vec<Spanned<Plate>>,
    /// Faults with their times.
    #[serde(default)]
    fault: Vec<Fault>,
}

/// `[scan]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scan {
    /// Frames per second, 1 to 20000.
    rate_hz: Spanned<Whole<1, 20_000>>,
    /// Length of the scene in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub duration_s: f64,
    /// Duration of each of the five steps (dark, row 0 … row 3) of a frame in microseconds.
    #[serde(default = "Scan::usual_step")]
    step_us: Spanned<Whole<1, 200_000>>,
}

impl Scan {
    /// Default step: settling of the phototransistors to 12 bits is 26.5 µs; five such steps fit
    /// into 4 kHz.
    fn usual_step() -> Spanned<Whole<1, 200_000>> {
        Spanned::new(0..0, Whole::nearest(30))
    }

    /// Duration of each of the five steps in microseconds.
    #[must_use]
    pub fn step_us(&self) -> u32 {
        self.step_us.get_ref().get()
    }
}

/// `[material]`; the default is the silicone of [DeMaria2011].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Material {
    /// Young's modulus in MPa.
    #[serde(deserialize_with = "ranges::young")]
    pub young_mpa: f64,
    /// Poisson's ratio.
    #[serde(deserialize_with = "ranges::poisson")]
    pub poisson: f64,
    /// Share of stiffness that the skin loses in the first cycle; with `hysteresis`.
    ///
    /// [DeMaria2011] shows such a cycle (fig. 3) and prints no figure.
    #[serde(deserialize_with = "ranges::first_cycle")]
    pub first_cycle_ratio: f64,
    /// Coating whose delay and relaxation the skin has; with the effect `skin-response`.
    ///
    /// [DeMaria2011] measures none; the default is [Ospina2017]'s softest coating, the most similar
    /// one.
    pub follows: Coating,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            young_mpa: SILICONE_YOUNG_MPA,
            poisson: 0.5,
            first_cycle_ratio: 0.1,
            follows: Coating::A,
        }
    }
}

/// `[layer]`
///
/// [DeMaria2011] trades a sharp normal pattern (thin) against a strong response to shear (thick).
/// With pairs 2.5 mm apart and the noise of this finger, a depth of 2 to 2.5 mm resolves shear and
/// contact point together best. The measure is the least Cramér–Rao bound of f_x, f_y with x, y,
/// f_z unknown too. The thicker of these spares the range of the light curve.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Layer {
    /// Depth of the facets below the skin's surface in mm.
    #[serde(deserialize_with = "ranges::thickness")]
    pub depth_mm: f64,
    /// Side of a facet in mm: the pitch less a wall of 0.6 mm, which carries the skin.
    #[serde(deserialize_with = "ranges::thickness")]
    pub facet_mm: f64,
    /// Distance from an unloaded facet to its optical pair in mm.
    ///
    /// 2 N displace a facet by up to 1.1 mm, which must not reach the peak of the light curve at
    /// 0.7 mm.
    #[serde(deserialize_with = "ranges::thickness")]
    pub gap_mm: f64,
}

impl Default for Layer {
    fn default() -> Self {
        let skin = scan_plan::finger::REFERENCE.skin;
        Self { depth_mm: skin.depth_mm, facet_mm: skin.facet_mm, gap_mm: 2.0 }
    }
}

/// `[friction]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Friction {
    /// Coulomb's coefficient of static friction.
    #[serde(deserialize_with = "ranges::friction")]
    pub mu: f64,
    /// Key of [`Friction::mu_kinetic`].
    mu_kinetic: Option<Spanned<Given>>,
}

impl Friction {
    /// Coulomb's coefficient of kinetic friction; the static one by default.
    #[must_use]
    pub fn mu_kinetic(&self) -> f64 {
        // The scene's check has already rejected values out of range.
        let given = self.mu_kinetic.as_ref().map(|mu| mu.get_ref().within(0.0, self.mu));
        given.and_then(Result::ok).unwrap_or(self.mu)
    }
}

impl Default for Friction {
    fn default() -> Self {
        Self { mu: 0.8, mu_kinetic: None }
    }
}

/// `[bench]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bench {
    /// Index of the sensor, 0 to 3.
    sensor: Spanned<Whole<0, 3>>,
    /// Standard deviation of the bench's load cell in newtons.
    ///
    /// The truth of the sensor is then the load cell's reading, as on a real bench.
    #[serde(default, deserialize_with = "ranges::reference")]
    pub reference_n: f64,
}

impl Scene {
    /// Indenter that touches the finger.
    #[must_use]
    pub fn indenter(&self) -> Indenter {
        // Fails only for keys that the scene's check has already rejected.
        self.indenter.indenter().unwrap_or(Indenter::Point)
    }

    /// Acts of the scene, in order of their beginning.
    #[must_use]
    pub fn acts(&self) -> Vec<Act> {
        Act::all(self).into_iter().map(|(_, act)| act).collect()
    }

    /// Whether `effect` is listed.
    #[must_use]
    pub fn has(&self, effect: Effect) -> bool {
        self.effects.iter().any(|listed| *listed.get_ref() == effect)
    }

    /// Range of `tolerance`.
    const TOLERANCES: [f64; 2] = [0.00001, 0.5];

    /// Error that `fidelity = "auto"` may leave, over the largest displacement of a facet; 0.01 by
    /// default.
    #[must_use]
    pub fn tolerance(&self) -> f64 {
        let [low, high] = Self::TOLERANCES;
        // The scene's check has already rejected values out of range.
        let given = self.tolerance.as_ref().map(|given| given.get_ref().within(low, high));
        given.and_then(Result::ok).unwrap_or(0.01)
    }

    /// How finely contact is computed; `auto` by default.
    #[must_use]
    pub fn fidelity(&self) -> Fidelity {
        self.fidelity.as_ref().map_or(Fidelity::Auto, |fidelity| *fidelity.get_ref())
    }

    /// Returns the scene with its contact computed at `fidelity`.
    #[must_use]
    pub fn with_fidelity(mut self, fidelity: Fidelity) -> Self {
        self.fidelity = Some(Spanned::new(0..0, fidelity));
        self
    }

    /// Returns the scene with `effect` added.
    #[must_use]
    pub fn with_effect(mut self, effect: Effect) -> Self {
        if !self.has(effect) {
            self.effects.push(Spanned::new(0..0, effect));
        }
        self
    }

    /// Whether the skin is a layer on its frame: `walls` is listed, or `fidelity = "layer"` implies
    /// it.
    #[must_use]
    pub fn has_walls(&self) -> bool {
        self.has(Effect::Walls) || self.fidelity() == Fidelity::Layer
    }

    /// Temperature ramp; `None` unless the effect `temperature` is listed.
    #[must_use]
    pub fn temperature(&self) -> Option<Temperature> {
        self.has(Effect::Temperature).then_some(self.temperature)
    }

    /// Faults of the scene, each with its time range in seconds.
    pub fn faults(&self) -> impl Iterator<Item = (Range<f64>, Broken)> + '_ {
        // The scene's check has already rejected faults for which either fails.
        self.fault.iter().filter_map(|f| f.times().ok().zip(f.broken(&self.device).ok()))
    }

    /// Index of the force sensor on the bench, if any.
    #[must_use]
    pub fn bench_sensor(&self) -> Option<usize> {
        let only = (self.device.kind == Kind::Mems3Axis).then_some(0);
        self.bench.as_ref().map(|bench| bench.sensor.get_ref().get() as usize).or(only)
    }

    /// Frames per second.
    #[must_use]
    pub fn rate_hz(&self) -> u32 {
        self.scan.rate_hz.get_ref().get()
    }

    /// Number of frames of one pass through the scene.
    #[must_use]
    pub fn frames(&self) -> u64 {
        // Both factors are bounded by their ranges; the product is below 2^31.
        (self.scan.duration_s * f64::from(self.rate_hz())).round().max(1.0) as u64
    }
}

#[cfg(test)]
mod tests;
