//! Table `[indenter]` of a scene: the indenter that touches the finger.

use serde::Deserialize;
use toml::Spanned;

use super::read::Problem;
use crate::contact::{Axis, Indenter};
use crate::ranges::Given;

/// `[indenter]`
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Table {
    kind: Kind,
    radius_mm: Option<Spanned<Given>>,
    width_mm: Option<Spanned<Given>>,
    length_mm: Option<Spanned<Given>>,
    slope: Option<Spanned<Given>>,
    turn_deg: Option<Spanned<Given>>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Point,
    #[default]
    Sphere,
    Punch,
    Corner,
    Cylinder,
    Block,
    Edge,
}

/// Key, its default and its range.
type Allowed = (&'static str, f64, [f64; 2]);

const LENGTH: Allowed = ("length_mm", 8.0, [0.5, 10.0]);
const TURN: Allowed = ("turn_deg", 0.0, [-180.0, 180.0]);
/// Slope of a corner or an edge: Johnson's cone and wedge are blunt, with small slopes.
const SLOPE: Allowed = ("slope", 0.5, [0.05, 1.0]);

impl Kind {
    fn keys(self) -> &'static [Allowed] {
        match self {
            Self::Point => &[],
            Self::Sphere => &[("radius_mm", 6.0, [0.5, 1000.0])],
            Self::Punch => &[("radius_mm", 2.0, [0.1, 5.0])],
            Self::Corner => &[SLOPE],
            Self::Cylinder => &[("radius_mm", 6.0, [0.5, 1000.0]), LENGTH, TURN],
            Self::Block => &[("width_mm", 3.0, [0.1, 10.0]), LENGTH, TURN],
            Self::Edge => &[SLOPE, LENGTH, TURN],
        }
    }
}

impl Table {
    /// Checks the keys and returns the indenter.
    ///
    /// # Errors
    /// A key does not belong to the kind, or a value is out of its range.
    pub(super) fn indenter(&self) -> Result<Indenter, Problem> {
        let given = [
            ("radius_mm", &self.radius_mm),
            ("width_mm", &self.width_mm),
            ("length_mm", &self.length_mm),
            ("slope", &self.slope),
            ("turn_deg", &self.turn_deg),
        ];
        let keys = self.kind.keys();
        for (name, value) in given {
            let Some(value) = value else { continue };
            if !keys.iter().any(|(key, ..)| *key == name) {
                let names = keys.iter().map(|(key, ..)| format!(", `{key}`")).collect::<String>();
                let kind = format!("{:?}", self.kind).to_lowercase();
                let problem = format!(
                    "`{name}` is no key of an indenter of kind \"{kind}\"; its keys are `kind`{names}"
                );
                return Err((value.span(), problem));
            }
        }
        let value = |name: &str| {
            let Some((_, default, [low, high])) = keys.iter().find(|(key, ..)| *key == name) else {
                return Ok(0.0);
            };
            let given = given.iter().find(|(key, _)| *key == name).and_then(|(_, v)| v.as_ref());
            match given {
                None => Ok(*default),
                Some(v) => v.get_ref().within(*low, *high).map_err(|problem| (v.span(), problem)),
            }
        };
        let (radius, slope) = (value("radius_mm")?, value("slope")?);
        let width = value("width_mm")?;
        let axis = Axis { length: value("length_mm")?, turn: value("turn_deg")?.to_radians() };
        Ok(match self.kind {
            Kind::Point => Indenter::Point,
            Kind::Sphere => Indenter::Sphere { radius },
            Kind::Punch => Indenter::Punch { radius },
            Kind::Corner => Indenter::Corner { slope },
            Kind::Cylinder => Indenter::Cylinder { radius, axis },
            Kind::Block => Indenter::Block { width, axis },
            Kind::Edge => Indenter::Edge { slope, axis },
        })
    }
}
