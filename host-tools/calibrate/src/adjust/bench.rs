//! Finger run over the presses as on the chip, and its errors before and after a part.

mod gains;

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use taxel::calibration::Calibration;
use taxel::condition::Bias;
use taxel::finger::{self, Finger};
use taxel::frame::Status;
use taxel::measured::NoValue;
use taxel::scan::{SENSORS, TAXELS};
use taxel_files::trace::{Truth, sensor_truth_names};

use super::limits::{BETTER, LEAST_PRESSES, SURE, WORSE, ZERO_WORSE};
use super::{Error, Part, Share, fold, renewed};
use crate::evaluate::{self, Against, Only};
use crate::recording::Recording;
use taxel_regress::error::FitError;
use taxel_regress::network::Progress;
use taxel_regress::shear::FORCES;

/// Rows between two reports of progress.
const REPORTED: usize = 512;
/// Number of quantities: force, contact point, and a force on each sensor.
const QUANTITIES: usize = 5 + 3 * SENSORS;

/// Estimates and labels of one row.
#[derive(Clone)]
struct Row {
    /// Estimate, if there is one, and label of each quantity.
    values: [Option<(Option<f64>, f64)>; QUANTITIES],
    /// Whether the label loads the row.
    loaded: bool,
    contact: bool,
    /// Whether there is a contact point.
    point: bool,
}

/// Rows of a press, and the rest before or after it.
#[derive(Clone, Default)]
struct Press {
    rows: Vec<Row>,
    /// Whether each row at rest says contact.
    rest: Vec<bool>,
}

/// Mean square error of one quantity over each press, or a share.
type Series = Vec<Option<f64>>;

/// Presses, and what a record is judged by.
pub(super) struct Bench<'r> {
    pub(super) recordings: &'r [Recording],
    /// Rows of the presses of each recording.
    pub(super) presses: Vec<Vec<Range<usize>>>,
    /// Whether each row of each recording is loaded or at rest, if that is known.
    pub(super) loaded: Vec<Vec<Option<bool>>>,
    /// Whether the presses are weights on a skin that was not pressed harder before.
    pub(super) unpressed: bool,
    /// Parts of the finger that are judged, the whole last.
    pub(super) parts: &'r [Only],
    /// Zero of the first recording.
    pub(super) bias: Bias,
    pub(super) light: Option<Vec<f64>>,
    pub(super) against: Option<Against>,
}

/// Records of the two halves of the presses, and the estimates of each in the other half.
#[derive(Clone)]
pub(super) struct Judged {
    pub(super) halves: [Calibration; 2],
    /// Presses by each part of the finger.
    presses: Vec<Vec<Press>>,
}

impl Bench<'_> {
    /// Runs the finger over all recordings; a part of it that is the same as before is not run.
    pub(super) fn judge(
        &self,
        name: &str,
        halves: [Calibration; 2],
        before: Option<&Judged>,
        progress: &mut dyn FnMut(Progress),
        stop: &AtomicBool,
    ) -> Result<Judged, FitError> {
        let mut presses = Vec::new();
        for (at, only) in self.parts.iter().enumerate() {
            let records = halves.each_ref().map(|record| only.record(record));
            let same = before.filter(|b| b.halves.each_ref().map(|r| only.record(r)) == records);
            presses.push(match same {
                Some(before) => before.presses[at].clone(),
                None => {
                    let part = format!("{name}: {}", by(*only));
                    self.run(&part, *only, &records, progress, stop)?
                }
            });
        }
        Ok(Judged { halves, presses })
    }

    /// Estimates of every press by the record of the other half.
    fn run(
        &self,
        part: &str,
        only: Only,
        records: &[Calibration; 2],
        progress: &mut dyn FnMut(Progress),
        stop: &AtomicBool,
    ) -> Result<Vec<Press>, FitError> {
        let alike = records[0] == records[1];
        let used = if alike { &records[..1] } else { &records[..] };
        let of = used.len() * self.recordings.iter().map(|r| r.samples.len()).sum::<usize>();
        let (mut presses, mut step) = (Vec::new(), 0);
        for ((recording, runs), loaded) in
            self.recordings.iter().zip(&self.presses).zip(&self.loaded)
        {
            let first = presses.len();
            presses.extend(runs.iter().map(|_| Press::default()));
            for (half, record) in used.iter().enumerate() {
                let (finger, mut state) = Finger::new(Some(record.clone()));
                let mut at = 0;
                for (row, sample) in recording.samples.iter().enumerate() {
                    if step % REPORTED == 0 {
                        progress(Progress { part: part.into(), step, of, error: 0.0 });
                        if stop.load(Ordering::Relaxed) {
                            return Err(FitError::Stopped);
                        }
                    }
                    step += 1;
                    let mut scan = sample.scan;
                    only.keep_codes(&mut scan.codes);
                    let estimate = finger.estimate(&mut state, &scan);
                    while runs.get(at).is_some_and(|rows| rows.end <= row) {
                        at += 1;
                    }
                    let Some(last) = runs.len().checked_sub(1) else { continue };
                    let press = first + at.min(last);
                    if !alike && press % 2 == half {
                        continue;
                    }
                    if runs.get(at).is_some_and(|rows| rows.contains(&row)) {
                        let loaded = loaded[row] == Some(true);
                        presses[press].rows.push(self.row(&estimate, &sample.truth, loaded));
                    } else if loaded[row] == Some(false) {
                        presses[press].rest.push(estimate.status.contains(Status::CONTACT));
                    }
                }
            }
        }
        Ok(presses)
    }

    fn row(&self, estimate: &finger::Estimate, truth: &Truth, loaded: bool) -> Row {
        let mut row = [None; QUANTITIES];
        let mut put = |at: usize, found: Result<f32, NoValue>, truth: Option<f64>| {
            let estimated = !matches!(
                found,
                Err(NoValue::NotEstimated | NoValue::Uncalibrated | NoValue::Absent)
            );
            let found = found.ok().map(f64::from);
            row[at] = truth.filter(|_| estimated).map(|truth| (found, truth));
        };
        if let Some(force) = self.against.and_then(|against| against.force(estimate)) {
            for (axis, found) in evaluate::components(force).into_iter().enumerate() {
                put(axis, found, truth.force[axis]);
            }
        }
        if let Ok(point) = estimate.point {
            put(3, Ok(point.x.0), truth.point[0]);
            put(4, Ok(point.y.0), truth.point[1]);
        }
        for (i, force) in estimate.sensors.iter().enumerate() {
            for (axis, found) in evaluate::components(force).into_iter().enumerate() {
                put(5 + 3 * i + axis, found, truth.sensors[i][axis]);
            }
        }
        let contact = estimate.status.contains(Status::CONTACT);
        Row { values: row, loaded, contact, point: estimate.point.is_ok() }
    }

    pub(super) fn fold(
        &self,
        part: Part,
        record: &mut Calibration,
        gains: &[f64],
    ) -> Result<(), FitError> {
        let three = || <[f64; 3]>::try_from(gains).unwrap_or([1.0; 3]);
        match part {
            Part::Bias => *record = renewed(record, &self.bias),
            Part::Light => {
                *record = renewed(record, &self.bias);
                fold::light(record, &gains.try_into().unwrap_or([1.0; TAXELS]))?;
            }
            Part::Skin => fold::stiffness(record, gains.first().copied().unwrap_or(1.0))?,
            Part::Sensor(i) => fold::sensor(record, i, three()),
            Part::Array => fold::array(record, three()),
        }
        Ok(())
    }

    /// Whether a part is kept, and the quantity that decides.
    ///
    /// A zero that ends contacts at rest is judged on the rows that the finger then feels: the
    /// contact that never ended gave a force for touches that the gate hides, as a young finger's.
    pub(super) fn decide(&self, before: &Judged, after: &Judged, zero: bool) -> (bool, String) {
        let [mut best, mut worst]: [Option<(f64, String)>; 2] = [None, None];
        let mut repaired = false;
        for (name, wrong, [b, a]) in self.shares([before, after]) {
            let Some(change) = Change::of(&b, &a).filter(Change::is_better) else { continue };
            let [b, a] = [change.before, change.after].map(|of| shown(of * of, wrong));
            best = Some((1.0, format!("{name} {:.0} → {:.0} %", 100.0 * b, 100.0 * a)));
            repaired |= zero && wrong;
        }
        let worse = if repaired { ZERO_WORSE } else { WORSE };
        for (at, quantity, [b, a]) in self.quantities([before, after], repaired) {
            let Some(change) = Change::of(&b, &a) else { continue };
            let told = format!(
                "{} {} {:.1} → {:.1} {}",
                by(self.parts[at]),
                quantity_name(quantity),
                1e3 * change.before,
                1e3 * change.after,
                if (3..5).contains(&quantity) { "µm" } else { "mN" }
            );
            let ratio = change.after / change.before;
            if change.is_worse(worse) && worst.as_ref().is_none_or(|(most, _)| ratio > *most) {
                worst = Some((ratio, told));
            } else if change.is_better() && best.as_ref().is_none_or(|(least, _)| ratio < *least) {
                best = Some((ratio, told));
            }
        }
        match (worst, best) {
            (Some((_, told)), _) => (false, format!("it makes worse: {told}")),
            (None, Some((_, told))) => (true, told),
            (None, None) => (false, "no quantity gains a twentieth for sure".to_owned()),
        }
    }

    pub(super) fn errors(&self, stages: [&Judged; 3]) -> (Vec<Error>, Vec<Share>) {
        let mean = |squares: &[Option<f64>]| {
            let known: Vec<f64> = squares.iter().flatten().copied().collect();
            known.iter().sum::<f64>() / known.len().max(1) as f64
        };
        let errors = self.quantities(stages, false).into_iter().map(|(at, quantity, squares)| {
            let [before, zeroed, after] = squares.each_ref().map(|squares| mean(squares).sqrt());
            let (by, quantity) = (by(self.parts[at]), quantity_name(quantity));
            Error { by, quantity, before, zeroed, after }
        });
        let shares = self.shares(stages).into_iter().map(|(name, wrong, shares)| {
            let [before, zeroed, after] =
                shares.each_ref().map(|shares| shown(mean(shares), wrong));
            Share { name, before, zeroed, after }
        });
        (errors.collect(), shares.collect())
    }

    /// RMS error of the finger's normal force where it says contact.
    pub(super) fn felt_error(&self, judged: &Judged) -> Option<f64> {
        let last = self.parts.len() - 1;
        let quantities = self.quantities([judged], true).into_iter();
        let (.., [squares]) = quantities.rev().find(|(at, q, _)| (*at, *q) == (last, 2))?;
        let known: Vec<f64> = squares.into_iter().flatten().collect();
        Some((known.iter().sum::<f64>() / known.len() as f64).sqrt())
    }

    /// Mean square errors over each press, of every quantity that is known in all stages.
    ///
    /// All stages are judged on the same rows; with `felt`, on those with contact in the last.
    fn quantities<const N: usize>(
        &self,
        stages: [&Judged; N],
        felt: bool,
    ) -> Vec<(usize, usize, [Series; N])> {
        let mut quantities = Vec::new();
        for at in 0..self.parts.len() {
            // The whole finger tells of each sensor what the sensors alone tell. A block of the
            // array's matrix is no force on its sensor.
            let told = |quantity: &usize| {
                let sensor = quantity.checked_sub(5).map(|at| at / 3);
                sensor.is_none_or(|i| {
                    at + 1 == self.parts.len() && !fold::is_block(&stages[0].halves[0], i)
                })
            };
            for quantity in (0..QUANTITIES).filter(told) {
                let mut of: [Series; N] = std::array::from_fn(|_| Vec::new());
                for press in 0..stages[0].presses[at].len() {
                    let rows = stages.map(|judged| &judged.presses[at][press].rows[..]);
                    match squares(rows, quantity, felt) {
                        Some(squares) => {
                            of.iter_mut()
                                .zip(squares)
                                .for_each(|(of, square)| of.push(Some(square)));
                        }
                        None => of.iter_mut().for_each(|of| of.push(None)),
                    }
                }
                if of[0].iter().any(Option::is_some) {
                    quantities.push((at, quantity, of));
                }
            }
        }
        quantities
    }

    /// Share of rows at rest with contact, and of loaded rows without a contact point.
    ///
    /// Both are of the whole finger, and true for the one that a contact at rest is.
    fn shares<const N: usize>(
        &self,
        stages: [&Judged; N],
    ) -> Vec<(&'static str, bool, [Series; N])> {
        let of = |share: &dyn Fn(&Press) -> Option<f64>| {
            stages.map(|judged| {
                judged.presses.last().into_iter().flatten().map(share).collect::<Series>()
            })
        };
        let rest = of(&|press| share(press.rest.iter().copied()));
        let pointless =
            of(&|press| share(press.rows.iter().filter(|row| row.loaded).map(|row| !row.point)));
        let known = |series: &[Series; N]| series.iter().flatten().any(Option::is_some);
        let points = pointless.iter().flatten().flatten().any(|share| *share < 1.0);
        let rest = known(&rest).then_some(("contact at rest", true, rest));
        let points = points.then_some(("rows with a contact point", false, pointless));
        rest.into_iter().chain(points).collect()
    }
}

/// Share of true rows.
fn share(rows: impl Iterator<Item = bool>) -> Option<f64> {
    let (all, wrong) =
        rows.fold((0.0, 0.0), |(all, wrong), row| (all + 1.0, wrong + f64::from(row)));
    (all > 0.0).then(|| wrong / all)
}

/// Share as it is printed: one of wrong rows as it is, otherwise that of the right ones.
fn shown(share: f64, wrong: bool) -> f64 {
    if wrong { share } else { 1.0 - share }
}

fn by(only: Only) -> &'static str {
    match only {
        Only::Both => "finger",
        Only::Matrix => "matrix",
        Only::Array => "force sensors",
    }
}

fn quantity_name(quantity: usize) -> String {
    let names = FORCES.map(str::to_owned).into_iter().chain(evaluate::POINT.map(str::to_owned));
    let mut names = names.chain((0..SENSORS).flat_map(sensor_truth_names));
    names.nth(quantity).unwrap_or_default()
}

/// Mean square error of a quantity in each stage, over the rows that all stages have.
///
/// A touch that reads zero counts with its force.
fn squares<const N: usize>(stages: [&[Row]; N], quantity: usize, felt: bool) -> Option<[f64; N]> {
    let size = |row: &Row| {
        let first = if quantity < 3 { 0 } else { quantity - (quantity - 5) % 3 };
        let force = row.values[first..first + 3].iter().flatten();
        force.map(|(_, truth)| truth.powi(2)).sum::<f64>()
    };
    let (mut sums, mut count) = ([0.0; N], 0.0);
    for at in 0..stages[0].len() {
        let rows = stages.map(|rows| &rows[at]);
        let known = rows.iter().all(|row| row.values[quantity].is_some());
        if !known || felt && !rows[N - 1].contact {
            continue;
        }
        count += 1.0;
        for (sum, row) in sums.iter_mut().zip(rows) {
            let Some((found, truth)) = row.values[quantity] else { continue };
            *sum += evaluate::square(found, truth, || size(row));
        }
    }
    (count > 0.0).then(|| sums.map(|sum| sum / count))
}

/// Change of a quantity's error, over the presses that both know.
struct Change {
    before: f64,
    after: f64,
    /// Mean difference of the squared errors in its standard errors, positive if it grew.
    grown: f64,
}

impl Change {
    fn of(before: &[Option<f64>], after: &[Option<f64>]) -> Option<Self> {
        let pairs = before.iter().zip(after).filter_map(|(b, a)| Some(((*b)?, (*a)?)));
        let pairs: Vec<(f64, f64)> = pairs.collect();
        let n = pairs.len() as f64;
        if pairs.len() < LEAST_PRESSES {
            return None;
        }
        let mean = |of: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / n;
        let grown = mean(&|(b, a)| a - b);
        let variance = mean(&|(b, a)| (a - b - grown).powi(2)) / (n - 1.0);
        Some(Self {
            before: mean(&|(b, _)| *b).sqrt(),
            after: mean(&|(_, a)| *a).sqrt(),
            grown: grown / variance.sqrt().max(f64::MIN_POSITIVE),
        })
    }

    fn is_better(&self) -> bool {
        self.grown < -SURE && self.after < BETTER * self.before
    }

    fn is_worse(&self, than: f64) -> bool {
        self.grown > SURE && self.after > than * self.before
    }
}
