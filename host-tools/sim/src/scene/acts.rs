//! Tables of a scene that make contact.

use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use super::read::Problem;
use super::{Grid, Plate, Scene};
use crate::contact::HalfSpace;
use crate::load::MOST_CONTACTS;
use crate::ranges::{self, Whole};

/// `[[press]]`: normal force first, shear and torsion during the hold, then release.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Press {
    /// Start in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// Contact point in mm.
    #[serde(deserialize_with = "ranges::on_pad")]
    pub x_mm: f64,
    /// Contact point in mm.
    #[serde(deserialize_with = "ranges::on_pad")]
    pub y_mm: f64,
    /// Normal force in newtons.
    #[serde(deserialize_with = "ranges::normal")]
    pub fz_n: f64,
    /// Requested shear in newtons; friction may allow less.
    #[serde(default, deserialize_with = "ranges::tangential")]
    pub fx_n: f64,
    /// Requested shear in newtons; friction may allow less.
    #[serde(default, deserialize_with = "ranges::tangential")]
    pub fy_n: f64,
    /// Requested moment about the normal in N mm, from x to y; friction may allow less.
    #[serde(default, deserialize_with = "ranges::torsion")]
    pub torsion_nmm: f64,
    /// Time to full normal force in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub rise_s: f64,
    /// Time at full normal force in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub hold_s: f64,
    /// Time of release in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub fall_s: f64,
}

/// `[[slide]]`: press down, stick, slip along a line, stick, release.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Slide {
    /// Start in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// Contact point at touch-down in mm.
    #[serde(deserialize_with = "ranges::point_on_pad")]
    pub from_mm: [f64; 2],
    /// Contact point at release in mm.
    #[serde(deserialize_with = "ranges::point_on_pad")]
    pub to_mm: [f64; 2],
    /// Normal force in newtons.
    #[serde(deserialize_with = "ranges::normal")]
    pub fz_n: f64,
    /// Time to full normal force in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub rise_s: f64,
    /// Duration of the drag in seconds.
    ///
    /// The contact sticks for a tenth of it at the beginning and at the end. With a spring, the
    /// duration is that of the stage's way from `from_mm` to `to_mm`.
    #[serde(deserialize_with = "ranges::seconds")]
    pub travel_s: f64,
    /// Time of release in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub fall_s: f64,
    /// Spring between stage and indenter; with it the indenter sticks and slips.
    pub spring: Option<Spring>,
}

/// `spring` of a `[[slide]]`, between a stage at constant speed and the indenter.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spring {
    /// Stiffness of the spring in N/mm.
    #[serde(deserialize_with = "ranges::stiffness")]
    pub stiffness_n_mm: f64,
    /// Mass that the spring drags, in grams.
    #[serde(deserialize_with = "ranges::mass")]
    pub mass_g: f64,
}

/// `[[tap]]`: half a sine of normal force.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tap {
    /// Start in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// Contact point in mm.
    #[serde(deserialize_with = "ranges::on_pad")]
    pub x_mm: f64,
    /// Contact point in mm.
    #[serde(deserialize_with = "ranges::on_pad")]
    pub y_mm: f64,
    /// Peak of the normal force in newtons.
    #[serde(deserialize_with = "ranges::normal")]
    pub fz_n: f64,
    /// Duration of the contact in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub width_s: f64,
}

/// `[[roll]]`: press down, roll along a line without slip, release.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Roll {
    /// Start in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// Contact point at touch-down in mm.
    #[serde(deserialize_with = "ranges::point_on_pad")]
    pub from_mm: [f64; 2],
    /// Contact point at release in mm.
    #[serde(deserialize_with = "ranges::point_on_pad")]
    pub to_mm: [f64; 2],
    /// Normal force in newtons.
    #[serde(deserialize_with = "ranges::normal")]
    pub fz_n: f64,
    /// Time to full normal force in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub rise_s: f64,
    /// Duration of the rolling in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub travel_s: f64,
    /// Time of release in seconds.
    #[serde(deserialize_with = "ranges::seconds")]
    pub fall_s: f64,
}

/// `[[random]]`: presses drawn from ranges, different ones for every seed of a run.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Random {
    /// Start in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub at_s: f64,
    /// Number of presses.
    pub presses: Whole<1, 1_000_000>,
    /// Duration of each press in seconds, pause included.
    #[serde(deserialize_with = "ranges::seconds")]
    pub each_s: f64,
    /// Lowest and highest x of the contact point in mm.
    #[serde(deserialize_with = "ranges::span_on_pad")]
    pub x_mm: [f64; 2],
    /// Lowest and highest y of the contact point in mm.
    #[serde(deserialize_with = "ranges::span_on_pad")]
    pub y_mm: [f64; 2],
    /// Lowest and highest of the peak normal force in newtons.
    #[serde(deserialize_with = "ranges::span_of_normals")]
    pub fz_n: [f64; 2],
    /// Lowest and highest peak of shear as a share of the friction limit; its direction turns.
    #[serde(default, deserialize_with = "ranges::span_of_shares")]
    pub shear_of_limit: [f64; 2],
    /// Longest distance in mm that the contact point rolls during a press.
    ///
    /// The contact point stays within the ranges of x and y.
    #[serde(default, deserialize_with = "ranges::roll")]
    pub roll_mm: f64,
}

/// Act of a scene: one of the tables that make contact.
#[derive(Clone, Copy, Debug)]
pub enum Act {
    /// A `[[press]]`.
    Press(Press),
    /// A `[[slide]]`.
    Slide(Slide),
    /// A `[[tap]]`.
    Tap(Tap),
    /// A `[[roll]]`.
    Roll(Roll),
    /// A `[[random]]` and its index among those of the scene.
    Random(u8, Random),
    /// A `[[grid]]`.
    Grid(Grid),
    /// A `[[plate]]`.
    Plate(Plate),
}

impl Act {
    /// Acts of a scene with their positions in its text, in order of their beginning.
    pub(super) fn all(scene: &Scene) -> Vec<(Range<usize>, Self)> {
        fn of<T: Copy>(
            table: &[Spanned<T>],
            act: impl Fn(T) -> Act,
        ) -> impl Iterator<Item = (Range<usize>, Act)> {
            table.iter().map(move |t| (t.span(), act(*t.get_ref())))
        }
        let random =
            (0..).zip(&scene.random).map(|(i, r)| (r.span(), Self::Random(i, *r.get_ref())));
        let mut acts: Vec<_> = of(&scene.press, Self::Press)
            .chain(of(&scene.slide, Self::Slide))
            .chain(of(&scene.tap, Self::Tap))
            .chain(of(&scene.roll, Self::Roll))
            .chain(random)
            .chain(of(&scene.grid, Self::Grid))
            .chain(of(&scene.plate, Self::Plate))
            .collect();
        acts.sort_by(|(_, a), (_, b)| a.at_s().total_cmp(&b.at_s()));
        acts
    }

    /// Start in seconds of the scene.
    #[must_use]
    pub fn at_s(&self) -> f64 {
        match self {
            Self::Press(press) => press.at_s,
            Self::Slide(slide) => slide.at_s,
            Self::Tap(tap) => tap.at_s,
            Self::Roll(roll) => roll.at_s,
            Self::Random(_, random) => random.at_s,
            Self::Grid(grid) => grid.at_s,
            Self::Plate(plate) => plate.at_s,
        }
    }

    /// End in seconds of the scene.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.at_s()
            + match self {
                Self::Press(press) => press.rise_s + press.hold_s + press.fall_s,
                Self::Slide(slide) => slide.rise_s + slide.travel_s + slide.fall_s,
                Self::Tap(tap) => tap.width_s,
                Self::Roll(roll) => roll.rise_s + roll.travel_s + roll.fall_s,
                Self::Random(_, random) => f64::from(random.presses.get()) * random.each_s,
                Self::Grid(grid) => grid.presses() as f64 * grid.each_s,
                Self::Plate(plate) => plate.rise_s + plate.travel_s + plate.fall_s,
            }
    }

    /// Duration of one contact in seconds, its share with contact, and advice naming the keys.
    fn touching(&self) -> (f64, f64, &'static str) {
        const PRESSED: &str = "make `rise_s`, `hold_s` and `fall_s` together";
        const MOVED: &str = "make `rise_s`, `travel_s` and `fall_s` together";
        match self {
            Self::Press(_) => (self.end_s() - self.at_s(), 1.0, PRESSED),
            Self::Slide(_) | Self::Roll(_) | Self::Plate(_) => {
                (self.end_s() - self.at_s(), 1.0, MOVED)
            }
            Self::Tap(tap) => (tap.width_s, 1.0, "make `width_s`"),
            // Both kinds rest for a tenth at both ends.
            Self::Random(_, random) => (random.each_s, 0.8, "make `each_s`"),
            Self::Grid(grid) => (grid.each_s, 0.8, "make `each_s`"),
        }
    }

    /// Largest normal force in newtons, and both ends of the contact point's path in mm.
    pub(super) fn reach(&self) -> (f64, [[f64; 2]; 2]) {
        match self {
            Self::Press(press) => (press.fz_n, [[press.x_mm, press.y_mm]; 2]),
            Self::Slide(slide) => (slide.fz_n, [slide.from_mm, slide.to_mm]),
            Self::Tap(tap) => (tap.fz_n, [[tap.x_mm, tap.y_mm]; 2]),
            Self::Roll(roll) => (roll.fz_n, [roll.from_mm, roll.to_mm]),
            Self::Random(_, random) => {
                let ([x0, x1], [y0, y1]) = (random.x_mm, random.y_mm);
                (random.fz_n.into_iter().fold(0.0, f64::max), [[x0, y0], [x1, y1]])
            }
            Self::Grid(grid) => {
                let ([x0, x1], [y0, y1]) = (grid.x_mm, grid.y_mm);
                (grid.force_n, [[x0, y0], [x1, y1]])
            }
            Self::Plate(plate) => (plate.fz_n, [[0.0; 2]; 2]),
        }
    }
}

/// Checks that all acts end with the scene.
///
/// Acts that overlap in time must be few and far enough apart.
pub(super) fn check(scene: &Scene) -> Result<(), Problem> {
    // Sums of decimal fractions are a few units in the last place off.
    const SLACK: f64 = 1e-9;
    // Shortest contact in scan periods. Within one period both scans may fall on the ends, where
    // nothing presses.
    const SCANS: f64 = 2.0;
    let skin = HalfSpace::new(scene.material.young_mpa, scene.material.poisson);
    let indenter = scene.indenter();
    let reach = |normal| indenter.reach(&skin, normal);
    let mut running: Vec<Act> = vec![];
    for (span, act) in Act::all(scene) {
        if act.end_s() > scene.scan.duration_s + SLACK {
            let (end, duration) = (seconds(act.end_s()), scene.scan.duration_s);
            let problem = format!(
                "ends at {end} s but the scene at `duration_s` {duration} s; let it begin earlier or be \
                 shorter, or make `duration_s` at least {end}"
            );
            return Err((span, problem));
        }
        let (touching, share, keys) = act.touching();
        let least = SCANS / f64::from(scene.rate_hz());
        if share * touching < least - SLACK {
            let problem = format!(
                "touches for {} s, which scans at {} Hz may not see; {keys} at least {} s, or scan faster",
                seconds(share * touching),
                scene.rate_hz(),
                (least / share * 1e6).ceil() / 1e6
            );
            return Err((span, problem));
        }
        running.retain(|other| other.end_s() > act.at_s() + SLACK);
        for other in &running {
            let (begin, until) = (seconds(act.at_s()), seconds(other.end_s()));
            let alone = |act: &Act| matches!(act, Act::Random(..) | Act::Grid(_) | Act::Plate(_));
            if alone(&act) || alone(other) {
                let problem = format!(
                    "begins at {begin} s while another contact lasts until {until} s; [[random]], \
                     [[grid]] and [[plate]] are alone: let it begin at {until} s or later"
                );
                return Err((span, problem));
            }
            let ((force, way), (others, other_way)) = (act.reach(), other.reach());
            let (needed, there) = (reach(force) + reach(others), distance(way, other_way));
            if there < needed {
                let problem = format!(
                    "comes within {there:.2} mm of the contact that lasts until {until} s, and their \
                     areas reach {needed:.2} mm; move them apart or let one end first"
                );
                return Err((span, problem));
            }
        }
        running.push(act);
        if running.len() > MOST_CONTACTS {
            let problem = format!(
                "is contact number {} at {} s; allowed are {MOST_CONTACTS} at once",
                running.len(),
                seconds(act.at_s())
            );
            return Err((span, problem));
        }
    }
    Ok(())
}

/// Rounds a sum of decimal fractions to microseconds, because the last places hold rounding errors.
fn seconds(sum: f64) -> f64 {
    (sum * 1e6).round() / 1e6
}

/// Smallest distance between two straight paths.
fn distance(one: [[f64; 2]; 2], other: [[f64; 2]; 2]) -> f64 {
    let ([a, b], [c, d]) = (one, other);
    let side = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
        (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    };
    if side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0 {
        return 0.0;
    }
    // Paths that do not cross are closest at an end of one of them.
    let from = |p: [f64; 2], [q, r]: [[f64; 2]; 2]| {
        let [along_x, along_y] = [r[0] - q[0], r[1] - q[1]];
        let square = along_x * along_x + along_y * along_y;
        let foot = (p[0] - q[0]) * along_x + (p[1] - q[1]) * along_y;
        let t = if square > 0.0 { (foot / square).clamp(0.0, 1.0) } else { 0.0 };
        (p[0] - q[0] - t * along_x).hypot(p[1] - q[1] - t * along_y)
    };
    [from(a, other), from(b, other), from(c, one), from(d, one)]
        .into_iter()
        .fold(f64::MAX, f64::min)
}
