//! `taxel simulate`: writes the trace of a scene.

use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use taxel::scan::{COLS, TAXELS};
use taxel_files::Pending;
use taxel_files::trace::TraceWriter;
use taxel_sim::scene::built_in;
use taxel_sim::{Scene, Simulator};

use crate::interrupt::Interrupt;
use crate::output::{self, Overwrite};

/// Writes the ADC codes of a simulated scene, with the truth in extra columns.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Scene to simulate: a name of --list, or the path of a TOML file.
    #[arg(long, required_unless_present = "list")]
    scene: Option<String>,
    /// Trace to write.
    #[arg(long, value_name = "TRACE.csv", required_unless_present = "list")]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Print the built-in scenes, one line each.
    #[arg(long, exclusive = true)]
    list: bool,
    /// Seed of noise, lamps and random presses; the device's own seed is in the scene.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

const EXAMPLES: &str = "\
Examples:
  taxel simulate --list
  taxel simulate --scene shear --seed 2 --out shear.csv";

/// Runs the command.
///
/// The scene is invalid or the trace cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let (Some(name), Some(out)) = (args.scene, args.out) else { return list() };
    output::keep([Path::new(&name)], &out, args.overwrite)?;
    let scene = Scene::load(&name)?;
    let mut simulator = Simulator::new(&scene, args.seed);
    let fidelity = simulator.fidelity().map(|report| format!("; {report}")).unwrap_or_default();
    let interrupt = Interrupt::watch()?;
    let pending = Pending::new(&out)?;
    let named = |error| pending.named(error);
    let mut trace =
        TraceWriter::create(pending.path(), simulator.trace_header(true)).map_err(named)?;
    let bar = ProgressBar::new(scene.frames());
    let mut written = 0u64;
    let mut wrong_side = [false; TAXELS];
    while let Some(sample) = simulator.next() {
        if interrupt.came() {
            break;
        }
        trace.write(&sample).map_err(named)?;
        wrong_side.iter_mut().zip(simulator.wrong_side()).for_each(|(was, is)| *was |= is);
        written += 1;
        // A redraw per frame would take longer than the frame.
        if written.is_multiple_of(1000) {
            bar.set_position(written);
        }
    }
    trace.finish().map_err(named)?;
    pending.commit()?;
    bar.finish_and_clear();
    let stopped = if interrupt.came() { "; stopped early" } else { "" };
    let wrong_side = past_the_peak(&wrong_side);
    output::line(format!("{}: {written} scans{stopped}{fidelity}{wrong_side}", out.display()))
}

/// Names the taxels whose facet came so near that the light fell again.
fn past_the_peak(wrong_side: &[bool; TAXELS]) -> String {
    let taxels = wrong_side.iter().enumerate().filter(|(_, past)| **past);
    let names: Vec<String> = taxels.map(|(k, _)| format!("r{}c{}", k / COLS, k % COLS)).collect();
    match names.len() {
        0 => String::new(),
        1 => format!("; 1 taxel came past the peak of its light curve: {}", names.concat()),
        n => format!("; {n} taxels came past the peak of their light curve: {}", names.join(", ")),
    }
}

/// Name and description of each built-in scene.
fn list() -> anyhow::Result<()> {
    for (name, _) in built_in() {
        output::line(format!("{name:<22} {}", Scene::load(name)?.description))?;
    }
    Ok(())
}
