//! In-place recalibration: ageing found in presses with known forces, and folded into a record.
//!
//! Ageing changes the zero, the light of the LEDs, the gain of the phototransistors, the softness
//! of the skin and the gain of the force sensors; the form of the response stays. Each is a
//! [`Part`] with few unknowns:
//!
//! - The zero is that of the first recording's unloaded stretch.
//! - Light and phototransistor scale a taxel's unloaded reading by the same gain as its signal, so
//!   that the unloaded light is the gain.
//! - The skin's stiffness scales all forces of the matrix by one factor: by Hertz the displacements
//!   depend on forces over Young's modulus alone. Under weights it is looked for only where the skin
//!   was pressed harder before: a first loading is stiffer.
//! - A force sensor with labels of its own has one gain a row of S, the array one a component.
//!
//! Parts are tried one after the other on the finger as the chip runs it. One found from a half of
//! the presses is judged on the other half, by every labelled quantity of matrix, force sensors and
//! both together, on all rows that the labels load or the finger feels. A part is kept if it makes
//! one better and none worse. Contact at rest and the share of rows with a contact point count as
//! well, for a part alone.

mod bench;
mod fold;
mod limits;

use std::fmt;
use std::ops::Range;
use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel::condition::Bias;
use taxel::finger::Finger;
use taxel::frame::Status;
use taxel::scan::TAXELS;

use self::bench::{Bench, Judged};
use self::limits::{
    FADED, HARDER, LEAST_PRESSES, LEFT, OTHER_FINGER, SETTLE_US, SETTLING, WEIGHT_US,
};
use crate::evaluate::{self, Only};
use crate::recording::Recording;
use taxel_regress::error::FitError;
use taxel_regress::network::Progress;

/// Result of an adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Adjusted {
    /// The adjusted calibration; the given one if no part was kept.
    pub calibration: Calibration,
    /// Number of presses found.
    pub presses: usize,
    /// Parts that were tried, in their order.
    pub parts: Vec<Tried>,
    /// Error of every labelled quantity.
    pub errors: Vec<Error>,
    /// Shares of rows that show what a zero repairs.
    pub shares: Vec<Share>,
    /// Whether nothing was kept and the record is as good as in its fit.
    pub unaged: bool,
    /// Warnings for the user, in full sentences.
    pub warnings: Vec<String>,
}

impl Adjusted {
    /// Gains of a part that was kept.
    #[must_use]
    pub fn gains(&self, part: Part) -> Option<&[f64]> {
        let kept = self.parts.iter().find(|tried| tried.part == part && tried.kept);
        kept.map(|tried| &tried.gains[..])
    }
}

/// A part of the record that ages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Zero of all channels.
    Bias,
    /// One gain a taxel, from its unloaded light.
    Light,
    /// Stiffness of the skin, as a multiple of that in calibration.
    Skin,
    /// Gains in x, y, z of the force sensor of this number.
    Sensor(usize),
    /// Gains in x, y, z of all force sensors together.
    Array,
}

/// Parts in the order in which they are tried, unless one is kept already.
///
/// A dimmer light and a softer skin hide each other in the normal force: they are tried together.
const TRIED: &[&[Part]] = &[
    &[Part::Bias],
    &[Part::Light],
    &[Part::Light, Part::Skin],
    &[Part::Skin],
    &[Part::Sensor(0)],
    &[Part::Sensor(1)],
    &[Part::Sensor(2)],
    &[Part::Sensor(3)],
    &[Part::Array],
];

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bias => f.write_str("zero"),
            Self::Light => f.write_str("light of the taxels"),
            Self::Skin => f.write_str("stiffness of the skin"),
            Self::Sensor(i) => write!(f, "s{i}"),
            Self::Array => f.write_str("force sensors"),
        }
    }
}

/// Outcome of a part.
#[derive(Clone, Debug, PartialEq)]
pub struct Tried {
    /// The part.
    pub part: Part,
    /// Its gains from all presses; none of the zero.
    pub gains: Vec<f64>,
    /// Whether the record has it.
    pub kept: bool,
    /// The quantity that decided, with its errors before and after.
    pub why: String,
}

/// RMS errors of a quantity over the presses, in newtons or mm.
#[derive(Clone, Debug, PartialEq)]
pub struct Error {
    /// Part of the finger that tells it: `matrix`, `force sensors` or `finger`.
    pub by: &'static str,
    /// Name of the label's column.
    pub quantity: String,
    /// Error with the given record.
    pub before: f64,
    /// Error with a new zero alone.
    pub zeroed: f64,
    /// Error with the adjusted record, on presses that its gains were not found from.
    pub after: f64,
}

/// Share of rows of the whole finger, 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Share {
    /// Name: `contact at rest` or `rows with a contact point`.
    pub name: &'static str,
    /// Share with the given record.
    pub before: f64,
    /// Share with a new zero alone.
    pub zeroed: f64,
    /// Share with the adjusted record.
    pub after: f64,
}

/// Sets the force of every weight in `recording` to `newtons` straight down.
///
/// A shorter contact than that of a weight is a press by hand, whose force is not known. The
/// beginning and end of each contact keep their reference.
///
/// # Errors
///
/// There is no unloaded stretch.
pub fn weigh(
    calibration: &Calibration,
    recording: &mut Recording,
    newtons: f64,
) -> Result<(), FitError> {
    let bias = recording.bias(calibration.warmth.as_ref())?;
    for rows in contacts(&renewed(calibration, &bias), recording) {
        let time = |row: usize| recording.samples[row].scan.time.0;
        if time(rows.end - 1) - time(rows.start) < WEIGHT_US {
            continue;
        }
        let settling = (SETTLING * rows.len() as f64) as usize;
        for row in rows.start + settling..rows.end - settling {
            recording.samples[row].truth.force = [Some(0.0), Some(0.0), Some(newtons)];
        }
    }
    Ok(())
}

/// Adjusts `calibration` to recordings of presses with known reference columns.
///
/// `date` is the new record's, in seconds since 1970-01-01 UTC.
///
/// # Errors
///
/// Data that the recordings lack, an invalid result, or `stop` became true.
pub fn adjust(
    calibration: &Calibration,
    recordings: &[Recording],
    date: u64,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Adjusted, FitError> {
    let first = recordings.first().ok_or(FitError::NoRecording)?;
    let warmth = calibration.warmth.as_ref();
    let bias = first.bias(warmth)?;
    let light = faded(calibration, &bias);
    let labelled = |recording: &Recording| recording.loaded().iter().any(Option::is_some);
    if !recordings.iter().any(labelled) {
        return Err(FitError::Shape {
            part: "no force labels".into(),
            problem: "give --reference or --weight".into(),
        });
    }
    let Presses { presses, loaded, unpressed } = presses(calibration, recordings)?;
    let count = presses.iter().map(Vec::len).sum();
    if count < LEAST_PRESSES {
        return Err(FitError::TooFewRows {
            part: "presses with a known force".into(),
            rows: count,
            least: LEAST_PRESSES,
        });
    }
    let parts = match (&calibration.taxels, &calibration.array) {
        (Some(_), Some(_)) => &[Only::Matrix, Only::Array, Only::Both][..],
        _ => &[Only::Both],
    };
    let against = evaluate::against(calibration);
    let bench = Bench { recordings, presses, loaded, unpressed, parts, bias, light, against };
    let old = bench.judge("as it is", [calibration; 2].map(Clone::clone), None, progress, stop)?;
    let Repaired { zeroed, now, mut whole, tried, mut warnings } =
        repaired(&bench, calibration, &old, progress, stop)?;
    if whole != *calibration {
        whole.date = date;
    }
    whole.validate().map_err(FitError::Record)?;
    let (errors, shares) = bench.errors([&old, &zeroed, &now]);
    let noise = recordings.iter().map(|r| r.reference_noise()[2]).fold(0.0, f64::max);
    let left = left(calibration, noise, &tried, bench.felt_error(&now));
    let unaged = left.is_none() && !tried.iter().any(|tried| tried.kept);
    warnings.extend(left);
    Ok(Adjusted {
        calibration: whole,
        presses: count,
        parts: tried,
        errors,
        shares,
        unaged,
        warnings,
    })
}

/// Presses of each recording, and whether each of its rows is loaded or at rest, if that is known.
struct Presses {
    presses: Vec<Vec<Range<usize>>>,
    loaded: Vec<Vec<Option<bool>>>,
    /// Whether the presses are weights on a skin that was not pressed harder before.
    unpressed: bool,
}

/// Finds the presses with a known force.
///
/// # Errors
///
/// There is no unloaded stretch, or a recording is of another finger.
fn presses(calibration: &Calibration, recordings: &[Recording]) -> Result<Presses, FitError> {
    let mut found = Presses { presses: Vec::new(), loaded: Vec::new(), unpressed: false };
    for recording in recordings {
        let bias = recording.bias(calibration.warmth.as_ref())?;
        if let Some(gains) = faded(calibration, &bias) {
            same_finger(&recording.name, &gains)?;
        }
        let own = renewed(calibration, &bias);
        let known = |rows: &Range<usize>| {
            recording.samples[rows.clone()].iter().any(|sample| {
                let sensors = &sample.truth.sensors;
                sample.truth.force[2].is_some() || sensors.iter().any(|force| force[2].is_some())
            })
        };
        let loaded = at_rest(recording);
        let felt = touched(&own, recording);
        let together = loaded.iter().zip(felt).map(|(loaded, felt)| felt || *loaded == Some(true));
        let runs = joined(runs(&together.collect::<Vec<_>>()), recording);
        let runs: Vec<_> = runs.into_iter().filter(known).collect();
        found.unpressed |= is_weighed(recording) && !is_pressed(&own, recording, &runs);
        found.presses.push(runs);
        found.loaded.push(loaded);
    }
    Ok(found)
}

/// Whether the labels are those of weights: one force throughout.
fn is_weighed(recording: &Recording) -> bool {
    let mut forces = recording.samples.iter().map(|sample| sample.truth.force);
    let mut known = forces.by_ref().filter(|force| force[2].is_some());
    known.next().is_some_and(|first| known.all(|force| force == first))
}

/// Whether most weights stand where the skin was pressed harder before, in the same recording.
///
/// The first loading of a skin is stiffer ([DeMaria2011] fig. 3), until it was pressed as hard.
fn is_pressed(own: &Calibration, recording: &Recording, weights: &[Range<usize>]) -> bool {
    let signals = recording.signals(&own.bias(), own.warmth.as_ref());
    let sizes = |row: usize| signals[row].taxels.unwrap_or_default().map(f32::abs);
    let (mut most, mut row, mut pressed) = ([0.0f32; TAXELS], 0, 0);
    for weight in weights {
        for size in (row..weight.start).map(sizes) {
            most.iter_mut().zip(size).for_each(|(most, size)| *most = most.max(size));
        }
        row = weight.start;
        let under = sizes(weight.start.midpoint(weight.end));
        let half = 0.5 * under.iter().copied().fold(0.0, f32::max);
        let mut bearing = under.iter().zip(most).filter(|(under, _)| **under >= half);
        pressed += usize::from(bearing.all(|(under, most)| most >= HARDER * under));
    }
    2 * pressed > weights.len()
}

/// Record after its parts were tried, with its estimates of the presses.
struct Repaired {
    /// Estimates with a new zero alone.
    zeroed: Judged,
    now: Judged,
    whole: Calibration,
    tried: Vec<Tried>,
    warnings: Vec<String>,
}

/// Tries the parts one after the other, and keeps those that help.
fn repaired(
    bench: &Bench<'_>,
    calibration: &Calibration,
    old: &Judged,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Repaired, FitError> {
    let (mut now, mut whole, mut zeroed) = (old.clone(), calibration.clone(), old.clone());
    let (mut tried, mut warnings) = (Vec::new(), Vec::<String>::new());
    for parts in TRIED {
        if parts.iter().any(|part| tried.iter().any(|t: &Tried| t.part == *part && t.kept)) {
            continue;
        }
        let (mut next, mut aged, mut found) = (now.clone(), whole.clone(), Vec::new());
        for part in *parts {
            let gains = match bench.gains(*part, &next) {
                Ok(Some(gains)) => gains,
                Ok(None) => break,
                Err(why) => {
                    if !warnings.contains(&why) {
                        warnings.push(why);
                    }
                    break;
                }
            };
            let [all, own @ ..] = &gains;
            let mut halves = next.halves.clone();
            for (record, own) in halves.iter_mut().zip(own) {
                bench.fold(*part, record, own)?;
            }
            bench.fold(*part, &mut aged, all)?;
            next = bench.judge(&part.to_string(), halves, Some(&next), progress, stop)?;
            found.push((*part, all.clone()));
        }
        if found.len() < parts.len() {
            continue;
        }
        let zero = *parts == [Part::Bias];
        if zero {
            zeroed = next.clone();
        }
        let (kept, why) = bench.decide(&now, &next, zero);
        if kept {
            (now, whole) = (next, aged);
        } else if parts.len() > 1 {
            continue;
        }
        tried.retain(|tried| !parts.contains(&tried.part));
        tried.extend(found.into_iter().map(|(part, gains)| Tried {
            part,
            gains,
            kept,
            why: why.clone(),
        }));
    }
    Ok(Repaired { zeroed, now, whole, tried, warnings })
}

/// Warning about the error of F_z that is left, if it is large.
fn left(
    calibration: &Calibration,
    noise: f64,
    tried: &[Tried],
    error: Option<f64>,
) -> Option<String> {
    let own = match (&calibration.array, &calibration.taxels) {
        (Some(array), _) => array.residual[2],
        (None, Some(taxels)) => {
            let outputs =
                calibration.net.as_ref().map_or(3, taxel::estimate::quantised::Net::outputs);
            taxels.residual[outputs.clamp(1, 3) - 1]
        }
        (None, None) => calibration.sensors.iter().flatten().next()?.residual[2],
    };
    let (after, own) = (error?, f64::from(own).hypot(noise));
    let none = !tried.iter().any(|tried| tried.kept);
    (after > LEFT * own).then(|| {
        let what = if none { "nothing repairs the record, which stays as it was: " } else { "" };
        format!(
            "{what}{:.1} mN of F_z are left on presses not used, in contact, where the record's own residual and the reference's noise are {:.1} mN; if that is too much, fit anew (taxel calibrate fit)",
            1e3 * after,
            1e3 * own
        )
    })
}

/// Ratio of each taxel's unloaded light to that in the record; `None` if it has not faded.
fn faded(calibration: &Calibration, bias: &Bias) -> Option<Vec<f64>> {
    let (old, new) = (&calibration.taxels.as_ref()?.bias, bias.taxels.as_ref()?);
    let gain = |k: usize| {
        let ratio = f64::from(new.level[k]) / f64::from(old.level[k]);
        if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 }
    };
    let gains: Vec<f64> = (0..TAXELS).map(gain).collect();
    gains.iter().any(|gain| (gain - 1.0).abs() > FADED).then_some(gains)
}

/// Checks that the light of the taxels changed like that of one finger.
fn same_finger(recording: &str, gains: &[f64]) -> Result<(), FitError> {
    let n = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / n;
    let scatter = (gains.iter().map(|g| (g / mean - 1.0).powi(2)).sum::<f64>() / n).sqrt();
    if scatter <= OTHER_FINGER {
        return Ok(());
    }
    Err(FitError::Mismatch {
        recording: recording.into(),
        problem: format!(
            "this looks like another finger: the unloaded light of its taxels scatters by {:.0} % against the record's, where ageing stays below {:.0} %",
            100.0 * scatter,
            100.0 * OTHER_FINGER
        ),
        mend: "give this finger's own calibration, or fit one (taxel calibrate fit)".into(),
    })
}

/// Returns the calibration with another bias, for the parts that have one.
fn renewed(calibration: &Calibration, bias: &Bias) -> Calibration {
    let mut calibration = calibration.clone();
    if let (Some(taxels), Some(bias)) = (&mut calibration.taxels, bias.taxels) {
        taxels.bias = bias;
    }
    for (sensor, bias) in calibration.sensors.iter_mut().zip(bias.bridges) {
        if let (Some(sensor), Some(bias)) = (sensor, bias) {
            sensor.bias = bias;
        }
    }
    calibration
}

/// Rows of each contact, found with the finger's own gate.
fn contacts(calibration: &Calibration, recording: &Recording) -> Vec<Range<usize>> {
    runs(&touched(calibration, recording))
}

/// Whether the finger's own gate is open in each row.
fn touched(calibration: &Calibration, recording: &Recording) -> Vec<bool> {
    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let rows = recording.samples.iter();
    rows.map(|s| finger.estimate(&mut state, &s.scan).status.contains(Status::CONTACT)).collect()
}

/// Ranges of the true rows.
fn runs(rows: &[bool]) -> Vec<Range<usize>> {
    let mut begin = 0;
    let runs = rows.chunk_by(|a, b| a == b).filter_map(|run| {
        let rows = begin..begin + run.len();
        begin = rows.end;
        run[0].then_some(rows)
    });
    runs.collect()
}

/// Joins runs with a short gap: the label's noise parts the beginning and end of a touch.
fn joined(runs: Vec<Range<usize>>, recording: &Recording) -> Vec<Range<usize>> {
    let time = |row: usize| recording.samples[row].scan.time.0;
    let mut joined: Vec<Range<usize>> = Vec::new();
    for run in runs {
        match joined.last_mut() {
            Some(last) if time(run.start) < time(last.end - 1) + SETTLE_US => last.end = run.end,
            _ => joined.push(run),
        }
    }
    joined
}

/// Whether each row is loaded, or at rest; `None` without a label, and soon after a load.
fn at_rest(recording: &Recording) -> Vec<Option<bool>> {
    let mut settled = 0;
    let mut loaded = recording.loaded();
    loaded.resize(recording.samples.len(), None);
    for (loaded, sample) in loaded.iter_mut().zip(&recording.samples) {
        if *loaded == Some(true) {
            settled = sample.scan.time.0 + SETTLE_US;
        } else if sample.scan.time.0 < settled {
            *loaded = None;
        }
    }
    loaded
}
