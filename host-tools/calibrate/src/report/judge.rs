//! Report of a finger's calibration, ready to be printed or drawn.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::finger::Channel;
use crate::recording::Recording;
use nalgebra::Matrix3;
use serde::Serialize;
use taxel::calibration::Calibration;
use taxel::estimate::array::WrenchMethod;
use taxel::estimate::quantised::{GROUP, Net};
use taxel::scan::SENSORS;
use taxel_regress::error::FitError;
use taxel_regress::network::Progress;

use super::channels::channels;
use super::coverage::{self, Coverage};
use super::doubts::{self, bridges, condition, taxels};
use super::figures::{Figures, figures};
use super::map::{self, ErrorMap};
use super::papers::{self, Printed, Requirement};
use super::series::{self, Kind, Series};
use super::stated::{Stated, stated};
use super::verdict::{self, HeldOut, Quantity, Verdict, verdict};

/// Columns of a force's components.
const FORCES: [&str; 3] = ["fx_n", "fy_n", "fz_n"];
/// Least force with a meaningful direction, newtons.
const LEAST_FORCE: f64 = 0.3;

/// Report of a calibration.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Uses that the measured errors allow.
    pub verdict: Verdict,
    /// Origin of each simulated recording, in full sentences.
    pub simulated: Vec<String>,
    /// Contents of the calibration.
    pub about: About,
    /// Warnings, in full sentences.
    pub warnings: Vec<String>,
    /// Results on each judged recording.
    pub trials: Vec<Trial>,
    /// Error of force and place by region of the pad.
    pub errors: Vec<ErrorMap>,
    /// Coverage of the stated errors.
    pub stated: Vec<Stated>,
    /// Columns of the recordings and their use.
    pub channels: Vec<Channel>,
    /// Coverage of the measuring range by the recordings.
    pub coverage: Vec<Coverage>,
    /// Figures that the papers print for such sensors.
    pub papers: Vec<Printed>,
    /// Harmon's requirements ([TactileEnc]) next to the figures found.
    pub requirements: Vec<Requirement>,
}

/// Contents of the record.
#[derive(Clone, Debug, Serialize)]
pub struct About {
    /// Serial number of the finger.
    pub serial: String,
    /// Date of the calibration, seconds since 1970-01-01 UTC.
    pub date: u64,
    /// Calibrated parts, each in a line.
    pub parts: Vec<Part>,
}

/// A calibrated part.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Part {
    /// Name of the part: `finger`, `skin`, `slip`, `s0` …, `array`, or `table`.
    pub name: String,
    /// Estimator of the part.
    pub model: String,
    /// RMS error that the record states, in the units below; empty if it has none.
    ///
    /// That of a finger's net and array is on rows left out of the fit.
    pub residual: Vec<f64>,
    /// Units of the estimated quantities.
    pub units: Vec<&'static str>,
    /// Noise of a channel in one frame, unloaded, fraction of full scale.
    pub noise: Option<f64>,
    /// Condition number of S; none for nets.
    pub condition: Option<f64>,
    /// Condition number of the signals of the fit, or of the judged ones if those are unknown.
    pub condition_of_data: Option<f64>,
}

/// Results of the calibration on one recording.
#[derive(Clone, Debug, Serialize)]
pub struct Trial {
    /// File of the recording.
    pub recording: String,
    /// Duration in seconds.
    pub seconds: f64,
    /// Rows a second.
    pub rate_hz: f64,
    /// Figures of each reference column.
    pub figures: Vec<Figures>,
    /// Error of the force's direction, for forces of 0.3 N and more.
    pub angle: Option<Angle>,
    /// Series for the plots.
    #[serde(skip)]
    pub(crate) series: Vec<Series>,
}

/// Errors of the direction of a force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Angle {
    /// Root mean square error, degrees.
    pub rms_deg: f64,
    /// Largest error, degrees.
    pub max_deg: f64,
    /// Number of rows.
    pub rows: usize,
}

/// Judges `calibration` on the recordings `judged`; `fitted` are those of the fit, if known.
///
/// `hidden` tells of each judged recording whether the clock of its reference may hide a lag of the
/// finger; it is empty if all labels have the finger's clock. Forces are judged at rest in such a
/// recording.
///
/// # Errors
///
/// `stop` became true.
pub fn judge(
    calibration: &Calibration,
    judged: &[Recording],
    fitted: &[Recording],
    hidden: &[bool],
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Report, FitError> {
    let hides = |i: usize| hidden.get(i).copied().unwrap_or(false);
    let of = judged.iter().chain(fitted).map(|recording| recording.samples.len()).sum();
    let mut before = 0;
    let mut run = |recording: &Recording| {
        let series = series::run(calibration, recording, &mut |row| {
            progress(Progress { part: recording.name.clone(), step: before + row, of, error: 0.0 });
            !stop.load(Ordering::Relaxed)
        });
        before += recording.samples.len();
        series
    };
    let trials = judged.iter().enumerate();
    let trials: Vec<Trial> = trials.map(|(i, r)| trial(r, run(r), hides(i))).collect();
    let seen: Vec<Vec<Series>> = fitted.iter().map(run).collect();
    if stop.load(Ordering::Relaxed) {
        return Err(FitError::Stopped);
    }
    let heard: Vec<Vec<Series>> = trials.iter().map(|trial| trial.series.clone()).collect();
    let coverage = coverage::maps(&seen, &heard);
    let mut warnings = doubts::not_held_out(judged, fitted);
    let held_out = HeldOut::of(fitted.is_empty(), &warnings);
    warnings.extend(doubts::doubts(calibration, fitted));
    let about = about(calibration, if fitted.is_empty() { judged } else { fitted });
    let report = assemble(about, warnings, trials, coverage, (&verdict::of_finger(), held_out));
    Ok(Report { channels: channels(calibration, judged), ..report })
}

/// Assembles the report with its verdict and adds warnings about coverage.
pub(crate) fn assemble(
    about: About,
    mut warnings: Vec<String>,
    trials: Vec<Trial>,
    coverage: Vec<Coverage>,
    (quantities, held_out): (&[Quantity], HeldOut),
) -> Report {
    for map in &coverage {
        if let Some(percent) = map.beyond_percent
            && percent >= 1.0
        {
            warnings.push(format!(
                "{percent:.0} % of the judged rows lie where nothing was fitted to ({} over {}): \
                 estimates there are extrapolated",
                map.y, map.x
            ));
        }
    }
    let stated = stated(&trials);
    let errors = map::maps(quantities, &trials);
    let mut verdict = verdict(quantities, &trials, &stated, held_out);
    verdict.add_regions(&errors);
    Report {
        verdict,
        simulated: Vec::new(),
        errors,
        stated,
        channels: Vec::new(),
        about,
        papers: papers::PRINTED.to_vec(),
        requirements: requirements(&trials),
        warnings,
        trials,
        coverage,
    }
}

fn about(calibration: &Calibration, recordings: &[Recording]) -> About {
    let bias = calibration.bias();
    let mut parts = Vec::new();
    let condition_of_data = condition(&taxels(&bias, recordings));
    if let (Some(taxels_of), Some(net)) = (&calibration.taxels, &calibration.net) {
        let outputs = net.outputs();
        parts.push(Part {
            name: "finger".into(),
            model: net_model(net),
            residual: taxels_of.residual.iter().take(outputs).map(|r| f64::from(*r)).collect(),
            units: vec!["N"; outputs],
            noise: Some(f64::from(taxels_of.bias.noise)),
            condition: None,
            condition_of_data,
        });
    }
    if let Some(skin) = &calibration.model {
        let model = if skin.shear {
            format!("one contact's field, with shear up to {:.2} of f_z", skin.friction)
        } else {
            "one contact's field, without shear".into()
        };
        parts.push(Part { name: "skin".into(), model, condition_of_data, ..Part::default() });
    }
    if let Some(slip) = &calibration.slip {
        let [friction, _] = slip.usual;
        let [radius, _] = slip.surface.radius;
        parts.push(Part {
            name: "slip".into(),
            model: format!(
                "limit surface, friction {friction:.2} until felt, contact radius {radius:.2} mm at 1 N; \
                 warns below a margin of {:.2}",
                slip.warn
            ),
            ..Part::default()
        });
    }
    for i in 0..SENSORS {
        let Some(sensor) = &calibration.sensors[i] else { continue };
        let s = Matrix3::from_fn(|row, column| f64::from(sensor.sensitivity.0[row][column]));
        let singular = s.singular_values();
        parts.push(Part {
            name: format!("s{i}"),
            model: "f = S(u − b)".into(),
            residual: sensor.residual.map(f64::from).to_vec(),
            units: vec!["N"; 3],
            noise: Some(f64::from(sensor.bias.noise)),
            condition: (singular.min() > 0.0).then(|| singular.max() / singular.min()),
            condition_of_data: condition(&bridges(&bias, i, recordings)),
        });
    }
    if let Some(array) = &calibration.array {
        let model = match array.method {
            WrenchMethod::Sum(_) => "wrench: sum of the sensors' forces and moments",
            WrenchMethod::Matrix(_) => "wrench: 6×12 matrix of the sensors' signals",
        };
        parts.push(Part {
            name: "array".into(),
            model: model.into(),
            residual: array.residual.map(f64::from).to_vec(),
            units: vec!["N"; 3],
            ..Part::default()
        });
    }
    About { serial: calibration.serial.to_string(), date: calibration.date, parts }
}

/// Description of a net: shape and number format.
fn net_model(net: &Net) -> String {
    let (units, skip, form) = match net {
        Net::Float(net) => (net.units.len(), net.skip.is_some(), ""),
        Net::Quantised(net) => (GROUP * net.hidden.len(), net.skip.is_some(), ", in 16 bits"),
    };
    let skip = if skip { ", linear path past them" } else { "" };
    format!("16 taxels → {units} tanh units → {}{skip}{form}", net.outputs())
}

fn trial(recording: &Recording, mut series: Vec<Series>, hidden: bool) -> Trial {
    if hidden {
        series::leave_changing_out(&mut series, recording);
    }
    let time = |sample: Option<&taxel_files::trace::Sample>| sample.map_or(0, |s| s.scan.time.0);
    let begin = time(recording.samples.first());
    let seconds = time(recording.samples.last()).saturating_sub(begin) as f64 * 1e-6;
    Trial::new(recording.name.clone(), seconds, recording.samples.len(), series)
}

impl Trial {
    /// Judges the series of a recording; `seconds` is zero if the recording has no times.
    pub(crate) fn new(recording: String, seconds: f64, rows: usize, series: Vec<Series>) -> Self {
        let rows = rows.saturating_sub(1) as f64;
        let mut trial = Self {
            recording,
            seconds,
            rate_hz: if seconds > 0.0 { rows / seconds } else { 0.0 },
            figures: Vec::new(),
            angle: angle(&series),
            series,
        };
        trial.judge();
        trial
    }

    fn judge(&mut self) {
        for one in &self.series {
            let together = |other: &&Series| {
                other.kind.group() == one.kind.group()
                    && other.kind != one.kind
                    && !matches!(one.kind, Kind::Point(_))
            };
            let others: Vec<&Series> = self.series.iter().filter(together).collect();
            self.figures.extend(figures(one, &others));
        }
    }
}

fn angle(series: &[Series]) -> Option<Angle> {
    let find = |axis: usize| series.iter().find(|s| s.kind.name() == FORCES[axis]);
    let [x, y, z] = [find(0)?, find(1)?, find(2)?];
    let norm = |v: [f64; 3]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let degrees: Vec<f64> = (0..z.reference.len())
        .filter_map(|row| {
            let truth = [x, y, z].map(|s| s.reference[row]);
            let found = [x.estimate[row]?, y.estimate[row]?, z.estimate[row]?];
            let size = norm(truth) * norm(found);
            let dot: f64 = truth.iter().zip(found).map(|(t, f)| t * f).sum();
            (norm(truth) >= LEAST_FORCE && size > 0.0)
                .then(|| (dot / size).clamp(-1.0, 1.0).acos().to_degrees())
        })
        .collect();
    let rows = degrees.len();
    (rows > 0).then(|| Angle {
        rms_deg: (degrees.iter().map(|d| d * d).sum::<f64>() / rows as f64).sqrt(),
        max_deg: degrees.iter().copied().fold(0.0, f64::max),
        rows,
    })
}

fn requirements(trials: &[Trial]) -> Vec<Requirement> {
    let all = || trials.iter().flat_map(|trial| &trial.figures);
    let worst = |of: fn(&Figures) -> Option<f64>, unit: &str, most: bool| {
        let known = all().filter(|f| f.unit == unit).filter_map(|f| Some((of(f)?, &f.target)));
        known.reduce(|a, b| if (a.0 > b.0) == most { a } else { b })
    };
    let spatial = worst(|f| Some(f.rmse), "mm", true);
    let sensitivity = worst(|f| f.resolution, "N", true);
    let range = worst(|f| f.dynamic_range, "N", false);
    let rate = trials.iter().map(|trial| trial.rate_hz).filter(|hz| *hz > 0.0).reduce(f64::min);
    vec![
        Requirement {
            required: "spatial resolution 1–2 mm",
            found: spatial.map(|(mm, target)| format!("{mm:.2} mm RMSE ({target})")),
            met: spatial.map(|(mm, _)| mm <= papers::SPATIAL),
        },
        Requirement {
            required: "sensitivity of a few grams",
            found: sensitivity
                .map(|(n, target)| format!("{:.2} mN, {:.2} g ({target})", n * 1e3, n / 9.81e-3)),
            met: sensitivity.map(|(newtons, _)| newtons <= papers::A_FEW_GRAMS),
        },
        Requirement {
            required: "dynamic range 1000 : 1",
            found: range.map(|(range, target)| {
                format!("{range:.0} : 1 over what these recordings span ({target})")
            }),
            met: range.map(|(range, _)| range >= papers::RANGE),
        },
        Requirement {
            required: "time response 100 Hz",
            found: rate.map(|hz| {
                format!("recorded at {hz:.0} Hz; how fast the finger follows is not in a recording")
            }),
            // Too low a rate rules the response out; a sufficient rate does not prove it.
            met: rate.filter(|hz| *hz < 2.0 * papers::RESPONSE).map(|_| false),
        },
    ]
}
