//! Scenes: TOML files that say what to simulate. The unit of a number is in its key's name; what is
//! left out has a default; what is misspelt, out of range or contradictory is an error with its line.

use std::ops::Range;
use std::path::Path;

use serde::Deserialize;
use taxel_formats::FileError;
use toml::Spanned;

use crate::contact::{Indenter, SILICONE_YOUNG_MPA, layer};
use crate::fidelity::Fidelity;
use crate::ranges;
use crate::response::Coating;

mod acts;
mod catalogue;
mod device;
mod electronics;
mod fault;
mod indenter;
mod light;
mod temperature;
mod trials;

pub use acts::{Act, MOST_CONTACTS, Press, Random, Roll, Slide, Spring, Tap};
pub use catalogue::BUILT_IN;
pub use device::{Bits, Device, Kind, Taxel};
pub use electronics::Electronics;
pub use fault::{Broken, Fault, Place};
pub use light::Light;
pub use temperature::{REFERENCE_C, Temperature, ZERO_C};
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
    /// Error that `fidelity = "auto"` may leave, as a share of the largest displacement of a facet.
    #[serde(default = "Scene::one_percent", deserialize_with = "ranges::tolerance")]
    pub tolerance: f64,
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
    pub rate_hz: Spanned<u32>,
    /// Length of the scene in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub duration_s: f64,
    /// Time of each of the five steps (dark, row 0 … row 3) of a frame in microseconds.
    #[serde(default = "Scan::step_us")]
    pub step_us: u32,
}

impl Scan {
    /// Settling of the phototransistors to 12 bits is 26.5 µs; five such steps fit into 4 kHz.
    fn step_us() -> u32 {
        30
    }
}

/// `[material]`, the silicone of 002 unless said otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Material {
    /// Young's modulus in MPa.
    #[serde(deserialize_with = "ranges::young")]
    pub young_mpa: f64,
    /// Poisson's ratio.
    #[serde(deserialize_with = "ranges::poisson")]
    pub poisson: f64,
    /// Share of its stiffness that the first cycle takes from the skin; with the effect `hysteresis`. 002
    /// shows such a cycle (fig. 3) and prints no figure.
    #[serde(deserialize_with = "ranges::first_cycle")]
    pub first_cycle_ratio: f64,
    /// What the skin follows like; with the effect `skin-response`. 002 measures none; 003's softest
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
/// 002 trades a sharp normal pattern (thin) against a strong response to shear (thick). With pairs
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
    mu_kinetic: Option<Spanned<f64>>,
}

impl Friction {
    /// Coulomb's coefficient of what slips.
    #[must_use]
    pub fn mu_kinetic(&self) -> f64 {
        self.mu_kinetic.as_ref().map_or(self.mu, |mu| *mu.get_ref())
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
    pub sensor: Spanned<usize>,
    /// Standard deviation of its load cell in newtons. The truth of its sensor is then what that reads, as
    /// on a real bench.
    #[serde(default, deserialize_with = "ranges::reference")]
    pub reference_n: f64,
}

impl Scene {
    /// A built-in scene by its name, or a file by its path.
    ///
    /// # Errors
    /// What is wrong with it, in one line.
    pub fn load(name_or_path: &str) -> Result<Self, FileError> {
        if let Some((name, text)) = BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            return Self::parse(format!("{name}.toml"), text);
        }
        let text = std::fs::read_to_string(name_or_path).map_err(|error| {
            if error.kind() == std::io::ErrorKind::NotFound {
                FileError::new(name_or_path, "no such scene").mend(
                    "give a path to a TOML file, or a name that `taxel simulate --list` shows",
                )
            } else {
                FileError::io(name_or_path, &error)
            }
        })?;
        Self::parse(name_or_path, &text)
    }

    /// A scene from its text; `path` is for errors.
    ///
    /// # Errors
    /// What is wrong with it, in one line.
    pub fn parse(path: impl AsRef<Path>, text: &str) -> Result<Self, FileError> {
        let error = |at: Option<Range<usize>>, problem: String| {
            let error = FileError::new(&path, problem);
            let Some(at) = at else { return error };
            let before = text.get(..at.start).unwrap_or(text);
            let error = error.line(1 + before.matches('\n').count() as u64);
            match key_at(text, at.start) {
                Some(key) => error.column(key),
                None => error,
            }
        };
        let scene: Self =
            toml::from_str(text).map_err(|e| error(e.span(), e.message().to_owned()))?;
        scene.check().map_err(|(at, problem)| error(Some(at), problem))?;
        Ok(scene)
    }

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

    fn one_percent() -> f64 {
        0.01
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
        self.bench.as_ref().map(|bench| *bench.sensor.get_ref()).or(only)
    }

    /// Frames a second.
    #[must_use]
    pub fn rate_hz(&self) -> u32 {
        *self.scan.rate_hz.get_ref()
    }

    /// Frames of one pass.
    #[must_use]
    pub fn frames(&self) -> u64 {
        // Both factors are bounded by their ranges; the product is below 2^31.
        (self.scan.duration_s * f64::from(self.rate_hz())).round().max(1.0) as u64
    }

    /// What no single value can show.
    fn check(&self) -> Result<(), (Range<usize>, String)> {
        let rate = &self.scan.rate_hz;
        if !(1..=20_000).contains(rate.get_ref()) {
            let problem = format!("{} is out of range; allowed are 1 to 20000", rate.get_ref());
            return Err((rate.span(), problem));
        }
        let steps = 5 * u64::from(self.scan.step_us);
        let period = 1_000_000 / u64::from(*rate.get_ref());
        if steps > period {
            let problem = format!(
                "a frame lasts {period} µs but its five steps of `step_us` {} µs last {steps} µs",
                self.scan.step_us
            );
            return Err((rate.span(), problem));
        }
        let sampled = self.sampling_us();
        if sampled >= f64::from(self.scan.step_us) {
            let problem = format!(
                "{} conversions of a reading last {sampled} µs, but its step `step_us` {} µs",
                self.oversampling(),
                self.scan.step_us
            );
            let at = self.electronics.oversampling.as_ref().map_or(rate.span(), Spanned::span);
            return Err((at, problem));
        }
        if let Some(bench) = &self.bench
            && !self.device.sensors().get(*bench.sensor.get_ref()).is_some_and(|there| *there)
        {
            let problem = format!(
                "the device has no sensor {}; allowed are 0 to 3, those that its kind has and `bridges` \
                 leaves",
                bench.sensor.get_ref()
            );
            return Err((bench.sensor.span(), problem));
        }
        for fault in &self.fault {
            fault.times()?;
            fault.broken(&self.device)?;
        }
        if let Some(kinetic) = &self.friction.mu_kinetic
            && !(0.0..=self.friction.mu).contains(kinetic.get_ref())
        {
            let problem = format!(
                "{} is out of range; allowed are 0 to `mu` {}",
                kinetic.get_ref(),
                self.friction.mu
            );
            return Err((kinetic.span(), problem));
        }
        self.indenter.indenter()?;
        device::check(self)?;
        self.check_walls()?;
        acts::check(self)?;
        trials::check(self)
    }

    /// The framed layer has its limits.
    fn check_walls(&self) -> Result<(), (Range<usize>, String)> {
        let listed = self.effects.iter().find(|effect| *effect.get_ref() == Effect::Walls);
        let named = self.fidelity.as_ref().filter(|f| *f.get_ref() == Fidelity::Layer);
        let Some(at) = listed.map(Spanned::span).or(named.map(Spanned::span)) else {
            return Ok(());
        };
        if self.device.kind != Kind::Taxel4x4 {
            let problem = "the layer is that of the 4×4 finger; leave `fidelity` out";
            return Err((at, problem.into()));
        }
        let ([thin, thick], widest) = (layer::Layer::THICKNESS_MM, layer::Layer::WIDEST_FACET_MM);
        let Layer { depth_mm, facet_mm, .. } = self.layer;
        if (thin..=thick).contains(&depth_mm) && facet_mm <= widest {
            return Ok(());
        }
        let problem = format!(
            "walls between facets of `facet_mm` {facet_mm} under `depth_mm` {depth_mm}; allowed are \
             {thin} to {thick} for `depth_mm` and up to {widest} for `facet_mm`"
        );
        Err((at, problem))
    }
}

/// The key, or the table, on the line that holds byte `at`.
fn key_at(text: &str, at: usize) -> Option<&str> {
    let begin = text.get(..at)?.rfind('\n').map_or(0, |newline| newline + 1);
    let line = text.get(begin..)?.lines().next()?;
    let key = line.split(['=', '#']).next()?.trim();
    (!key.is_empty()).then_some(key)
}

#[cfg(test)]
mod tests;
