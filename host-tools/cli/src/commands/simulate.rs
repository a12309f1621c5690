//! `taxel simulate`: a scene in, a trace out.

use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use taxel::scan::ROWS;
use taxel_formats::trace::{TraceHeader, TraceWriter};
use taxel_sim::{Scene, Simulator};

use crate::interrupt::Interrupt;
use crate::output;

/// Writes the ADC codes of a simulated scene, with the truth in extra columns.
#[derive(clap::Args)]
pub struct Args {
    /// Scene to simulate: press, presses, shear, tour, bench-s0, or the path of a TOML file.
    #[arg(long)]
    scene: String,
    /// Trace to write.
    #[arg(long, value_name = "TRACE.csv")]
    out: PathBuf,
    /// Seed of noise, lamps and random presses; the device has its own in the scene.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Runs the command.
///
/// # Errors
/// The scene is wrong or the trace cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    output::keep([Path::new(&args.scene)], &args.out)?;
    let scene = Scene::load(&args.scene)?;
    let simulator = Simulator::new(&scene, args.seed);
    let header = TraceHeader {
        full_scale: simulator.full_scale(),
        rows: if scene.device.taxels { ROWS } else { 0 },
        bridges: scene.device.bridges,
        reference: true,
        temperature: false,
        truth: true,
        sensor_truth: true,
    };
    let interrupt = Interrupt::watch()?;
    let mut trace = TraceWriter::create(&args.out, header)?;
    let bar = ProgressBar::new(scene.frames());
    let mut written = 0u64;
    for sample in simulator {
        if interrupt.came() {
            break;
        }
        trace.write(&sample)?;
        written += 1;
        // A redraw a frame would cost more than the frame.
        if written.is_multiple_of(1000) {
            bar.set_position(written);
        }
    }
    trace.finish()?;
    bar.finish_and_clear();
    let stopped = if interrupt.came() { "; stopped early" } else { "" };
    output::line(format!("{}: {written} scans{stopped}", args.out.display()))
}
