//! Speed and accuracy on one core, with noise: `cargo bench -p taxel-sim`.
//!
//! The bench prints the frames per second of the built-in scenes, then every rung of the ladder on
//! three scenes. A rung has its µs per frame in contact, and its worst error over the largest
//! displacement of a facet.

use std::hint::black_box;
use std::time::Instant;

use taxel_files::FileError;
use taxel_sim::cost::{self, Cost};
use taxel_sim::scene::built_in;
use taxel_sim::{Scene, Simulator};

/// Number of runs; the fastest counts, because short runs fit between disturbances.
const RUNS: usize = 20;

fn main() {
    if let Err(error) = frames().and_then(|()| rungs()) {
        eprintln!("{error}");
        std::process::exit(1);
    }
}

fn frames() -> Result<(), FileError> {
    println!("{:<16} {:>12} {:>10}", "scene", "frames/s", "µs/frame");
    for (name, text) in built_in() {
        let scene = Scene::parse(name, text)?;
        let mut fastest = f64::INFINITY;
        for _ in 0..RUNS {
            let frames = Simulator::new(&scene, 1);
            let begin = Instant::now();
            for frame in frames {
                black_box(frame);
            }
            fastest = fastest.min(begin.elapsed().as_secs_f64());
        }
        let each = fastest / scene.frames() as f64;
        println!("{name:<16} {:>12.0} {:>10.2}", 1.0 / each, each * 1e6);
    }
    Ok(())
}

fn rungs() -> Result<(), FileError> {
    println!("\n{:<18} {:<10} {:>12} {:>12}", "scene", "rung", "µs/frame", "error");
    for Cost { scene, rung, error, us_per_frame, auto } in cost::measure()? {
        let auto = if auto { "auto" } else { "" };
        let error = 100.0 * error;
        println!("{scene:<18} {rung:<10} {us_per_frame:>12.2} {error:>10.4} % {auto}");
    }
    Ok(())
}
