//! Scenes: TOML files that say what to simulate. The unit of a number is in its key's name; what is
//! left out has a default; what is misspelt, out of range or contradictory is an error with its line.

use std::fmt;
use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use crate::contact::{Indenter, SILICONE_YOUNG_MPA};
use crate::ranges::{self, Given, Whole};
use crate::response::Coating;

mod acts;
mod catalogue;
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
pub use device::{Bits, Device, Kind, Taxel};
pub use electronics::Electronics;
pub use fault::{Broken, Fault, Place};
pub use fidelity::Fidelity;
pub use light::Light;
pub use temperature::{REFERENCE_C, Temperature, ZERO_C, softness};
pub use trials::{Grid, Plate};

/// What a scene may list under `effects`; the rest is not computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Effect {
    /// Shot noise of the phototransistors and noise of the converter.
    Noise,
    /// Light of the room that reaches the phototransistors, steady part.
    Ambient,
    /// Light of the room that swings with the mains.
    Flicker,
    /// The sun comes out in the middle of the scene.
    Sun,
    /// The phototransistors need time to follow the light, so that a reading still holds some of the
    /// row before.
    Settling,
    /// The supply swings.
    SupplyRipple,
    /// Every optical pair has its own gain and gap, every column its own offset.
    GainSpread,
    /// Light spills between neighbouring pairs.
    OpticalCrosstalk,
    /// The resistors of a bridge differ, so that it does not rest at zero.
    BridgeMismatch,
    /// Sensitivities of the force sensors differ and their axes mix.
    BridgeCrosstalk,
    /// The skin is a layer bonded to a rigid frame with a window open under each facet, and not a
    /// half-space.
    Walls,
    /// The skin stiffens under large strain.
    Stiffening,
    /// The skin is stiffer when it is loaded as never before.
    Hysteresis,
    /// The facets follow with a delay, and relax, as the skin's `follows` does.
    SkinResponse,
    /// The force sensors follow with a delay, and relax, as their `coating` does.
    Response,
    /// What warms changes: the finger is as warm as `[temperature]` says and not at its reference.
    Temperature,
}

/// As a scene writes it.
impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, letter) in format!("{self:?}").char_indices() {
            let hyphen = if i > 0 && letter.is_uppercase() { "-" } else { "" };
            write!(f, "{hyphen}{}", letter.to_ascii_lowercase())?;
        }
        Ok(())
    }
}

/// A scene.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// One line for people.
    #[serde(default)]
    pub description: String,
    /// What to model beyond the ideal finger.
    #[serde(default)]
    pub effects: Vec<Spanned<Effect>>,
    /// How finely contact is computed; [`Scene::fidelity`].
    fidelity: Option<Spanned<Fidelity>>,
    /// [`Scene::tolerance`].
    tolerance: Option<Spanned<Given>>,
    /// When to sample.
    pub scan: Scan,
    /// The finger.
    #[serde(default)]
    pub device: Device,
    /// Its skin.
    #[serde(default)]
    pub material: Material,
    /// Its deformable layer.
    #[serde(default)]
    pub layer: Layer,
    /// What touches it; [`Scene::indenter`].
    #[serde(default)]
    indenter: indenter::Table,
    /// How it clings.
    #[serde(default)]
    pub friction: Friction,
    /// The room.
    #[serde(default)]
    pub light: Light,
    /// What stands between a photocurrent or a bridge and its code.
    #[serde(default)]
    pub electronics: Electronics,
    /// How warm it is; [`Scene::temperature`].
    #[serde(default)]
    temperature: Temperature,
    /// Present where the force acts on a single force sensor in a test bench, not on the skin.
    pub bench: Option<Bench>,
    /// Presses at one place.
    #[serde(default)]
    pub press: Vec<Spanned<Press>>,
    /// Slides over the skin.
    #[serde(default)]
    pub slide: Vec<Spanned<Slide>>,
    /// Taps at one place.
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
    /// What breaks, and when.
    #[serde(default)]
    fault: Vec<Fault>,
}

/// `[scan]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scan {
    /// Frames a second, 1 to 20000.
    rate_hz: Spanned<Whole<1, 20_000>>,
    /// Length of the scene in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub duration_s: f64,
    /// Time of each of the five steps (dark, row 0 … row 3) of a frame in microseconds.
    #[serde(default = "Scan::usual_step")]
    step_us: Spanned<Whole<1, 200_000>>,
}

impl Scan {
    /// Settling of the phototransistors to 12 bits is 26.5 µs; five such steps fit into 4 kHz.
    fn usual_step() -> Spanned<Whole<1, 200_000>> {
        Spanned::new(0..0, Whole::nearest(30))
    }

    /// Time of each of the five steps in microseconds.
    #[must_use]
    pub fn step_us(&self) -> u32 {
        self.step_us.get_ref().get()
    }
}

/// `[material]`, the silicone of [DeMaria2011] unless said otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Material {
    /// Young's modulus in MPa.
    #[serde(deserialize_with = "ranges::young")]
    pub young_mpa: f64,
    /// Poisson's ratio.
    #[serde(deserialize_with = "ranges::poisson")]
    pub poisson: f64,
    /// Share of its stiffness that the first cycle takes from the skin; with the effect `hysteresis`. [DeMaria2011]
    /// shows such a cycle (fig. 3) and prints no figure.
    #[serde(deserialize_with = "ranges::first_cycle")]
    pub first_cycle_ratio: f64,
    /// What the skin follows like; with the effect `skin-response`. [DeMaria2011] measures none; [Ospina2017]'s
    /// softest
    /// coating is next to it.
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
/// [DeMaria2011] trades a sharp normal pattern (thin) against a strong response to shear (thick). With pairs
/// 2.5 mm apart and the noise of this finger, shear and place together are resolved best (least
/// Cramér–Rao bound of f_x, f_y beside x, y, f_z) at a depth of 2 to 2.5 mm; the thicker of these spares
/// the range of the light curve.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Layer {
    /// Skin to facets in mm.
    #[serde(deserialize_with = "ranges::thickness")]
    pub depth_mm: f64,
    /// Side of a facet in mm: the pitch less a wall of 0.6 mm, which carries the skin.
    #[serde(deserialize_with = "ranges::thickness")]
    pub facet_mm: f64,
    /// Facet to optical pair, unloaded, in mm: 2 N displace a facet by up to 1.1 mm and must not reach the
    /// peak of the light curve at 0.7 mm.
    #[serde(deserialize_with = "ranges::thickness")]
    pub gap_mm: f64,
}

impl Default for Layer {
    fn default() -> Self {
        Self { depth_mm: 2.5, facet_mm: 1.9, gap_mm: 2.0 }
    }
}

/// `[friction]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Friction {
    /// Coulomb's coefficient of what sticks.
    #[serde(deserialize_with = "ranges::friction")]
    pub mu: f64,
    /// Of what slips; the same unless said otherwise.
    mu_kinetic: Option<Spanned<Given>>,
}

impl Friction {
    /// Coulomb's coefficient of what slips.
    #[must_use]
    pub fn mu_kinetic(&self) -> f64 {
        // Refused out of its range when the scene was checked.
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
    /// Number of the sensor, 0 to 3.
    sensor: Spanned<Whole<0, 3>>,
    /// Standard deviation of its load cell in newtons. The truth of its sensor is then what that reads, as
    /// on a real bench.
    #[serde(default, deserialize_with = "ranges::reference")]
    pub reference_n: f64,
}

impl Scene {
    /// What touches the finger.
    #[must_use]
    pub fn indenter(&self) -> Indenter {
        // Refused only for keys that the scene's check has refused before.
        self.indenter.indenter().unwrap_or(Indenter::Point)
    }

    /// What happens, the first to begin first.
    #[must_use]
    pub fn acts(&self) -> Vec<Act> {
        Act::all(self).into_iter().map(|(_, act)| act).collect()
    }

    /// The effect is to be modelled.
    #[must_use]
    pub fn has(&self, effect: Effect) -> bool {
        self.effects.iter().any(|listed| *listed.get_ref() == effect)
    }

    /// What `tolerance` may be.
    const TOLERANCES: [f64; 2] = [0.00001, 0.5];

    /// Error that `fidelity = "auto"` may leave, as a share of the largest displacement of a facet; 1 % unless
    /// said otherwise.
    #[must_use]
    pub fn tolerance(&self) -> f64 {
        let [low, high] = Self::TOLERANCES;
        // Refused out of its range when the scene was checked.
        let given = self.tolerance.as_ref().map(|given| given.get_ref().within(low, high));
        given.and_then(Result::ok).unwrap_or(0.01)
    }

    /// How finely contact is computed.
    #[must_use]
    pub fn fidelity(&self) -> Fidelity {
        self.fidelity.as_ref().map_or(Fidelity::Auto, |fidelity| *fidelity.get_ref())
    }

    /// The same scene with its contact computed as `fidelity` says.
    #[must_use]
    pub fn with_fidelity(mut self, fidelity: Fidelity) -> Self {
        self.fidelity = Some(Spanned::new(0..0, fidelity));
        self
    }

    /// The same scene with one more effect.
    #[must_use]
    pub fn with_effect(mut self, effect: Effect) -> Self {
        if !self.has(effect) {
            self.effects.push(Spanned::new(0..0, effect));
        }
        self
    }

    /// The skin is a layer on its frame: the effect is listed, or the rung is the one that implies it.
    #[must_use]
    pub fn has_walls(&self) -> bool {
        self.has(Effect::Walls) || self.fidelity() == Fidelity::Layer
    }

    /// The ramp of its warmth, where it is listed.
    #[must_use]
    pub fn temperature(&self) -> Option<Temperature> {
        self.has(Effect::Temperature).then_some(self.temperature)
    }

    /// What breaks, and from when to when in seconds.
    pub fn faults(&self) -> impl Iterator<Item = (Range<f64>, Broken)> + '_ {
        // Both were asked when the scene was checked.
        self.fault.iter().filter_map(|f| f.times().ok().zip(f.broken(&self.device).ok()))
    }

    /// The force sensor that is on a bench.
    #[must_use]
    pub fn bench_sensor(&self) -> Option<usize> {
        let only = (self.device.kind == Kind::Mems3Axis).then_some(0);
        self.bench.as_ref().map(|bench| bench.sensor.get_ref().get() as usize).or(only)
    }

    /// Frames a second.
    #[must_use]
    pub fn rate_hz(&self) -> u32 {
        self.scan.rate_hz.get_ref().get()
    }

    /// Frames of one pass.
    #[must_use]
    pub fn frames(&self) -> u64 {
        // Both factors are bounded by their ranges; the product is below 2^31.
        (self.scan.duration_s * f64::from(self.rate_hz())).round().max(1.0) as u64
    }
}

#[cfg(test)]
mod tests;
