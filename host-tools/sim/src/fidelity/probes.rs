//! Probes: moments of a run at which the rungs are compared.
//!
//! Every act has some, however short it is and however long the run.

use crate::load::{Contacts, Load};
use crate::path::Path;
use crate::scene::{Act, Scene, softness};

/// Number of probes on a ramp of force without motion.
const RAMP: usize = 4;
/// Distance in mm that a contact point moves between two probes.
///
/// The pattern of the facets under it changes over their pitch of 2.5 mm.
const WAY_MM: f64 = 0.25;
/// Number of presses of a row that are compared.
///
/// This many have the most normal force, this many the most shear, and this many are evenly spread.
/// A shorter row is compared at every press.
const PRESSES: u64 = 64;
/// Number of presses of a row among which the hardest are searched.
///
/// The hardest of so many draws are within a thousandth of the hardest that exist.
const DRAWS: u64 = 16_384;

/// Contacts at the probes of every act, with forces referred to the reference temperature.
///
/// Where contacts overlap, the probes of each include the others.
pub(super) fn probes(scene: &Scene, seed: u64) -> Vec<Contacts> {
    let mut path = Path::new(scene, seed);
    let mut probes: Vec<Contacts> = vec![];
    for act in scene.acts() {
        for since in moments(&act, &mut path) {
            let time = act.at_s() + since;
            // A colder skin is softer, which is the same as larger forces.
            let softer = scene.temperature().map_or(1.0, |t| softness(t.at(time)));
            let contacts = path.at(time).scaled(softer);
            if !contacts.is_empty() && probes.last() != Some(&contacts) {
                probes.push(contacts);
            }
        }
    }
    probes
}

/// Probes of the act, in seconds after its beginning.
fn moments(act: &Act, path: &mut Path) -> Vec<f64> {
    match act {
        // A hold in 24 parts has six of them on each ramp of its shear, which takes a third of it,
        // and both ends.
        Act::Press(press) => {
            parts([(press.rise_s, RAMP), (press.hold_s, 24), (press.fall_s, RAMP)])
        }
        // Tenths: under a stiff drag the contact sticks in the first and the last of them.
        Act::Slide(slide) => {
            let looks = 10 * looks(slide.from_mm, slide.to_mm).div_ceil(10).max(8);
            parts([(slide.rise_s, RAMP), (slide.travel_s, looks), (slide.fall_s, 2 * RAMP)])
        }
        Act::Tap(tap) => parts([(0.5 * tap.width_s, RAMP), (0.5 * tap.width_s, RAMP), (0.0, 0)]),
        Act::Roll(roll) => {
            let looks = looks(roll.from_mm, roll.to_mm);
            parts([(roll.rise_s, RAMP), (roll.travel_s, looks), (roll.fall_s, RAMP)])
        }
        Act::Random(_, random) => row(act, random.presses.get().into(), random.each_s, path),
        Act::Grid(grid) => row(act, grid.presses(), grid.each_s, path),
        // Columns have no facets.
        Act::Plate(_) => vec![],
    }
}

fn looks(from: [f64; 2], to: [f64; 2]) -> usize {
    ((to[0] - from[0]).hypot(to[1] - from[1]) / WAY_MM).ceil().max(1.0) as usize
}

/// Even steps in each part of an act, with their number per part.
fn parts(parts: [(f64, usize); 3]) -> Vec<f64> {
    let mut begin = 0.0;
    let mut moments = vec![];
    for (seconds, looks) in parts {
        moments.extend((1..=looks).map(|i| begin + seconds * i as f64 / looks as f64));
        begin += seconds;
    }
    moments
}

/// Tenths of each compared press of a row, in seconds.
///
/// Both kinds of row peak halfway and rest at both ends.
fn row(act: &Act, presses: u64, each_s: f64, path: &mut Path) -> Vec<f64> {
    let spread = |of: u64| {
        let of = of.min(presses);
        (0..of).map(move |i| (u128::from(i) * u128::from(presses) / u128::from(of)) as u64)
    };
    let mut compared: Vec<u64> = spread(PRESSES).collect();
    if presses > PRESSES {
        let mut drawn: Vec<(u64, Option<Load>)> = spread(DRAWS)
            .map(|press| (press, path.at(act.at_s() + (press as f64 + 0.5) * each_s).whole()))
            .collect();
        let hardness: [fn(&Load) -> f64; 2] =
            [|load| load.force[2], |load| load.force[0].hypot(load.force[1])];
        for hardness in hardness {
            let hard = |load: &Option<Load>| load.as_ref().map_or(0.0, hardness);
            drawn.sort_by(|(_, a), (_, b)| hard(b).total_cmp(&hard(a)));
            compared.extend(drawn.iter().map(|(press, _)| press).take(PRESSES as usize));
        }
        compared.sort_unstable();
        compared.dedup();
    }
    let tenths = |press: u64| (2..=8).map(move |i| (press as f64 + 0.1 * f64::from(i)) * each_s);
    compared.into_iter().flat_map(tenths).collect()
}
