//! Tables of a scene that repeat an experiment of the papers.

use serde::Deserialize;
use taxel_papers::column::{self, CENTRES, COLUMNS, MOST_N, PITCH_MM, SPRING, TIP_MM};
use taxel_papers::feeler::LINEAR_N;
use taxel_papers::sheet::{FEELERS, centre};

use super::read::Problem;
use super::{Act, Kind, Scene};
use crate::contact::HalfSpace;
use crate::load::Load;
use crate::ranges::{self, Whole};
use crate::sheet::Sheet;

/// `[[grid]]`: presses on a grid, each at a series of angles, as in [DeMaria2011]'s trials.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Start in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// Duration of each press in seconds, pause included.
    #[serde(deserialize_with = "ranges::seconds")]
    pub each_s: f64,
    /// First and last x of the contact point in mm.
    #[serde(deserialize_with = "ranges::span_on_pad")]
    pub x_mm: [f64; 2],
    /// Number of contact points along x.
    pub columns: Whole<1, 1000>,
    /// First and last y of the contact point in mm.
    #[serde(deserialize_with = "ranges::span_on_pad")]
    pub y_mm: [f64; 2],
    /// Number of contact points along y.
    pub rows: Whole<1, 1000>,
    /// Magnitude of the force in newtons.
    #[serde(deserialize_with = "ranges::normal")]
    pub force_n: f64,
    /// First and last angle between force and skin in degrees, in the plane of x and z.
    ///
    /// 90 is the normal; a smaller angle leans to +x.
    #[serde(default = "Grid::normal", deserialize_with = "ranges::span_of_angles")]
    pub angle_deg: [f64; 2],
    /// Number of angles.
    #[serde(default = "Grid::one")]
    pub angles: Whole<1, 1000>,
}

impl Grid {
    fn normal() -> [f64; 2] {
        [90.0; 2]
    }

    fn one() -> Whole<1, 1000> {
        Whole::nearest(1)
    }

    /// Number of presses.
    #[must_use]
    pub fn presses(&self) -> u64 {
        [self.columns, self.rows, self.angles].into_iter().fold(1, |n, of| n * u64::from(of.get()))
    }
}

/// `[[plate]]`: a rigid plate on all four columns of an `ohka-column` ([Ohka2004] §5 and §6).
///
/// A robot holds the plate at one height and attitude.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plate {
    /// Start in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// Normal force in newtons of the plate if it were flat and before its step.
    #[serde(deserialize_with = "ranges::normal")]
    pub fz_n: f64,
    /// Inclination in degrees; positive presses harder at +x.
    #[serde(default, deserialize_with = "ranges::incline")]
    pub incline_deg: f64,
    /// Height in mm of the step that comes from +x; a negative step goes down.
    #[serde(default, deserialize_with = "ranges::step")]
    pub step_mm: f64,
    /// Whether the plate rubs along the columns, to −x, while it travels.
    #[serde(default)]
    pub rubs: bool,
    /// Time to full force in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub rise_s: f64,
    /// Duration in seconds of the step's way across all columns, from +x to −x.
    #[serde(deserialize_with = "ranges::seconds")]
    pub travel_s: f64,
    /// Time of release in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub fall_s: f64,
}

impl Plate {
    /// Largest force that a column carries under the plate, in newtons.
    #[must_use]
    pub fn most_n(&self) -> f64 {
        let lean = self.incline_deg.to_radians().tan().abs() * 0.5 * PITCH_MM;
        self.fz_n / COLUMNS as f64 + SPRING * (lean + self.step_mm.max(0.0))
    }
}

impl Scene {
    /// Sheet of feelers of an `ohka-sheet`.
    #[must_use]
    pub fn sheet(&self) -> Sheet {
        let rubber = HalfSpace::new(self.material.young_mpa, self.material.poisson);
        Sheet::new(self.indenter(), rubber, self.friction.mu)
    }
}

/// Checks that the device's laws hold for the acts.
pub(super) fn check(scene: &Scene) -> Result<(), Problem> {
    let kind = scene.device.kind;
    let mut before: Vec<Act> = vec![];
    for (span, act) in Act::all(scene) {
        if matches!(act, Act::Plate(_)) && kind != Kind::OhkaColumn {
            let problem = "a plate needs columns; write `kind = \"ohka-column\"` in [device]";
            return Err((span, problem.into()));
        }
        let (reached, way) = act.reach();
        let normal = if let Act::Plate(plate) = act { plate.most_n() } else { reached };
        if let Some(most) = kind.most_n()
            && normal > most
        {
            let problem =
                format!("{normal:.4} N on a contact; the laws of this device hold up to {most} N");
            return Err((span, problem));
        }
        if matches!(kind, Kind::OhkaMicro | Kind::Mems3Axis) && way != [[0.0; 2]; 2] {
            let what = if kind == Kind::OhkaMicro { "feeler" } else { "force sensor" };
            let problem =
                format!("this device is one {what}, at 0, 0; put every contact point there");
            return Err((span, problem));
        }
        if kind == Kind::OhkaSheet {
            on_sheet(scene, &act).map_err(|problem| (span.clone(), problem))?;
        }
        if kind == Kind::OhkaColumn {
            on_columns(&act, &before).map_err(|problem| (span.clone(), problem))?;
            before.push(act);
        }
    }
    Ok(())
}

/// Checks that an act stays on the tip of one column, within its law's range of force.
///
/// Loads of the acts `before` that have not ended count too.
fn on_columns(act: &Act, before: &[Act]) -> Result<(), String> {
    if matches!(act, Act::Plate(_)) {
        return Ok(());
    }
    if !matches!(act, Act::Press(_) | Act::Tap(_)) {
        return Err(
            "columns take [[press]], [[tap]] and [[plate]]; a contact cannot move from one to \
                    another"
                .into(),
        );
    }
    let column = |act: &Act| column::below(act.reach().1[0]);
    let Some(on) = column(act) else {
        let [x, y] = act.reach().1[0];
        return Err(format!(
            "is at {x}, {y} mm, where no column is; their tips are at {} mm and {TIP_MM} mm in radius",
            CENTRES.map(|[x, y]| format!("{x}, {y}")).join(" or ")
        ));
    };
    let still =
        before.iter().filter(|other| other.end_s() > act.at_s() && column(other) == Some(on));
    let (others, until) = still.fold((0.0, 0.0f64), |(sum, until), other| {
        (sum + other.reach().0, until.max(other.end_s()))
    });
    let sum = act.reach().0 + others;
    if others > 0.0 && sum > MOST_N {
        return Err(format!(
            "brings the force on its column to {sum:.4} N, with contacts until {until} s; the laws of this \
             device hold up to {MOST_N} N: press with {:.4} N at most, or begin when the others have ended",
            (MOST_N - others).max(0.0)
        ));
    }
    Ok(())
}

/// Checks that the sheet carries the whole contact, and no feeler more than its law allows.
fn on_sheet(scene: &Scene, act: &Act) -> Result<(), String> {
    const STEPS: u32 = 16;
    if !matches!(act, Act::Press(_) | Act::Tap(_) | Act::Roll(_) | Act::Slide(_)) {
        return Err("the sheet takes [[press]], [[tap]], [[roll]] and [[slide]]".into());
    }
    let sheet = scene.sheet();
    let (normal, [from, to]) = act.reach();
    let steps = if from == to { 0 } else { STEPS };
    for step in 0..=steps {
        let done = f64::from(step) / f64::from(STEPS);
        let point = [0, 1].map(|axis: usize| from[axis] + (to[axis] - from[axis]) * done);
        let contacts = Load { point, force: [0.0, 0.0, normal], ..Load::default() }.into();
        let carried = (0..FEELERS).map(|feeler| sheet.carried(feeler, &contacts)[2]);
        let (sum, most) = carried.fold((0.0, 0.0f64), |(sum, most), n| (sum + n, most.max(n)));
        if sum < 0.999_999 * normal {
            let [[x, y], [edge_x, edge_y]] = [point, centre(FEELERS - 1)];
            return Err(format!(
                "with its middle at {x:.2}, {y:.2} mm the contact goes beyond the outer feelers at \
                 ±{edge_x:.1}, ±{edge_y:.1} mm; move it inwards, press less or take a smaller indenter"
            ));
        }
        if most > LINEAR_N {
            return Err(format!(
                "a feeler would carry {most:.4} N; its law holds up to {LINEAR_N} N: press less or take \
                 a wider indenter"
            ));
        }
    }
    Ok(())
}
