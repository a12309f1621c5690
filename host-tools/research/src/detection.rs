//! Detection and isolation of faults: which fault is named, how soon, and how far off the force is.
//!
//! ```text
//! reference finger, 4 kHz ─▶ codes ─┬──────────▶ Finger ─▶ sound frames ─┐
//!                                   └─ fault ──▶ Finger ─▶ faulty frames ┴─▶ Case ─▶ Row
//! ```
//! Every [fault](crate::faults) starts at rest, at the touch and under load, on the matrix alone
//! and on the finger with force sensors. Sound runs of the built-in scenes count the false alarms.

mod alarms;
mod bench;
mod chart;
mod judge;
mod page;
mod table;

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use taxel_files::save;

use crate::effort::{Waiting, on_all_cores};
use crate::faults::{Fault, KINDS, Kind};
use bench::{Bench, Has, PHASES, Phase};
pub(crate) use judge::tells_fault;
use judge::{Case, case};
pub use page::section;
pub use table::{Row, csv, parse};

/// Share of the progress that simulating and fitting take.
const PREPARED: f64 = 0.25;
/// Share of the progress at which the sound scenes are done.
const SOUND: f64 = 0.8;
/// Seeds of the devices, which no fit of another measurement has.
const DEVICES: [u64; 2] = [21, 22];

/// Measures every fault and every sound scene; `clean_runs` is the number of runs of each scene.
///
/// # Errors
/// A fit failed, or the measurement was stopped.
pub fn measure(clean_runs: u64, waiting: Waiting<'_>) -> anyhow::Result<Vec<Row>> {
    let plan: Vec<(u64, bool)> = DEVICES.iter().map(|device| (*device, false)).collect();
    let plan = [plan, vec![(DEVICES[0], true)]].concat();
    let done = AtomicUsize::new(0);
    (waiting.progress)(0.0, "simulating and calibrating");
    let benches = on_all_cores(&plan, |(device, warm)| {
        let bench = Bench::new(*device, *warm, waiting.stop)?;
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        (waiting.progress)(PREPARED * done as f64 / plan.len() as f64, "calibrated");
        Ok(bench)
    })?;
    let jobs: Vec<(Kind, Has, Phase)> = KINDS
        .iter()
        .flat_map(|kind| Has::of(kind.place).iter().map(move |has| (*kind, *has)))
        .flat_map(|(kind, has)| PHASES.map(|phase| (kind, has, phase)))
        .collect();
    let scenes = alarms::scenes()?;
    let (steps, done) = (alarms::steps(&scenes, clean_runs)?, AtomicUsize::new(0));
    let go_on = |from: f64, to: f64, of: usize, what: &str| {
        anyhow::ensure!(!waiting.stop.load(Ordering::Relaxed), "stopped");
        let share = (done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / of as f64;
        (waiting.progress)(from + (to - from) * share.min(1.0), what);
        Ok(())
    };
    let alarms = on_all_cores(&scenes, |scene| {
        let tell = || go_on(PREPARED, SOUND, steps, &format!("sound scene {scene}"));
        alarms::judge(scene, &benches, clean_runs, tell)
    })?;
    done.store(0, Ordering::Relaxed);
    let faults = on_all_cores(&jobs, |(kind, has, phase)| {
        go_on(SOUND, 1.0, jobs.len(), &format!("{}: {}", kind.place.name(), kind.name))?;
        Ok(judged(*kind, *has, *phase, &benches))
    })?;
    Ok(faults.into_iter().chain(alarms.into_iter().flatten()).collect())
}

/// Judges one kind of fault at all its places, on all devices and touches.
fn judged(kind: Kind, has: Has, phase: Phase, benches: &[Bench]) -> Row {
    let mut cases: Vec<Case> = Vec::new();
    for bench in benches.iter().filter(|bench| bench.is(has)) {
        for run in bench.runs(has) {
            for index in 0..kind.place.count() {
                let fault = Fault::new(kind, index, phase.scans(), run.sound(phase));
                cases.extend(case(run, phase, &fault));
            }
        }
    }
    Row::of_cases(kind, has, phase, &cases)
}

/// Writes the table `detection.csv`.
///
/// # Errors
/// The file cannot be written.
pub fn write_table(rows: &[Row], path: &Path) -> anyhow::Result<()> {
    Ok(save(path, csv(rows))?)
}

/// Draws the chart `detection.svg`.
///
/// # Errors
/// The file cannot be written.
pub fn write_chart(rows: &[Row], path: &Path) -> anyhow::Result<()> {
    chart::draw(rows)?.save(path)
}
