//! `taxel simulate`: a scene in, a trace out.

use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use taxel_formats::trace::{TraceHeader, TraceWriter};
use taxel_sim::scene::BUILT_IN;
use taxel_sim::{Scene, Simulator};

use crate::interrupt::Interrupt;
use crate::output;

/// Writes the ADC codes of a simulated scene, with the truth in extra columns.
#[derive(clap::Args)]
pub struct Args {
    /// Scene to simulate: a name of --list, or the path of a TOML file.
    #[arg(long, required_unless_present = "list")]
    scene: Option<String>,
    /// Trace to write.
    #[arg(long, value_name = "TRACE.csv", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// Prints the built-in scenes, a line each.
    #[arg(long, exclusive = true)]
    list: bool,
    /// Seed of noise, lamps and random presses; the device has its own in the scene.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Runs the command.
///
/// # Errors
/// The scene is wrong or the trace cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let (Some(name), Some(out)) = (args.scene, args.out) else { return list() };
    output::keep([Path::new(&name)], &out)?;
    let scene = Scene::load(&name)?;
    let simulator = Simulator::new(&scene, args.seed);
    let fidelity = simulator.fidelity().map(|report| format!("; {report}")).unwrap_or_default();
    let header = TraceHeader {
        full_scale: simulator.full_scale(),
        rows: scene.device.rows(),
        bridges: scene.device.sensors(),
        reference: true,
        temperature: scene.temperature().is_some(),
        truth: true,
        sensor_truth: true,
    };
    let interrupt = Interrupt::watch()?;
    let mut trace = TraceWriter::create(&out, header)?;
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
    output::line(format!("{}: {written} scans{stopped}{fidelity}", out.display()))
}

/// Name and description of each built-in scene.
fn list() -> anyhow::Result<()> {
    for (name, _) in BUILT_IN {
        output::line(format!("{name:<22} {}", Scene::load(name)?.description))?;
    }
    Ok(())
}
