//! `taxel simulate`: writes the trace of a scene.

use std::path::{Path, PathBuf};

use indicatif::ProgressBar;
use taxel::scan::{COLS, TAXELS};
use taxel_files::trace::TraceWriter;
use taxel_files::{FileError, Pending};
use taxel_sim::scene::{Changes, built_in};
use taxel_sim::{LoadCell, Scene, Simulator};

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
    /// Log of a load cell under the finger: total force with 6 mN of noise, 100 Hz, its own clock.
    /// The trace then has the codes and no truth, as in a lab.
    #[arg(long, value_name = "CELL.csv")]
    cell: Option<PathBuf>,
    /// Axes of that load cell: with six, moments with 0.1 N·mm of noise about its origin, which
    /// lies 25 mm under the middle of the skin.
    #[arg(long, value_name = "3|6", default_value_t = 3, value_parser = axes, requires = "cell")]
    cell_axes: u8,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Print the built-in scenes, one line each.
    #[arg(long, exclusive = true)]
    list: bool,
    /// Finger: `ideal`, with the scene's own effects, or `reference`, the one in the bill of
    /// materials with all effects of a real finger.
    #[arg(long, value_enum, default_value_t = Finger::Ideal)]
    finger: Finger,
    /// Change a key of the scene: `material.young_mpa=0.3`, `effects.walls=false`; an empty value
    /// leaves the key out.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Seed of noise, lamps and random presses; the device's own seed is in the scene.
    #[arg(long, default_value_t = 1, value_parser = seed)]
    seed: u64,
}

/// Finger of a simulation.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Finger {
    /// The scene's own finger.
    Ideal,
    /// The finger in the bill of materials.
    Reference,
}

const EXAMPLES: &str = "\
Examples:
  taxel simulate --list
  taxel simulate --scene shear --seed 2 --out shear.csv
  taxel simulate --scene presses --out presses.csv --cell cell.csv
  taxel simulate --scene press --finger reference --set effects.creep=false --out press.csv";

/// Parses a seed, as in `--seed`.
///
/// # Errors
/// The text is no whole number of 64 bits.
pub fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("expected a whole number in 0…{}", u64::MAX))
}

fn axes(text: &str) -> Result<u8, String> {
    match text {
        "3" => Ok(3),
        "6" => Ok(6),
        _ => Err("expected 3 or 6".to_owned()),
    }
}

/// Runs the command.
///
/// The scene is invalid or the trace cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let (Some(name), Some(out)) = (args.scene, args.out) else { return list() };
    let outs: Vec<PathBuf> = [&out].into_iter().chain(&args.cell).cloned().collect();
    for out in &outs {
        output::keep([Path::new(&name)], out, args.overwrite)?;
    }
    output::apart(&outs)?;
    let reference = args.finger == Finger::Reference;
    let scene = Scene::load_changed(&name, &Changes { reference, set: args.set.clone() })?;
    let mut simulator = Simulator::new(&scene, args.seed);
    let fidelity = simulator.fidelity().map(|report| format!("; {report}")).unwrap_or_default();
    let interrupt = Interrupt::watch()?;
    let pending = Pending::new(&out)?;
    let named = |error| pending.named(error);
    let header = simulator.trace_header(args.cell.is_none());
    let origin = origin(&name, reference, &args.set, args.seed);
    let trace = TraceWriter::create_simulated(pending.path(), header, &origin);
    let mut trace = trace.map_err(named)?;
    let six = args.cell_axes == 6;
    let mut cell = args.cell.map(|path| (path, LoadCell::new(args.seed, six), Vec::new()));
    let bar = ProgressBar::new(scene.frames());
    let mut written = 0u64;
    let mut wrong_side = [false; TAXELS];
    while let Some(sample) = simulator.next() {
        if interrupt.came() {
            break;
        }
        trace.write(&sample).map_err(named)?;
        if let Some((_, cell, rows)) = &mut cell {
            rows.extend(cell.read(&sample));
        }
        wrong_side.iter_mut().zip(simulator.wrong_side()).for_each(|(was, is)| *was |= is);
        written += 1;
        // A redraw per frame would take longer than the frame.
        if written.is_multiple_of(1000) {
            bar.set_position(written);
        }
    }
    interrupt.finishing();
    trace.finish().map_err(named)?;
    pending.commit()?;
    if let Some((path, cell, rows)) = cell {
        write_log(&path, cell.header(), &rows)?;
    }
    bar.finish_and_clear();
    let stopped = if interrupt.came() { "; stopped early" } else { "" };
    let wrong_side = past_the_peak(&wrong_side);
    output::line(format!("{}: {written} scans{stopped}{fidelity}{wrong_side}", out.display()))
}

/// Words for a trace's line `# simulated=`.
fn origin(scene: &str, reference: bool, set: &[String], seed: u64) -> String {
    let finger = if reference { "reference" } else { "ideal" };
    let changed = set.iter().map(|change| format!("; {change}")).collect::<String>();
    format!("{scene}; {finger} finger; seed {seed}{changed}").replace(['\n', '\r'], " ")
}

/// Writes the load cell's log, which is short.
fn write_log(path: &Path, header: &str, rows: &[String]) -> Result<(), FileError> {
    let lines = [header].into_iter().chain(rows.iter().map(String::as_str));
    taxel_files::save(path, lines.flat_map(|line| [line, "\n"]).collect::<String>())
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
