//! Where the finger stops being trustworthy, and whether it says so: `failures.csv`.
//!
//! For each method of the firmware and each [sweep](crate::sweeps): its error, the accuracy that it states
//! and the share of frames that it flags, by withholding the value or in the status. A frame is a **silent
//! failure** where the error is beyond three times the stated accuracy and nothing is flagged.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::Ordering;

use taxel::calibration::Calibration;
use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::measured::Measured;
use taxel::units::Newtons;
use taxel_formats::trace::{Sample, Truth};

use crate::device::Device;
use crate::methods::calibrated;
use crate::sweeps::{self, Sweep};
use crate::{Effort, Waiting, collinear, files, map, page};

/// Newtons below which a touch is outside the working range, whatever the sweep: the first frames of each
/// press are.
const LEAST_N: f64 = 0.1;
/// An error beyond so many times the stated accuracy is a failure.
pub(crate) const FAILS: f64 = 3.0;
/// A method is trusted up to where a larger share of frames fails, flagged or not.
const TRUSTED: f64 = 0.01;

/// Status bits that tell that something is wrong.
const FLAGS: [Status; 10] = [
    Status::UNCALIBRATED,
    Status::SATURATED,
    Status::DEAD_TAXEL,
    Status::BRIDGE_FAULT,
    Status::OUT_OF_RANGE,
    Status::STUCK_CHANNEL,
    Status::NOT_SINGLE,
    Status::DISAGREE,
    Status::TEMPERATURE,
    Status::NOISY,
];

/// Those that warn of single force sensors.
const SENSOR_FLAGS: [Status; 2] = [Status::TEMPERATURE, Status::NOISY];

/// What of the finger is mapped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Method {
    Force,
    Point,
    Sensors,
}

impl Method {
    const ALL: [Self; 3] = [Self::Force, Self::Point, Self::Sensors];

    fn name(self) -> &'static str {
        match self {
            Self::Force => "force / N",
            Self::Point => "contact point / mm",
            Self::Sensors => "force sensors / N",
        }
    }

    /// Each of its values: error, if there is a value, and what accuracy is stated for it.
    fn errors(
        self,
        estimate: &Estimate,
        truth: &Truth,
        record: &Calibration,
    ) -> Vec<(Option<f64>, f64)> {
        let residual = |residual: &[f32; 3]| {
            residual.iter().map(|r| f64::from(*r).powi(2)).sum::<f64>().sqrt()
        };
        match self {
            Self::Force => {
                let stated =
                    record.taxels.as_ref().map_or(0.0, |taxels| residual(&taxels.residual));
                let found = [estimate.force.x, estimate.force.y, estimate.force.z];
                vec![(distance(found, truth.force), stated)]
            }
            Self::Point => {
                let found = estimate.point.ok();
                let off = found.zip(truth.point[0]).zip(truth.point[1]);
                let error = off.map(|((found, x), y)| {
                    (f64::from(found.x.0) - x).hypot(f64::from(found.y.0) - y)
                });
                vec![(error, POINT_MM)]
            }
            Self::Sensors => {
                let of = estimate.sensors.iter().zip(&truth.sensors).zip(&record.sensors);
                of.filter_map(|((found, truth), sensor)| {
                    let stated = residual(&sensor.as_ref()?.residual);
                    Some((distance([found.x, found.y, found.z], *truth), stated))
                })
                .collect()
            }
        }
    }

    /// Bits that withhold nothing, but warn of this method.
    fn warned(self, status: Status) -> bool {
        let flags = if self == Self::Sensors { &SENSOR_FLAGS[..] } else { &FLAGS };
        flags.iter().any(|flag| status.contains(*flag))
    }
}

/// What the documentation states of the centroid: 0.6 mm RMS in the middle of the pad, 1 mm out to its edge.
const POINT_MM: f64 = 1.0;

fn distance(found: [Measured<Newtons>; 3], truth: [Option<f64>; 3]) -> Option<f64> {
    let mut squares = 0.0;
    for (found, truth) in found.into_iter().zip(truth) {
        squares += (f64::from(found.ok()?.0) - truth?).powi(2);
    }
    Some(squares.sqrt())
}

/// Counts of one method at one value of a sweep.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Count {
    pub frames: usize,
    pub flagged: usize,
    /// Beyond [`FAILS`] times the stated accuracy, or without a value.
    pub failed: usize,
    pub silent: usize,
    squares: f64,
    valued: usize,
    stated: f64,
}

impl Count {
    pub(crate) fn add(&mut self, error: Option<f64>, stated: f64, warned: bool) {
        let flagged = warned || error.is_none();
        let fails = error.is_none_or(|error| error > FAILS * stated);
        self.frames += 1;
        self.flagged += usize::from(flagged);
        self.failed += usize::from(fails);
        self.silent += usize::from(fails && !flagged);
        self.stated += stated;
        if let Some(error) = error {
            self.squares += error * error;
            self.valued += 1;
        }
    }

    fn merge(&mut self, other: &Self) {
        self.frames += other.frames;
        self.flagged += other.flagged;
        self.failed += other.failed;
        self.silent += other.silent;
        self.squares += other.squares;
        self.valued += other.valued;
        self.stated += other.stated;
    }

    /// RMS of the values that were given.
    pub(crate) fn error(&self) -> Option<f64> {
        (self.valued > 0).then(|| (self.squares / self.valued as f64).sqrt())
    }

    pub(crate) fn stated(&self) -> f64 {
        self.stated / self.frames.max(1) as f64
    }

    pub(crate) fn share(&self, of: usize) -> f64 {
        of as f64 / self.frames.max(1) as f64
    }
}

/// A method over a sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    pub(crate) method: &'static str,
    pub(crate) sweep: &'static str,
    pub(crate) points: Vec<Point>,
}

/// At one value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    pub value: f64,
    /// The value is in the working range.
    pub within: bool,
    pub count: Count,
    /// Of them the frames in the working range: none where the value is not.
    pub working: Count,
}

/// What it all comes to: shares of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Totals {
    /// Frames judged, and how many of them lie within the working range.
    pub frames: [usize; 2],
    /// Silent failures, over all and within the working range.
    pub silent: [f64; 2],
    /// Flagged within the working range.
    pub false_flags: f64,
}

/// Maps every method over every sweep, over the devices.
///
/// # Errors
/// A fit failed, or it was stopped.
pub fn measure(effort: &Effort, waiting: Waiting<'_>) -> anyhow::Result<Vec<Map>> {
    let sweeps = sweeps::all();
    let mut maps: Vec<Map> = Vec::new();
    let of = effort.devices.len() * sweeps.len();
    let mut done = 0;
    for seed in &effort.devices {
        let record = calibrated(&Device::new(*seed)?, effort, waiting.stop)?;
        let mut own = Vec::new();
        for sweep in &sweeps {
            anyhow::ensure!(!waiting.stop.load(Ordering::Relaxed), "stopped");
            own.extend(over(sweep, *seed, &record)?);
            done += 1;
            (waiting.progress)(done as f64 / of as f64, sweep.name);
        }
        own.push(collinear::map(*seed));
        if maps.is_empty() {
            maps = own;
        } else {
            for (map, own) in maps.iter_mut().zip(&own) {
                for (point, own) in map.points.iter_mut().zip(&own.points) {
                    point.count.merge(&own.count);
                    point.working.merge(&own.working);
                }
            }
        }
    }
    Ok(maps)
}

fn over(sweep: &Sweep, device: u64, record: &Calibration) -> anyhow::Result<Vec<Map>> {
    let mut maps = Method::ALL.map(|method| Map {
        method: method.name(),
        sweep: sweep.name,
        points: Vec::new(),
    });
    for value in &sweep.values {
        let within = (sweep.within)(*value);
        let counts = judge(&(sweep.run)(device, *value)?, record);
        for (map, [count, loaded]) in maps.iter_mut().zip(counts) {
            let working = if within { loaded } else { Count::default() };
            map.points.push(Point { value: *value, within, count, working });
        }
    }
    Ok(maps.into())
}

/// Frames in contact, one by one: all, and those with a load of the working range.
fn judge(samples: &[Sample], record: &Calibration) -> [[Count; 2]; Method::ALL.len()] {
    let (finger, mut state) = Finger::new(Some(record.clone()));
    let mut counts = [[Count::default(); 2]; Method::ALL.len()];
    for sample in samples {
        let estimate = finger.estimate(&mut state, &sample.scan);
        if sample.truth.contact != Some(true) {
            continue;
        }
        let loaded = sample.truth.force[2].is_some_and(|fz| fz >= LEAST_N);
        for ([all, working], method) in counts.iter_mut().zip(Method::ALL) {
            for (error, stated) in method.errors(&estimate, &sample.truth, record) {
                let warned = method.warned(estimate.status);
                all.add(error, stated, warned);
                if loaded {
                    working.add(error, stated, warned);
                }
            }
        }
    }
    counts
}

impl Map {
    /// The last value, coming from the harmless ones, up to which the method can be trusted.
    #[must_use]
    pub fn boundary(&self) -> Option<f64> {
        let trusted = |point: &&Point| point.count.share(point.count.failed) <= TRUSTED;
        self.points.iter().take_while(trusted).last().map(|point| point.value)
    }
}

/// Sums up.
#[must_use]
pub fn totals(maps: &[Map]) -> Totals {
    let (mut all, mut within) = (Count::default(), Count::default());
    for point in maps.iter().flat_map(|map| &map.points) {
        all.merge(&point.count);
        within.merge(&point.working);
    }
    Totals {
        frames: [all.frames, within.frames],
        silent: [all.share(all.silent), within.share(within.silent)],
        false_flags: within.share(within.flagged),
    }
}

/// The table `failures.csv`.
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

/// What each map comes to: `boundaries.csv`.
#[must_use]
pub fn boundaries(maps: &[Map]) -> String {
    let mut table = String::from(
        "method,sweep,trusted_up_to,frames,silent,silent_within_range,flagged_within_range\n",
    );
    for map in maps {
        let totals = totals(std::slice::from_ref(map));
        let boundary = map.boundary().map(|value| value.to_string()).unwrap_or_default();
        let ([frames, _], [silent, within]) = (totals.frames, totals.silent);
        let _ = writeln!(
            table,
            "{},\"{}\",{boundary},{frames},{silent:.5},{within:.5},{:.5}",
            map.method, map.sweep, totals.false_flags
        );
    }
    table
}

/// Writes tables, picture and page into `folder`.
///
/// # Errors
/// One of them cannot be written.
pub fn write(maps: &[Map], folder: &Path) -> anyhow::Result<()> {
    files::write(&folder.join("failures.csv"), &csv(maps))?;
    files::write(&folder.join("boundaries.csv"), &boundaries(maps))?;
    files::write(&folder.join("failures.svg"), &map::draw(maps)?)?;
    files::write(&folder.join("failures.html"), &page::failures(maps))
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
        Map { method: "force / N", sweep: "load / N", points: points.collect() }
    }

    #[test]
    fn a_failure_is_silent_only_where_the_value_stands_and_nothing_warns() {
        let map = map(&[
            (1.0, Some(2.9), false),
            (2.0, Some(3.1), false),
            (3.0, Some(9.0), true),
            (4.0, None, false),
        ]);
        assert_eq!(map.boundary(), Some(1.0));
        let totals = totals(&[map]);
        assert_eq!((totals.frames, totals.silent, totals.false_flags), ([4, 1], [0.25, 0.0], 0.0));
    }

    #[test]
    fn a_flag_within_the_working_range_is_a_false_one() {
        assert_eq!(totals(&[map(&[(1.0, Some(0.1), true)])]).false_flags, 1.0);
    }
}
