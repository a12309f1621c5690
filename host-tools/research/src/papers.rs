//! Sensors of the papers, each calibrated and judged on its own scenes by its paper's law.
//!
//! They are the line of four of [DeMaria2011], the feeler of [Ohka2005], the columns of [Ohka2004]
//! and the force sensor of [Ospina2017]. The last one appears alone, and as four under a plane and
//! under an ellipsoid. **To add one**: a line in [`all`].

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, ensure};
use taxel::condition::Signals;
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::wrench::SensorPlaces;
use taxel::scan::COLS;
use taxel::units::Millimetres;
use taxel_calibrate::finger::FitOptions;
use taxel_calibrate::recording::Recording;
use taxel_files::table::Table;
use taxel_files::trace::Sample;
use taxel_papers::column::{CENTRES, quadrants};
use taxel_papers::feeler::Spot;
use taxel_regress::model::Family;
use taxel_regress::table::{self, TableModel, TableOptions, TableRecording};
use taxel_sim::systems::column::LIGHT_PER_MM2;

use crate::device::{FITTED, JUDGED, Moment, run};
use crate::methods::{Group, Method, Said};
use crate::results::Quantity::{self, Angle, Normal, Place, Point, Shear, Torsion};
use crate::truth::{Beyond, LEAST_N};

/// Side of the feeler's image that a phototransistor sees, in µm.
const PIXEL_UM: f32 = 160.0;
/// Shear in newtons below which the feeler's centroid stays in place.
const UNSHEARED_N: f64 = 2e-5;
/// Size of every force of the line's scenes in newtons.
const LINE_N: f64 = 0.2;
/// Loads of the line of four: forces of full size only.
const OF_ONE_SIZE: Holds = |[x, _, z]| x.hypot(z) > 0.999 * LINE_N;
const PRESSED: Holds = |[_, _, z]| z >= LEAST_N;
/// Range of the feeler: from 2 mN on.
const FEELS: Holds = |[_, _, z]| z >= 0.002;
/// Standard deviation of the moment of four bare sensors, N·mm.
const MOMENT: f32 = 0.2;
const PLANE: Surface = Surface::Plane;
/// Change of the scene `array` to an ellipsoid, and its surface.
const UNDER_AN_ELLIPSOID: &[&str] = &["device.surface.ellipsoid=[14, 10, 8]"];
const ELLIPSOID: Surface =
    Surface::Ellipsoid { half_axes: [Millimetres(14.0), Millimetres(10.0), Millimetres(8.0)] };

/// Moments of one sensor on a scene, to fit or to judge.
type Run = Vec<Moment>;

/// A paper's sensor with its law and scenes.
pub(crate) struct Paper {
    pub name: &'static str,
    pub group: Group,
    pub stages: &'static [&'static str],
    fitted: &'static [&'static str],
    pub judged: &'static str,
    /// Changes of these scenes.
    set: &'static [&'static str],
    pub quantities: &'static [Quantity],
    /// Condition on the force in newtons for a moment to be fitted or judged.
    pub holds: Holds,
    fit: fn(&[Run]) -> anyhow::Result<Says>,
}

type Holds = fn([f64; 3]) -> bool;
type Says = Box<dyn FnMut(&Moment) -> Said>;

/// Lists all sensors of the papers.
pub(crate) fn all() -> Vec<Paper> {
    vec![
        Paper {
            name: "DeMaria2011: line of four",
            group: Group::Paper,
            stages: &["DeMaria2011: line of four"],
            fitted: &["line-fit"],
            judged: "line-trial",
            set: &[],
            quantities: &[Place, Angle],
            holds: OF_ONE_SIZE,
            fit: line_of_four,
        },
        Paper {
            name: "Ohka2005: feeler",
            group: Group::Paper,
            stages: &["Ohka2005: feeler, 16 pixels"],
            fitted: &["micro-shear"],
            judged: "micro-shear",
            set: &[],
            quantities: &[Normal, Shear],
            holds: FEELS,
            fit: feeler,
        },
        Paper {
            name: "Ohka2004: four columns",
            group: Group::Paper,
            stages: &["Ohka2004: four columns"],
            fitted: &["column-press", "column-shear"],
            judged: "column-shear",
            set: &[],
            quantities: &[Normal, Shear],
            holds: PRESSED,
            fit: columns,
        },
        Paper {
            name: "Ospina2017: one sensor",
            group: Group::Sensors,
            stages: &["f = S(u - b), one sensor"],
            fitted: &["mems"],
            judged: "mems",
            set: &[],
            quantities: &[Normal, Shear],
            holds: PRESSED,
            fit: one_sensor,
        },
        Paper {
            name: "Ospina2017: four under a plane",
            group: Group::Sensors,
            stages: &["sum of four sensors", "array: wrench as a sum", "array: contact on a plane"],
            fitted: &["array"],
            judged: "array",
            set: &[],
            quantities: &[Normal, Shear, Point, Torsion],
            holds: |[_, _, z]| z >= 0.2,
            fit: |runs| four_sensors(runs, PLANE),
        },
        Paper {
            name: "Ospina2017: four under an ellipsoid",
            group: Group::Sensors,
            stages: &[
                "sum of four sensors",
                "array: wrench as a sum",
                "array: contact on an ellipsoid",
            ],
            fitted: &["array"],
            judged: "array",
            set: UNDER_AN_ELLIPSOID,
            quantities: &[Normal, Shear, Point, Torsion],
            holds: |[_, _, z]| z >= 0.2,
            fit: |runs| four_sensors(runs, ELLIPSOID),
        },
    ]
}

impl Paper {
    /// Calibrates the sensor with this seed and records a run that its fit has not seen.
    ///
    /// # Errors
    /// A built-in scene cannot be run, or the fit failed.
    pub(crate) fn on(&self, device: u64) -> anyhow::Result<(Method, Run)> {
        let fitted = self.fitted.iter().map(|scene| moments(device, scene, self.set, FITTED));
        let fitted = fitted.collect::<anyhow::Result<Vec<Run>>>()?;
        let says = (self.fit)(&fitted).with_context(|| self.name)?;
        let method = Method::new(self.name, self.group, self.stages, says);
        Ok((method, moments(device, self.judged, self.set, JUDGED)?))
    }
}

/// Records a run; its bias comes from its own unloaded beginning.
fn moments(device: u64, scene: &str, set: &[&str], seed: u64) -> anyhow::Result<Run> {
    let samples = run(device, scene, set, seed)?;
    let recording = Recording { name: scene.to_owned(), samples };
    let signals = recording.signals(&recording.bias(None)?, None);
    let moment = |(sample, signals)| Moment { sample, signals, beyond: Beyond::default() };
    Ok(recording.samples.into_iter().zip(signals).map(moment).collect())
}

/// Collects rows of inputs and targets from the moments that have both.
fn rows<const N: usize, const M: usize>(
    runs: &[Run],
    row: impl Fn(&Moment) -> Option<([f64; N], [f64; M])>,
) -> TableRecording {
    let (mut inputs, mut targets, mut times, mut begin) = (vec![], vec![], vec![], 0.0);
    for run in runs {
        for moment in run {
            let Some((x, y)) = row(moment) else { continue };
            inputs.push(x.to_vec());
            targets.push(y.to_vec());
            times.push(begin + moment.sample.scan.time.0 as f64 * 1e-6);
        }
        begin = times.last().copied().unwrap_or_default() + 1.0;
    }
    let table = |letter: char, rows: Vec<Vec<f64>>, count: usize| Table {
        path: PathBuf::from("calibration"),
        names: (0..count).map(|k| format!("{letter}{k}")).collect(),
        others: Vec::new(),
        rows,
        times: times.clone(),
    };
    TableRecording { inputs: table('x', inputs, N), targets: table('y', targets, M) }
}

/// Fits the law of `family`.
fn law(family: Family, rows: TableRecording) -> anyhow::Result<TableModel> {
    let options = TableOptions { family, ..TableOptions::default() };
    Ok(table::fit(&[rows], &options, &mut |_| {}, &AtomicBool::new(false))?.model)
}

fn force(sample: &Sample) -> Option<[f64; 3]> {
    let [x, y, z] = sample.truth.force;
    Some([x?, y?, z?])
}

/// Returns the force of a contact if `holds` accepts it.
pub(crate) fn loaded(sample: &Sample, holds: Holds) -> Option<[f64; 3]> {
    force(sample).filter(|force| sample.truth.contact == Some(true) && holds(*force))
}

/// Fits the line of four to its signals, [DeMaria2011] eqs (3)–(6).
fn line_of_four(runs: &[Run]) -> anyhow::Result<Says> {
    let lights =
        |signals: &Signals| signals.taxels.map(|[a, b, c, d, ..]| [a, b, c, d].map(|c| -c));
    let model = law(
        Family::Row,
        rows(runs, |moment| {
            let [x, _, z] = loaded(&moment.sample, OF_ONE_SIZE)?;
            let angle = z.atan2(x).to_degrees();
            let u = lights(&moment.signals)?.map(f64::from);
            Some((u, [moment.sample.truth.point[0]?, angle]))
        }),
    )?;
    Ok(Box::new(move |moment| {
        let Some(u) = lights(&moment.signals) else { return Said::default() };
        let [place, angle] = first(&model.estimate(&u));
        Said { point: Some([place, 0.0]), angle: Some(angle), ..Said::default() }
    }))
}

/// Fits the feeler, [Ohka2005] eqs (3), (10)–(12).
///
/// The scene shears along x alone, so both axes are given its rows.
fn feeler(runs: &[Run]) -> anyhow::Result<Says> {
    let spot =
        |signals: &Signals| signals.taxels.map(|c| Spot::measure(&c.map(|c| -c), COLS, PIXEL_UM));
    let mut unsheared = (0.0, 0usize);
    for moment in runs.iter().flatten() {
        let at_rest = loaded(&moment.sample, FEELS).is_some_and(|[x, ..]| x.abs() < UNSHEARED_N);
        if let (true, Some(spot)) = (at_rest, spot(&moment.signals)) {
            unsheared = (unsheared.0 + f64::from(spot.centroid[0]), unsheared.1 + 1);
        }
    }
    ensure!(unsheared.1 > 0, "no frame without shear");
    let unsheared = (unsheared.0 / unsheared.1 as f64) as f32;
    let model = law(
        Family::Feeler,
        rows(runs, |moment| {
            let [x, _, z] = loaded(&moment.sample, FEELS)?.map(|newtons| 1e3 * newtons);
            let spot = spot(&moment.signals)?;
            let shift = f64::from(spot.centroid[0] - unsheared);
            Some(([spot.integral.into(), shift, shift], [x, x, z]))
        }),
    )?;
    Ok(Box::new(move |moment| {
        let Some(spot) = spot(&moment.signals) else { return Said::default() };
        let [x, _, z] = first(&model.estimate(&[spot.integral, spot.centroid[0] - unsheared, 0.0]));
        Said { force: [Some(1e-3 * x), Some(0.0), Some(1e-3 * z)], ..Said::default() }
    }))
}

/// Fits the column that is loaded, [Ohka2004] eq. (18).
fn columns(runs: &[Run]) -> anyhow::Result<Says> {
    let areas = |moment: &Moment| {
        let point = moment.sample.truth.point;
        let column = CENTRES.iter().position(|centre| centre.map(Some) == point)?;
        let lights = *quadrants(&moment.signals.taxels?).get(column)?;
        Some(lights.map(|light| light / LIGHT_PER_MM2 as f32))
    };
    let row =
        |moment: &Moment| Some((areas(moment)?.map(f64::from), loaded(&moment.sample, PRESSED)?));
    let model = law(Family::Column, rows(runs, row))?;
    Ok(Box::new(move |moment| {
        let Some(areas) = areas(moment) else { return Said::default() };
        Said { force: first(&model.estimate(&areas)).map(Some), ..Said::default() }
    }))
}

/// Fits f = S(u − b) of one force sensor, [Ospina2017].
fn one_sensor(runs: &[Run]) -> anyhow::Result<Says> {
    let calibration = fitted(runs)?;
    let sensitivity = calibration.sensors[0].clone().context("s0 is not fitted")?.sensitivity;
    Ok(Box::new(move |moment| {
        let force = moment.signals.bridges[0].map(|u| sensitivity.force(u));
        let force = force.map_or([None; 3], |force| force.map(|f| Some(f64::from(f))));
        Said { force, ..Said::default() }
    }))
}

/// Fits four sensors: F = Σ f_i, M = Σ r_i × f_i, and the contact from both.
fn four_sensors(runs: &[Run], surface: Surface) -> anyhow::Result<Says> {
    let sensors = fitted(runs)?.sensors;
    ensure!(sensors.iter().all(Option::is_some), "a sensor is not fitted");
    Ok(Box::new(move |moment| {
        let forces = std::array::from_fn(|i| match (&sensors[i], moment.signals.bridges[i]) {
            (Some(sensor), Some(u)) => sensor.sensitivity.force(u),
            _ => [0.0; 3],
        });
        let wrench = SensorPlaces::default().wrench(&forces);
        let contact = surface.contact(&wrench, MOMENT).ok();
        Said {
            force: wrench.force.map(|f| Some(f64::from(f))),
            point: contact.map(|contact| [contact.place[0], contact.place[1]].map(f64::from)),
            torsion: contact.map(|contact| f64::from(contact.torsion.0)),
            ..Said::default()
        }
    }))
}

fn fitted(runs: &[Run]) -> anyhow::Result<taxel::calibration::Calibration> {
    let recordings: Vec<Recording> = runs
        .iter()
        .map(|run| Recording {
            name: "calibration".into(),
            samples: run.iter().map(|moment| moment.sample).collect(),
        })
        .collect();
    let stop = AtomicBool::new(false);
    let options = FitOptions::default();
    Ok(taxel_calibrate::finger::fit(&recordings, &options, &mut |_| {}, &stop)?.calibration)
}

/// Returns the first N outputs of a law.
fn first<const N: usize>(outputs: &[f32]) -> [f64; N] {
    std::array::from_fn(|i| outputs.get(i).copied().map_or(0.0, f64::from))
}
