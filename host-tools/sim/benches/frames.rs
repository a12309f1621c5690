//! Speed against accuracy on one core, noise and all: `cargo bench -p taxel-sim`.
//!
//! First frames a second of the built-in scenes, then every rung of the ladder on three scenes: µs per
//! frame in contact and worst error over the largest displacement of a facet.

use std::hint::black_box;
use std::time::Instant;

use taxel_formats::FileError;
use taxel_sim::fidelity::Ladder;
use taxel_sim::path::{Contacts, Path};
use taxel_sim::scene::BUILT_IN;
use taxel_sim::{Scene, Simulator};

/// The fastest of so many runs counts; the others were disturbed.
const RUNS: usize = 5;
const FRAMES: usize = 100_000;
/// Contacts of a rung's timing.
const CONTACTS: usize = 200;

fn main() {
    if let Err(error) = frames().and_then(|()| rungs()) {
        eprintln!("{error}");
        std::process::exit(1);
    }
}

fn frames() -> Result<(), FileError> {
    println!("{:<10} {:>12} {:>10}", "scene", "frames/s", "µs/frame");
    for (name, text) in BUILT_IN.iter().copied() {
        let scene = Scene::parse(name, text)?;
        let mut fastest = f64::INFINITY;
        for _ in 0..RUNS {
            let mut frames = Simulator::new(&scene, 1).endless();
            let begin = Instant::now();
            for _ in 0..FRAMES {
                black_box(frames.next());
            }
            fastest = fastest.min(begin.elapsed().as_secs_f64());
        }
        let each = fastest / FRAMES as f64;
        println!("{name:<10} {:>12.0} {:>10.2}", 1.0 / each, each * 1e6);
    }
    Ok(())
}

fn rungs() -> Result<(), FileError> {
    println!("\n{:<18} {:<10} {:>12} {:>12}", "scene", "rung", "µs/contact", "error");
    let [press, .., shear] = [0, 1, 2].map(|i| BUILT_IN.get(i).map_or("", |(_, text)| text));
    let framed = press.replacen("effects = [", "effects = [\"walls\", ", 1);
    for (name, text, top) in [
        ("press", press, "converged"),
        ("shear", shear, "converged"),
        ("press with walls", &framed, "layer"),
    ] {
        let ladder = |fidelity: &str| -> Result<Ladder, FileError> {
            let scene = Scene::parse(name, &format!("fidelity = \"{fidelity}\"\n{text}"))?;
            Ok(Ladder::new(&scene, 1))
        };
        let loads = loads(&Scene::parse(name, text)?);
        let best = ladder(top)?;
        let best: Vec<_> = loads.iter().map(|load| best.displacement(load)).collect();
        for fidelity in ["point", "hertz", "converged", "layer"] {
            if top == "converged" && fidelity == "layer" {
                continue;
            }
            let ladder = ladder(fidelity)?;
            let mut error = 0.0f64;
            for (load, best) in loads.iter().zip(&best) {
                let most = best.iter().fold(0.0f64, |m, u| m.max(u.abs()));
                let found = ladder.displacement(load);
                let differences = found.iter().zip(best).map(|(u, b)| (u - b).abs() / most);
                error = differences.fold(error, f64::max);
            }
            let mut fastest = f64::INFINITY;
            for _ in 0..RUNS {
                let begin = Instant::now();
                for load in &loads {
                    black_box(ladder.displacement(black_box(load)));
                }
                fastest = fastest.min(begin.elapsed().as_secs_f64());
            }
            let each = fastest * 1e6 / loads.len() as f64;
            println!("{name:<18} {fidelity:<10} {each:>12.2} {:>10.4} %", 100.0 * error);
        }
    }
    Ok(())
}

/// Loads evenly spread over the contact of a scene.
fn loads(scene: &Scene) -> Vec<Contacts> {
    let mut path = Path::new(scene, 1);
    let all: Vec<Contacts> = (0..scene.frames())
        .map(|frame| path.at(frame as f64 / f64::from(scene.rate_hz())))
        .filter(|at| !at.is_empty())
        .collect();
    all.iter().step_by((all.len() / CONTACTS).max(1)).copied().collect()
}
