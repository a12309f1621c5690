//! Table `[device]` of a scene: the kind and the individual device.

use serde::{Deserialize, Deserializer};
use taxel::scan::{COLS, ROWS, SENSORS, TAXEL_CENTRES, TAXELS};
use taxel_papers::{column, feeler, line_of_four};

use super::read::Problem;
use super::{Effect, Scene};
use crate::ranges;
use crate::response::Coating;
use crate::surface::Surface;

/// `[device]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Device {
    /// System of the papers.
    pub kind: Kind,
    /// Seed of the individual device: sets its gains, offsets and mismatches.
    pub seed: u64,
    /// Resolution of the codes.
    pub bits: Bits,
    /// Whether the optical matrix of this kind is fitted.
    taxels: bool,
    /// Which of this kind's force sensors are fitted.
    bridges: [bool; SENSORS],
    /// Coating of the force sensors; with the effect `response`.
    pub coating: Coating,
    /// Surface of the fingertip on a `mems-array`.
    pub surface: Surface,
    /// Pairs on the wrong side of their light curve, because assembled too near to their facets.
    pub wrong_side: Vec<Taxel>,
}

impl Default for Device {
    fn default() -> Self {
        Self {
            kind: Kind::Taxel4x4,
            seed: 1,
            bits: Bits::Sixteen,
            taxels: true,
            bridges: [true; SENSORS],
            coating: Coating::Bare,
            surface: Surface::Plane,
            wrong_side: Vec::new(),
        }
    }
}

impl Device {
    /// Number of rows with phototransistors that see light.
    #[must_use]
    pub fn rows(&self) -> usize {
        match self.kind {
            Kind::Taxel4x4 | Kind::OhkaMicro | Kind::OhkaSheet | Kind::OhkaColumn
                if self.taxels =>
            {
                ROWS
            }
            Kind::Taxel4x1 if self.taxels => 1,
            _ => 0,
        }
    }

    /// Which force sensors exist.
    #[must_use]
    pub fn sensors(&self) -> [bool; SENSORS] {
        let of_kind = match self.kind {
            Kind::Taxel4x4 | Kind::MemsArray => [true; SENSORS],
            Kind::Mems3Axis => [true, false, false, false],
            Kind::Taxel4x1 | Kind::OhkaMicro | Kind::OhkaSheet | Kind::OhkaColumn => {
                [false; SENSORS]
            }
        };
        let mut there = self.bridges;
        there.iter_mut().zip(of_kind).for_each(|(there, has)| *there &= has);
        there
    }

    /// Centres of the facets in mm, in the order of their taxels.
    #[must_use]
    pub fn facets(&self) -> Vec<[f64; 2]> {
        match self.kind {
            Kind::Taxel4x1 => line_of_four::CENTRES.to_vec(),
            _ => TAXEL_CENTRES.map(|centre| centre.map(|mm| f64::from(mm.0))).to_vec(),
        }
    }
}

/// Kind of device: one of the papers' systems; see [`crate::systems`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum Kind {
    /// The finger of this project: 4×4 taxels, four force sensors under its plate.
    #[serde(rename = "taxel-4x4")]
    Taxel4x4,
    /// Four taxels in a row.
    #[serde(rename = "taxel-4x1")]
    Taxel4x1,
    /// One force sensor on a bench.
    #[serde(rename = "mems-3axis")]
    Mems3Axis,
    /// Four force sensors under a plate that carries a fingertip.
    #[serde(rename = "mems-array")]
    MemsArray,
    /// Matrix above one conical feeler.
    #[serde(rename = "ohka-micro")]
    OhkaMicro,
    /// Matrix above 10×12 feelers, which it reads one after the other.
    #[serde(rename = "ohka-sheet")]
    OhkaSheet,
    /// Matrix above the cones of four columns.
    #[serde(rename = "ohka-column")]
    OhkaColumn,
}

impl Kind {
    /// Largest normal force in newtons on one contact for which the laws hold; `None` without such
    /// a limit.
    #[must_use]
    pub fn most_n(self) -> Option<f64> {
        match self {
            Self::OhkaMicro => Some(feeler::LINEAR_N),
            Self::OhkaColumn => Some(column::MOST_N),
            Self::Taxel4x4
            | Self::Taxel4x1
            | Self::Mems3Axis
            | Self::MemsArray
            | Self::OhkaSheet => None,
        }
    }

    /// Names the part that `effect` needs and this kind lacks.
    fn lacks(self, effect: Effect) -> Option<&'static str> {
        let facets = matches!(self, Self::Taxel4x4 | Self::Taxel4x1);
        let light = facets || matches!(self, Self::OhkaMicro | Self::OhkaSheet | Self::OhkaColumn);
        let sensors = matches!(self, Self::Taxel4x4 | Self::Mems3Axis | Self::MemsArray);
        let (there, what) = match effect {
            Effect::Noise
            | Effect::SupplyRipple
            | Effect::Temperature
            | Effect::Nonlinearity
            | Effect::BenchError => return None,
            Effect::Ambient
            | Effect::Flicker
            | Effect::Sun
            | Effect::Settling
            | Effect::SelfHeating
            | Effect::GainSpread => (light, "phototransistors"),
            Effect::OpticalCrosstalk
            | Effect::Stiffening
            | Effect::Hysteresis
            | Effect::Creep
            | Effect::DiffuseFacet
            | Effect::SkinResponse => (facets, "facets under a skin"),
            Effect::Walls => (self == Self::Taxel4x4, "the walls of the 4×4 finger"),
            Effect::BridgeMismatch | Effect::BridgeCrosstalk | Effect::Response => {
                (sensors, "force sensors")
            }
        };
        (!there).then_some(what)
    }
}

/// Checks that everything the scene lists has a part of the device to act on.
pub(super) fn check(scene: &Scene) -> Result<(), Problem> {
    for listed in &scene.effects {
        let effect = *listed.get_ref();
        if let Some(what) = scene.device.kind.lacks(effect) {
            let problem = format!(
                "`{effect}` acts on {what}, which this `kind` of device lacks; leave it out"
            );
            return Err((listed.span(), problem));
        }
    }
    Ok(())
}

/// Resolution of the codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bits {
    /// Single conversions.
    Twelve,
    /// Means of sixteen conversions, scaled to 65535.
    Sixteen,
}

impl<'de> Deserialize<'de> for Bits {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let bits = ranges::one_of(from, &[12, 16])?;
        Ok(if bits == 12 { Self::Twelve } else { Self::Sixteen })
    }
}

/// Taxel by its row and column, `r0c0` to `r3c3`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct Taxel(usize);

impl Taxel {
    /// Index in row-major order.
    #[must_use]
    pub fn index(self) -> usize {
        self.0
    }
}

impl TryFrom<String> for Taxel {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        (0..TAXELS).find(|k| name == format!("r{}c{}", k / COLS, k % COLS)).map(Self).ok_or_else(
            || format!("no taxel `{name}`; allowed are r0c0 to r{}c{}", ROWS - 1, COLS - 1),
        )
    }
}
