//! Slip of the reference finger: warnings in time, gross slips told, and false alarms.

mod chart;

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use serde::{Deserialize, Serialize};
use taxel::calibration::Calibration;
use taxel::finger::Estimate;
use taxel::frame::Status;
use taxel_calibrate::evaluate::Only;
use taxel_calibrate::recording::Recording;
use taxel_files::trace::Sample;
use taxel_sim::{Scene, Simulator, scene::Changes};

use crate::effort::{Waiting, on_all_cores};
use crate::reference::{calibrated, estimates};

/// Devices of which each is calibrated on its own recordings.
const DEVICES: [u64; 3] = [1, 2, 3];
/// Seed of noise and lamps; no calibration has it.
const SEED: u64 = 43;
/// Friction coefficients and loads in newtons of the slides: each pair is one finger's first touch
/// of a material, and three later ones.
const FRICTIONS: [f64; 4] = [0.2, 0.4, 0.8, 1.2];
const LOADS: [f64; 4] = [0.2, 0.5, 1.0, 2.0];
const SLIDES: u32 = 4;
/// Scans a second, as the board's.
const RATE: usize = 4000;
/// Time of a warning before the slip, in scans: 20 ms.
const AHEAD: usize = RATE / 50;
/// Number of grasps of 0.4 s after a slide that has shown the friction.
const GRASPS: u32 = 200;
const PARTS: [(Only, &str); 3] =
    [(Only::Matrix, "matrix"), (Only::Array, "sensors"), (Only::Both, "both")];

/// Result of a part of the finger at one friction, over all devices and loads.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Slips {
    /// Part of the finger: `matrix`, `sensors` or `both`.
    pub part: String,
    /// Friction coefficient of the material.
    pub friction: f64,
    /// First slides on an unknown material.
    pub first: usize,
    /// First slides that were warned of in time.
    pub first_warned: usize,
    /// Later slides on the same material.
    pub later: usize,
    /// Later slides that were warned of in time.
    pub later_warned: usize,
    /// Slides told as gross slip.
    pub told: usize,
    /// Milliseconds within which half of these were told.
    pub half_ms: usize,
    /// Milliseconds within which 95 % of these were told.
    pub most_ms: usize,
    /// Seconds of grasps at up to half of the friction limit.
    pub grasped_s: u32,
    /// Warnings in the grasps.
    pub false_warnings: usize,
    /// Gross slips told in the grasps.
    pub false_slips: usize,
}

/// Slides and grasps of one device at one friction.
#[derive(Clone, Debug, Default)]
struct Counts {
    first: [usize; 2],
    later: [usize; 2],
    delays: Vec<usize>,
    alarms: [usize; 2],
}

/// Measures slides and grasps at every friction; takes some minutes.
///
/// # Errors
/// The fit failed or was stopped.
pub fn measure(waiting: Waiting<'_>) -> anyhow::Result<Vec<Slips>> {
    (waiting.progress)(0.0, "calibrating");
    let records = on_all_cores(&DEVICES, |device| calibrated(*device, false, waiting.stop))?;
    let work: Vec<(usize, f64)> =
        FRICTIONS.iter().flat_map(|mu| (0..DEVICES.len()).map(|i| (i, *mu))).collect();
    let begun = AtomicUsize::new(0);
    let counts = on_all_cores(&work, |(i, friction)| {
        anyhow::ensure!(!waiting.stop.load(Ordering::Relaxed), "stopped");
        let (device, record) = (DEVICES[*i], &records[*i]);
        let share = begun.fetch_add(1, Ordering::Relaxed) as f64 / work.len() as f64;
        (waiting.progress)(share, &format!("finger {device} at a friction of {friction}"));
        counted(device, *friction, record)
    })?;
    let mut rows = Vec::new();
    for (p, (_, part)) in PARTS.into_iter().enumerate() {
        for friction in FRICTIONS {
            let own = work.iter().zip(&counts).filter(|((_, mu), _)| *mu == friction);
            rows.push(sum(part, friction, own.map(|(_, counts)| &counts[p])));
        }
    }
    Ok(rows)
}

fn sum<'c>(part: &str, friction: f64, counts: impl Iterator<Item = &'c Counts>) -> Slips {
    let mut row = Slips { part: part.to_owned(), friction, ..Slips::default() };
    let mut delays = Vec::new();
    for counts in counts {
        row.first += counts.first[0];
        row.first_warned += counts.first[1];
        row.later += counts.later[0];
        row.later_warned += counts.later[1];
        row.grasped_s += GRASPS * 2 / 5;
        row.false_warnings += counts.alarms[0];
        row.false_slips += counts.alarms[1];
        delays.extend(&counts.delays);
    }
    delays.sort_unstable();
    row.told = delays.len();
    let within = |share: usize| (delays.len() * share).div_ceil(100).saturating_sub(1);
    [row.half_ms, row.most_ms] = [50, 95].map(|share| delays.get(within(share)).map_or(0, |d| *d));
    row
}

/// Slides and grasps of a device, as each of [`PARTS`] reports them.
fn counted(device: u64, friction: f64, record: &Calibration) -> anyhow::Result<[Counts; 3]> {
    let mut all: [Counts; 3] = Default::default();
    for load in LOADS {
        let acts: String = (0..SLIDES).map(|i| slide(1.0 + 2.2 * f64::from(i), i, load)).collect();
        let recording = run(device, friction, 10.5, &acts)?;
        for ((part, _), counts) in PARTS.into_iter().zip(&mut all) {
            counts.add_slides(&recording.samples, &estimates(part, record, &recording));
        }
    }
    let grasps = format!(
        "{}[[random]]\nat_s = 3.5\npresses = {GRASPS}\neach_s = 0.4\nx_mm = [-3, 3]\ny_mm = [-3, 3]\n\
         fz_n = [0.2, 2]\nshear_of_limit = [0, 0.5]\n",
        slide(1.0, 2, 1.0)
    );
    let recording = run(device, friction, 4.5 + 0.4 * f64::from(GRASPS), &grasps)?;
    let after = recording.samples.partition_point(|sample| sample.scan.time.0 < 3_200_000);
    for ((part, _), counts) in PARTS.into_iter().zip(&mut all) {
        let estimates = estimates(part, record, &recording);
        counts.alarms = [Status::SLIP_WARNING, Status::SLIDES].map(|flag| {
            let set = |estimate: &Estimate| estimate.status.contains(flag);
            estimates[after..].windows(2).filter(|pair| !set(&pair[0]) && set(&pair[1])).count()
        });
    }
    Ok(all)
}

fn run(device: u64, friction: f64, seconds: f64, acts: &str) -> anyhow::Result<Recording> {
    let text = format!(
        "effects = []\n[scan]\nrate_hz = {RATE}\nduration_s = {seconds}\n[device]\nseed = {device}\n\
         bits = 16\n[indenter]\nradius_mm = 6\n[friction]\nmu = {friction}\n{acts}"
    );
    // The truth is exact: an error of the bench belongs to the labels of a calibration.
    let set = vec!["effects.bench-error=false".to_owned()];
    let scene = Scene::parse_changed("slip.toml", &text, &Changes { reference: true, set })?;
    Ok(Recording { name: "slip".into(), samples: Simulator::new(&scene, SEED).collect() })
}

/// The `i`th of four slides over the pad, of which shear grows for 0.15 s until it breaks loose.
fn slide(at_s: f64, i: u32, load: f64) -> String {
    let y = 1.0 - 0.5 * f64::from(i);
    format!(
        "[[slide]]\nat_s = {at_s}\nfrom_mm = [-1.5, {}]\nto_mm = [1.5, {y}]\nfz_n = {load}\n\
         rise_s = 0.2\ntravel_s = 1.5\nfall_s = 0.2\n",
        -y
    )
}

impl Counts {
    fn add_slides(&mut self, samples: &[Sample], estimates: &[Estimate]) {
        let slips = |i: usize| samples[i].truth.slip == Some(true);
        let has = |i: usize, flag| estimates[i].status.contains(flag);
        let (mut pressed, mut begun) = (0, 0);
        for i in 1..samples.len() {
            let truth = &samples[i].truth;
            // Shear begins after the normal force has risen: an earlier warning is false.
            if truth.force[..2] == [Some(0.0); 2] && truth.torsion == Some(0.0) {
                pressed = i;
            }
            if !slips(i) || slips(i - 1) {
                continue;
            }
            let warned = |i: usize| has(i, Status::SLIP_WARNING);
            let in_time = !warned(pressed) && (pressed..=i - AHEAD).any(warned);
            let counts = if begun == 0 { &mut self.first } else { &mut self.later };
            *counts = [counts[0] + 1, counts[1] + usize::from(in_time)];
            begun += 1;
            let end = (i..samples.len()).find(|i| !slips(*i)).unwrap_or(samples.len());
            let told = (i..end).find(|i| has(*i, Status::SLIDES));
            self.delays.extend(told.map(|told| (told - i) * 1000 / RATE));
        }
    }
}

/// Draws the chart `slip.svg`.
///
/// # Errors
/// The file cannot be written.
pub fn write_chart(rows: &[Slips], path: &Path) -> anyhow::Result<()> {
    chart::draw(rows)?.save(path)
}

/// Draws the table of the page: a column for each part of the finger.
#[must_use]
pub fn section(rows: &[Slips]) -> String {
    type Cell = fn(&[&Slips]) -> String;
    fn share(rows: &[&Slips], of: fn(&Slips) -> [usize; 2]) -> String {
        let [all, some] = [0, 1].map(|i| rows.iter().map(|row| of(row)[i]).sum::<usize>());
        format!("{some} of {all}")
    }
    fn each(rows: &[&Slips], of: fn(&Slips) -> usize) -> String {
        let cells: Vec<String> = rows.iter().map(|row| of(row).to_string()).collect();
        cells.join(", ")
    }
    let lines: [(&str, Cell); 7] = [
        ("first slide on a new material, warned of 20 ms ahead", |rows| {
            share(rows, |row| [row.first, row.first_warned])
        }),
        ("the same at friction 0.2, 0.4, 0.8, 1.2, of 12 each", |rows| {
            each(rows, |row| row.first_warned)
        }),
        ("later slides on it, warned of 20 ms ahead", |rows| {
            share(rows, |row| [row.later, row.later_warned])
        }),
        ("gross slips told", |rows| share(rows, |row| [row.first + row.later, row.told])),
        ("95 of 100 of them within, at friction 0.2, 0.4, 0.8, 1.2", |rows| {
            each(rows, |row| row.most_ms) + " ms"
        }),
        ("false warnings in grasps at up to half of the limit, at the same", |rows| {
            each(rows, |row| row.false_warnings)
        }),
        ("false gross slips in them", |rows| each(rows, |row| row.false_slips)),
    ];
    let mut table =
        "| reference finger | matrix alone | force sensors alone | both |\n|---|---|---|---|"
            .to_owned();
    for (name, cell) in lines {
        let _ = write!(table, "\n| {name} |");
        for (_, part) in PARTS {
            let own: Vec<&Slips> = rows.iter().filter(|row| row.part == part).collect();
            let _ = write!(table, " {} |", cell(&own));
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use taxel::scan::{Codes, SENSORS, Scan};
    use taxel::units::{FullScale, Micros};
    use taxel_files::trace::Truth;

    use super::*;
    use crate::table;

    /// A touch without shear, with shear from 10 ms, and with slip from 60 ms on; warned of and
    /// told after these times.
    fn counts(warned_ms: usize, told_ms: usize) -> Counts {
        let codes = Codes {
            full_scale: FullScale::BITS_16,
            taxels: None,
            bridges: [None; SENSORS],
            reference: None,
            temperature: None,
        };
        let at = |ms: usize| ms * RATE / 1000;
        let sample = |i: usize| Sample {
            scan: Scan { time: Micros(i as u64 * 250), lost: 0, codes },
            truth: Truth {
                force: [Some(if i < at(10) { 0.0 } else { 0.3 }), Some(0.0), Some(1.0)],
                torsion: Some(0.0),
                slip: Some(i >= at(60)),
                ..Truth::default()
            },
        };
        let mut estimates = vec![Estimate::NOTHING; at(200)];
        estimates[at(warned_ms)..].iter_mut().for_each(|e| e.status.insert(Status::SLIP_WARNING));
        estimates[at(told_ms)..].iter_mut().for_each(|e| e.status.insert(Status::SLIDES));
        let samples: Vec<Sample> = (0..at(200)).map(sample).collect();
        let mut counts = Counts::default();
        counts.add_slides(&samples, &estimates);
        counts
    }

    #[test]
    fn warning_counts_between_shear_and_20_ms_before_slip() {
        for (warned_ms, in_time) in [(5, 0), (15, 1), (40, 1), (41, 0), (70, 0)] {
            assert_eq!(counts(warned_ms, 100).first, [1, in_time], "at {warned_ms} ms");
        }
        assert_eq!(counts(15, 100).delays, [40]);
        assert_eq!(counts(15, 199).later, [0, 0]);
    }

    #[test]
    fn table_is_read_as_written() {
        let row =
            Slips { part: "both".into(), friction: 0.4, first: 12, told: 3, ..Slips::default() };
        let path = std::env::temp_dir().join(format!("taxel-slips-{}.csv", std::process::id()));
        table::write(&[row.clone(), row.clone()], &path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(table::parse::<Slips>(&text).unwrap(), [row.clone(), row]);
        assert!(
            table::parse::<Slips>(&text.replace("0.4", "x"))
                .unwrap_err()
                .to_string()
                .contains("line 2")
        );
    }
}
