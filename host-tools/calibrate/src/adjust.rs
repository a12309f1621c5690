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
mod presses;

use std::fmt;
use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel::condition::Bias;
use taxel::scan::TAXELS;

use self::bench::{Bench, Judged};
use self::limits::{FADED, LEAST_PRESSES, LEFT, OTHER_FINGER, SETTLING, WEIGHT_US};
use self::presses::{Presses, contacts, presses, renewed};
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
    /// Whether `stop` came before all parts were tried; those kept before are in the record.
    pub stopped: bool,
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
/// `date` is the new record's, in seconds since 1970-01-01 UTC. When `stop` becomes true the parts
/// that were kept before make the record.
///
/// # Errors
///
/// Data that the recordings lack, an invalid result, or `stop` became true before a part was kept.
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
    let Repaired { zeroed, now, mut whole, tried, mut warnings, stopped } =
        repaired(&bench, calibration, &old, progress, stop)?;
    if whole != *calibration {
        whole.date = date;
    }
    whole.validate().map_err(FitError::Record)?;
    let (errors, shares) = bench.errors([&old, &zeroed, &now]);
    let noise = recordings.iter().map(|r| r.reference_noise()[2]).fold(0.0, f64::max);
    // The parts that were not tried may repair what is left.
    let error = bench.felt_error(&now).filter(|_| !stopped);
    let left = left(calibration, noise, &tried, error);
    let unaged = left.is_none() && !tried.iter().any(|tried| tried.kept);
    warnings.extend(left);
    Ok(Adjusted {
        calibration: whole,
        presses: count,
        parts: tried,
        errors,
        shares,
        unaged,
        stopped,
        warnings,
    })
}

/// Record after its parts were tried, with its estimates of the presses.
struct Repaired {
    /// Estimates with a new zero alone.
    zeroed: Judged,
    now: Judged,
    whole: Calibration,
    tried: Vec<Tried>,
    warnings: Vec<String>,
    /// Whether parts are left that were not tried.
    stopped: bool,
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
    let (mut tried, mut warnings) = (Vec::<Tried>::new(), Vec::<String>::new());
    let mut stopped = false;
    'parts: for parts in TRIED {
        if parts.iter().any(|part| tried.iter().any(|t| t.part == *part && t.kept)) {
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
            next = match bench.judge(&part.to_string(), halves, Some(&next), progress, stop) {
                Err(FitError::Stopped) if tried.iter().any(|t| t.kept) => {
                    stopped = true;
                    break 'parts;
                }
                next => next?,
            };
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
    Ok(Repaired { zeroed, now, whole, tried, warnings, stopped })
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
            "{what}{:.1} mN of F_z are left on presses not used, in contact, where the record's own residual and the reference's noise are {:.1} mN; if that is too much, fit again (taxel calibrate fit)",
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
