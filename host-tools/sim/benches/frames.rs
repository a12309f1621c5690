//! Frames a second of the built-in scenes on one core, noise and all: `cargo bench -p taxel-sim`.

use std::hint::black_box;
use std::time::Instant;

use taxel_sim::scene::BUILT_IN;
use taxel_sim::{Scene, Simulator};

/// Frames of one timing; the fastest of [`RUNS`] counts, the others were disturbed.
const FRAMES: usize = 100_000;
const RUNS: usize = 5;

fn main() {
    println!("{:<10} {:>12} {:>10}", "scene", "frames/s", "µs/frame");
    for (name, text) in BUILT_IN {
        let scene = match Scene::parse(name, text) {
            Ok(scene) => scene,
            Err(error) => {
                eprintln!("{error}");
                std::process::exit(1);
            }
        };
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
}
