//! `taxel simulate`: a scene in, a trace out.

use std::path::PathBuf;

use taxel_formats::trace::{TraceHeader, TraceWriter};
use taxel_sim::{Scene, Simulator};

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
    let scene = Scene::load(&args.scene)?;
    let simulator = Simulator::new(&scene, args.seed);
    let header = TraceHeader {
        full_scale: simulator.full_scale(),
        taxels: scene.device.taxels,
        bridges: scene.device.bridges,
        reference: true,
        temperature: false,
        truth: true,
        sensor_truth: true,
    };
    let mut trace = TraceWriter::create(&args.out, header)?;
    for sample in simulator {
        trace.write(&sample)?;
    }
    trace.finish()?;
    println!("{}: {} frames, {} s", args.out.display(), scene.frames(), scene.scan.duration_s);
    Ok(())
}
