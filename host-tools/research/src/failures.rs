//! Failure maps: where methods fail, and whether the finger flags it (`failures.csv`).
//!
//! Each map takes one [method](crate::mapped) over one [sweep](crate::sweeps). It holds the error,
//! the claimed [accuracy](crate::accuracy) and the share of flagged frames. A frame is flagged by a
//! missing value or by a status bit. A frame is a **silent failure** (an undetected error) where
//! the error exceeds three times the claimed accuracy and nothing is flagged.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use taxel_files::save;

use crate::accuracy::Accuracy;
use crate::counts::{Count, Point, sums};
pub use crate::counts::{Map, Of};
use crate::device::Device;
use crate::effort::{Effort, Waiting, on_all_cores};
use crate::mapped::{Fingers, Said};
use crate::methods::calibrated;
use crate::picture::save_page;
use crate::runs::Recorded;
use crate::sweeps::{self, Sweep};
use crate::truth::LEAST_N;
use crate::{collinear, map};

/// Totals of several maps, as shares of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Totals {
    /// Numbers of judged frames: all, and those in the working range.
    pub frames: [usize; 2],
    /// Shares of silent failures: of all frames, and in the working range.
    pub silent: [f64; 2],
    /// Share of flagged frames in the working range.
    pub false_flags: f64,
}

/// A calibrated device with the claimed accuracy of its methods.
struct Stated {
    seed: u64,
    fingers: Fingers,
    stated: Vec<Accuracy>,
}

/// Lists the mapped methods of the finger or of its matrix alone, by their table names.
pub fn methods(of: Of) -> impl Iterator<Item = &'static str> {
    Fingers::methods().filter(move |(whose, _)| *whose == of).map(|(_, name)| name)
}

/// Maps every method over every sweep and device, on all cores.
///
/// # Errors
/// A fit failed, or it was stopped.
pub fn measure(effort: &Effort, waiting: Waiting<'_>) -> anyhow::Result<Vec<Map>> {
    let sweeps = sweeps::all();
    let devices = on_all_cores(&effort.devices, |seed| stated(*seed, effort, waiting))?;
    let jobs: Vec<(&Stated, &Sweep)> =
        devices.iter().flat_map(|device| sweeps.iter().map(move |sweep| (device, sweep))).collect();
    let done = AtomicUsize::new(0);
    let judged: Vec<Vec<Map>> = on_all_cores(&jobs, |(device, sweep)| {
        anyhow::ensure!(!waiting.stop.load(Ordering::Relaxed), "stopped");
        let maps = over(sweep, device)?;
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        (waiting.progress)(done as f64 / jobs.len() as f64, sweep.name);
        Ok(maps)
    })?;
    let mut maps: Vec<Map> = Vec::new();
    for (device, own) in devices.iter().zip(judged.chunks(sweeps.len())) {
        let own = own.iter().flatten().cloned().chain([collinear::map(device.seed)]);
        if maps.is_empty() {
            maps = own.collect();
            continue;
        }
        for (map, own) in maps.iter_mut().zip(own) {
            for (point, own) in map.points.iter_mut().zip(&own.points) {
                point.count.merge(&own.count);
                point.working.merge(&own.working);
            }
        }
    }
    Ok(maps)
}

fn stated(seed: u64, effort: &Effort, waiting: Waiting<'_>) -> anyhow::Result<Stated> {
    let device = Device::new(seed)?;
    let mut fingers = Fingers::new(&calibrated(&device, effort, waiting.stop)?)?;
    let stated = fingers.stated(&device)?;
    Ok(Stated { seed, fingers, stated })
}

fn over(sweep: &Sweep, device: &Stated) -> anyhow::Result<Vec<Map>> {
    let map = |(of, method)| Map { of, method, sweep: sweep.name, points: Vec::new() };
    let mut maps: Vec<Map> = Fingers::methods().map(map).collect();
    let mut fingers = device.fingers.clone();
    for value in &sweep.values {
        let within: Vec<bool> = maps.iter().map(|map| (sweep.within)(map.of, *value)).collect();
        let Recorded { samples, mut touches } = (sweep.run)(device.seed, *value)?;
        fingers.restart();
        let mut counts = vec![[Count::default(); 2]; maps.len()];
        for sample in &samples {
            let load = sample.truth.force[2].unwrap_or_default();
            fingers.judge(sample, &touches.at(sample), |Said { method, error, felt, warned }| {
                if let (Some([all, of_them]), Some(stated), Some(within)) =
                    (counts.get_mut(method), device.stated.get(method), within.get(method))
                {
                    let stated = stated.at(load, felt);
                    all.add(error, stated, warned);
                    if *within && load >= LEAST_N {
                        of_them.add(error, stated, warned);
                    }
                }
            });
        }
        for ((map, [count, working]), within) in maps.iter_mut().zip(counts).zip(within) {
            map.points.push(Point { value: *value, within, count, working });
        }
    }
    // A method without any value in a sweep gets no map there.
    maps.retain(|map| map.points.iter().any(|point| point.count.frames > 0));
    Ok(maps)
}

/// Returns the totals of the whole finger or of its matrix alone.
#[must_use]
pub fn totals(maps: &[Map], of: Of) -> Totals {
    let points = maps.iter().filter(|map| map.of == of).flat_map(|map| &map.points);
    let [all, within] = sums(points);
    Totals {
        frames: [all.frames, within.frames],
        silent: [all.share(all.silent), within.share(within.silent)],
        false_flags: within.share(within.flagged),
    }
}

/// Formats the table `failures.csv`.
#[must_use]
pub fn csv(maps: &[Map]) -> String {
    let mut table = String::from("method,sweep,value,within_range,error,stated,flagged\n");
    for map in maps {
        for Point { value, within, count, .. } in &map.points {
            let error = count.error().map(|error| format!("{error:.5}")).unwrap_or_default();
            let (stated, flagged) = (count.stated(), count.share(count.flagged));
            // Writing into a string cannot fail.
            let _ = writeln!(
                table,
                "{},\"{}\",{value},{within},{error},{stated:.5},{flagged:.5}",
                map.method, map.sweep
            );
        }
    }
    table
}

/// Formats the totals of each map in frames: `boundaries.csv`.
#[must_use]
pub fn boundaries(maps: &[Map]) -> String {
    let mut table = String::from(
        "method,sweep,trusted_up_to,frames,silent,within_range,silent_within_range,flagged_within_range\n",
    );
    for map in maps {
        let [all, within] = sums(&map.points);
        let boundary = map.boundary().map(|value| value.to_string()).unwrap_or_default();
        let _ = writeln!(
            table,
            "{},\"{}\",{boundary},{},{},{},{},{}",
            map.method,
            map.sweep,
            all.frames,
            all.silent,
            within.frames,
            within.silent,
            within.flagged
        );
    }
    table
}

/// Writes tables, picture and page into `folder`.
///
/// # Errors
/// One of them cannot be written.
pub fn write(maps: &[Map], folder: &Path) -> anyhow::Result<()> {
    save(folder.join("failures.csv"), csv(maps))?;
    save(folder.join("boundaries.csv"), boundaries(maps))?;
    let picture = map::draw(maps)?;
    picture.save(folder.join("failures.svg"))?;
    let lead = "The worst share of undetected errors of each method over the values of each cause.";
    save_page(folder.join("failures.html"), "Where each method fails", lead, &[&picture])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(errors: &[(f64, Option<f64>, bool)]) -> Map {
        let points = errors.iter().map(|(value, error, warned)| {
            let mut count = Count::default();
            count.add(*error, 1.0, *warned);
            let within = *value < 2.0;
            Point {
                value: *value,
                within,
                count,
                working: if within { count } else { Count::default() },
            }
        });
        Map { of: Of::Finger, method: "force / N", sweep: "load / N", points: points.collect() }
    }

    #[test]
    fn failure_is_silent_if_value_is_given_unflagged() {
        let map = map(&[
            (1.0, Some(2.9), false),
            (2.0, Some(3.1), false),
            (3.0, Some(9.0), true),
            (4.0, None, false),
        ]);
        assert_eq!(map.boundary(), Some(1.0));
        let totals = totals(&[map], Of::Finger);
        assert_eq!((totals.frames, totals.silent, totals.false_flags), ([4, 1], [0.25, 0.0], 0.0));
    }

    #[test]
    fn flag_in_working_range_is_false() {
        assert_eq!(totals(&[map(&[(1.0, Some(0.1), true)])], Of::Finger).false_flags, 1.0);
    }
}
