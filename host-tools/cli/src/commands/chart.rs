//! `taxel chart`.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use taxel_research::failures::Of;
use taxel_research::{
    Effort, Waiting, edge, estimators, failures, limit_surface, peers, simulator, throughput,
};

use crate::interrupt::Interrupt;
use crate::output;

/// Measures and writes the charts: speed against accuracy, and the failures of each method.
///
/// Each chart in DIR has its table (CSV), a picture (SVG) and an interactive page (HTML). Costs
/// come from the committed table of the counting emulator (`cargo xtask cycles`). Ctrl-C ends the
/// command; finished charts stay, and no file is left half written.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Folder to write to.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Charts to write [default: all]; may be given several times.
    #[arg(long, value_enum, value_name = "CHART")]
    only: Vec<Chart>,
    /// Use one device and narrow nets, as the tests do: seconds instead of minutes.
    #[arg(long)]
    quick: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel chart --out charts
  taxel chart --out charts --only estimators --quick";

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Chart {
    /// Cost and error of every estimator.
    Estimators,
    /// Failures of each method, and whether they are detected.
    Failures,
    /// Error of shear over the distance from the centre.
    Edge,
    /// Forms of the limit surface, with error and cost.
    LimitSurface,
    /// The core's net and those of other libraries.
    Peers,
    /// Time and error of the simulator's levels of detail.
    Simulator,
    /// Time of each step of a host's work on a frame.
    Throughput,
}

/// Runs the command.
///
/// A file cannot be written, or Ctrl-C interrupted a measurement.
pub fn run(args: Args) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("{}: cannot be made", args.out.display()))?;
    let interrupt = Interrupt::watch()?;
    let effort = if args.quick { Effort::quick() } else { Effort::full() };
    let wanted = |chart| args.only.is_empty() || args.only.contains(&chart);
    if wanted(Chart::Estimators) {
        let rows = with_progress(&interrupt, |waiting| estimators::measure(&effort, waiting))?;
        estimators::write(&rows, &args.out)?;
        report_written(&args.out, "estimators")?;
    }
    if wanted(Chart::Failures) {
        let maps = with_progress(&interrupt, |waiting| failures::measure(&effort, waiting))?;
        failures::write(&maps, &args.out)?;
        report_written(&args.out, "failures")?;
        for (of, whose) in [(Of::Finger, "the finger"), (Of::Matrix, "its matrix alone")] {
            let totals = failures::totals(&maps, of);
            output::line(format!(
                "undetected errors of {whose}: {:.3} % of {} values, {:.3} % of the {} within the working range, \
                 of which {:.3} % are flagged",
                100.0 * totals.silent[0],
                totals.frames[0],
                100.0 * totals.silent[1],
                totals.frames[1],
                100.0 * totals.false_flags
            ))?;
        }
    }
    if wanted(Chart::Edge) {
        let rows = with_progress(&interrupt, |waiting| edge::measure(&effort, waiting))?;
        edge::write(&rows, &args.out)?;
        report_written(&args.out, "edge")?;
    }
    if wanted(Chart::LimitSurface) {
        limit_surface::write(&args.out)?;
        report_written(&args.out, "limit-surface")?;
    }
    if wanted(Chart::Peers) {
        peers::write(&args.out)?;
        report_written(&args.out, "peers")?;
    }
    if wanted(Chart::Simulator) {
        anyhow::ensure!(!interrupt.came(), "interrupted");
        simulator::write(&args.out)?;
        report_written(&args.out, "simulator")?;
    }
    if wanted(Chart::Throughput) {
        let measured = with_progress(&interrupt, throughput::measure)?;
        throughput::write(&measured, &args.out)?;
        report_written(&args.out, "throughput")?;
    }
    Ok(())
}

fn report_written(folder: &Path, chart: &str) -> anyhow::Result<()> {
    output::line(format!("wrote {}", folder.join(chart).with_extension("csv").display()))
}

/// Runs `work` with a progress bar. An interrupt is an error.
fn with_progress<T>(
    interrupt: &Interrupt,
    work: impl FnOnce(Waiting<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    const STEPS: f64 = 1000.0;
    let bar = ProgressBar::new(STEPS as u64);
    if let Ok(style) = ProgressStyle::with_template("{wide_bar} {percent} % {eta}  {msg}") {
        bar.set_style(style);
    }
    let progress = |share: f64, what: &str| {
        bar.set_position((share * STEPS) as u64);
        bar.set_message(what.to_owned());
    };
    let done = work(Waiting { progress: &progress, stop: interrupt.flag() });
    bar.finish_and_clear();
    if interrupt.came() { Err(anyhow::anyhow!("interrupted")) } else { done }
}
