//! Cost and error of each rung of the fidelity ladder: `simulator.csv`.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use taxel_files::FileError;

use crate::fidelity::{Ladder, Rung, error};
use crate::load::Contacts;
use crate::path::Path;
use crate::scene::Fidelity;
use crate::{Effect, Scene, Simulator};

/// Cost of one rung on one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Cost {
    /// Name of the scene.
    pub scene: &'static str,
    /// The rung.
    pub rung: Rung,
    /// Worst error of a facet over the scene's contacts, relative to the contact's largest
    /// displacement.
    ///
    /// The reference is the top rung.
    pub error: f64,
    /// Mean time of a frame in contact in µs, on one core: contact, light, electronics and noise.
    pub us_per_frame: f64,
    /// Whether `auto` takes this rung.
    pub auto: bool,
}

const SEED: u64 = 1;
/// Number of a scene's contacts at which errors are measured.
const CONTACTS: usize = 200;
/// Number of frames in contact that are timed.
const FRAMES: usize = 1000;
/// Number of runs; the fastest counts for each frame, because other work disturbs the rest.
const RUNS: usize = 5;

/// Charted scenes: a contact at rest, many that slip, and one on the framed layer.
///
/// # Errors
/// A scene fails to load, as in [`Scene::load`].
pub fn scenes() -> Result<[(&'static str, Scene); 3], FileError> {
    let press = Scene::load("press")?;
    let walls = press.clone().with_effect(Effect::Walls);
    Ok([("press", press), ("shear", Scene::load("shear")?), ("press with walls", walls)])
}

/// Measures every rung on each of the [`scenes`], which takes half a minute.
///
/// # Errors
/// A scene fails to load, as in [`scenes`].
pub fn measure() -> Result<Vec<Cost>, FileError> {
    let mut costs = vec![];
    for (name, scene) in scenes()? {
        for (rung, error, auto) in errors(&scene) {
            let us_per_frame = us_per_frame(&scene.clone().with_fidelity(rung.into()));
            costs.push(Cost { scene: name, rung, error, us_per_frame, auto });
        }
    }
    Ok(costs)
}

/// Table of the chart as CSV: `scene,rung,error,us_per_frame`.
#[must_use]
pub fn csv(costs: &[Cost]) -> String {
    let mut table = String::from("scene,rung,error,us_per_frame\n");
    for Cost { scene, rung, error, us_per_frame, .. } in costs {
        // Writing into a string cannot fail.
        let _ = writeln!(table, "{scene},{rung},{error:.2e},{us_per_frame:.2}");
    }
    table
}

/// Rungs of the scene's physics, each with its error and whether `auto` takes it.
fn errors(scene: &Scene) -> Vec<(Rung, f64, bool)> {
    let ladder = Ladder::new(&scene.clone().with_fidelity(Fidelity::Auto), SEED);
    let report = ladder.report();
    let rungs = Rung::ALL.into_iter().filter(|rung| *rung <= report.top);
    let mut errors: Vec<_> = rungs.map(|rung| (rung, 0.0, rung == report.rung)).collect();
    for contacts in contacts(scene) {
        let best = ladder.on_rung(report.top, &contacts);
        for (rung, worst, _) in &mut errors {
            *worst = error(&ladder.on_rung(*rung, &contacts), &best).max(*worst);
        }
    }
    errors
}

/// Contacts of a scene, evenly spread over all of them.
fn contacts(scene: &Scene) -> Vec<Contacts> {
    let mut path = Path::new(scene, SEED);
    let all: Vec<Contacts> = (0..scene.frames())
        .map(|frame| path.at(frame as f64 / f64::from(scene.rate_hz())))
        .filter(|at| !at.is_empty())
        .collect();
    all.iter().step_by(all.len().div_ceil(CONTACTS).max(1)).copied().collect()
}

fn us_per_frame(scene: &Scene) -> f64 {
    let mut fastest = vec![Duration::MAX; FRAMES];
    for _ in 0..RUNS {
        let mut frames = Simulator::new(scene, SEED).endless();
        for fastest in &mut fastest {
            while let (Some(sample), time) = timed(|| frames.next()) {
                if sample.truth.contact == Some(true) {
                    *fastest = time.min(*fastest);
                    break;
                }
            }
        }
    }
    fastest.iter().sum::<Duration>().as_secs_f64() * 1e6 / FRAMES as f64
}

/// Runs `work` and returns its result and duration.
pub(crate) fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let begin = Instant::now();
    let made = work();
    (made, begin.elapsed())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The documentation's charts must show what the code does.
    ///
    /// Times depend on the machine and are not compared.
    #[test]
    fn committed_table_matches_rung_errors() {
        let committed = include_str!("../../../docs/images/simulator.csv");
        let mut rows = committed.lines().skip(1);
        for (name, scene) in scenes().unwrap() {
            for (rung, error, _) in errors(&scene) {
                let row: Vec<&str> = rows.next().unwrap().split(',').collect();
                let [scene, on, charted, us] = row[..] else { panic!("{row:?}") };
                assert_eq!((scene, on), (name, rung.to_string().as_str()));
                let charted: f64 = charted.parse().unwrap();
                assert!((charted - error).abs() <= 0.01 * error, "{name} {rung}: {error}");
                assert!(us.parse::<f64>().unwrap() > 0.0);
            }
        }
        assert_eq!(rows.next(), None);
    }

    /// Number of distances in one measurement.
    const DISTANCES: u32 = 1000;

    /// Computes distances, the core of contact, as a clock for a machine of any speed.
    fn distances() -> f64 {
        let at = core::hint::black_box(0.3f64);
        (0..DISTANCES).map(|i| f64::from(i) - at).map(|x| 1.0 / (x * x + 2.5).sqrt()).sum()
    }

    /// The default press runs at 200000 frames a second on the documentation's server.
    ///
    /// That is 5 µs a frame where a thousand distances take 4.1 µs. Both are the fastest of many
    /// short stretches, so that other work on the machine does not count.
    #[test]
    fn default_press_meets_the_required_speed() {
        const STRETCH: usize = 50;
        let scene = Scene::load("press").unwrap();
        let mut frames = Simulator::new(&scene, SEED).endless();
        let mut reference = Duration::MAX;
        let mut stretches = vec![Duration::MAX; scene.frames() as usize / STRETCH];
        for _ in 0..20 {
            for quickest in &mut stretches {
                let (_, took) = timed(|| {
                    for frame in frames.by_ref().take(STRETCH) {
                        core::hint::black_box(frame);
                    }
                });
                *quickest = took.min(*quickest);
                reference = timed(|| core::hint::black_box(distances())).1.min(reference);
            }
        }
        let frame = stretches.iter().sum::<Duration>().as_secs_f64() / scene.frames() as f64;
        let ratio = frame / reference.as_secs_f64();
        assert!(ratio < 5.0 / 4.1, "a frame takes {ratio:.2} times a thousand distances");
    }
}
