//! Methods of the charts, each fitted to one device. **To add one**: a line in [`all`].

mod firmware;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use taxel::condition::Signals;
use taxel::estimate::ContactPoint;
use taxel::estimate::contact_point::{arg_min, centroid};
use taxel::estimate::net::ForceNet;
use taxel::estimate::quantised::QuantisedNet;
use taxel::measured::Measured;
use taxel::scan::{COLS, PITCH, TAXELS};
use taxel_files::table::Table;
use taxel_papers::feeler::Spot;
use taxel_regress::Expansion;
use taxel_regress::model::Family;
use taxel_regress::network::NetOptions;
use taxel_regress::range::largest;
use taxel_regress::table::{self, TableModel, TableOptions, TableRecording};

use crate::device::{Device, Moment};
use crate::effort::Effort;
use crate::truth::Beyond;

pub(crate) use firmware::{calibrated, firmwares};

/// Largest number of rows to fit; a net takes no more.
const ROWS: usize = 4096;
/// Standard deviations that the signals of a row exceed to serve the fit.
const TOUCHED: f32 = 5.0;

/// Output of a method at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Said {
    /// Force components f_x, f_y, f_z in newtons.
    pub force: [Option<f64>; 3],
    /// Contact point x, y in mm.
    pub point: Option<[f64; 2]>,
    /// Torsion about the normal in N·mm.
    pub torsion: Option<f64>,
    /// Angle of the force to the skin in its x–z plane, in degrees.
    pub angle: Option<f64>,
    /// Slip margin: the unused share of the friction.
    pub margin: Option<f64>,
    /// True for gross slip.
    pub slides: Option<bool>,
}

/// Kind of a method, which sets its colour in the charts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// A method of one of the papers.
    Paper,
    /// Linear, or linear in powers of the signals.
    Polynomial,
    /// A net of tanh units.
    Net,
    /// A net of tanh units with a linear bypass.
    Skip,
    /// A net in 16-bit arithmetic.
    Quantised,
    /// A net in 16-bit arithmetic with a linear bypass, or that bypass alone.
    QuantisedSkip,
    /// The force sensors.
    Sensors,
    /// The firmware with the matrix alone.
    Model,
    /// The firmware with matrix and force sensors.
    Finger,
}

/// Rows of the cost table that make up a method.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Stages {
    /// Stages that run one after the other.
    Together(Vec<String>),
    /// The whole finger from codes to wire bytes, with a stage for each kind of scene.
    Whole,
}

/// One fitted method.
pub struct Method {
    /// Name in the tables.
    pub name: String,
    /// Kind of the method.
    pub group: Group,
    /// Stages that make up its cost.
    pub stages: Stages,
    /// Estimator: a moment in, its output out.
    pub says: Box<dyn FnMut(&Moment) -> Said>,
}

impl Method {
    pub(crate) fn new(
        name: &str,
        group: Group,
        stages: &[&str],
        says: impl FnMut(&Moment) -> Said + 'static,
    ) -> Self {
        let stages = Stages::Together(stages.iter().map(|stage| (*stage).to_owned()).collect());
        Self { name: name.to_owned(), group, stages, says: Box::new(says) }
    }

    /// Sets the cost to that of the whole finger.
    pub(crate) fn at_the_cost_of_all(self) -> Self {
        Self { stages: Stages::Whole, ..self }
    }
}

/// Fits all methods to `device`.
///
/// # Errors
/// A fit failed, or was stopped.
pub fn all(
    device: &Device,
    effort: &Effort,
    step: &mut dyn FnMut(&str),
    stop: &AtomicBool,
) -> anyhow::Result<Vec<Method>> {
    let rows = Rows::of(device);
    let mut methods = vec![
        Method::new("arg-min", Group::Paper, &["contact point: arg-min"], |moment| {
            placed(moment, arg_min)
        }),
        {
            let least = 12.0 * device.bias.taxels.map_or(0.0, |bias| bias.noise);
            let says = move |moment: &Moment| placed(moment, |c, dead| centroid(c, dead, least));
            Method::new("centroid", Group::Paper, &["contact point: centroid"], says)
        },
        integral(&rows),
    ];
    let mut fit = |family: Family, hidden: Option<usize>, normal_only: bool| {
        let wanted = if normal_only { rows.normal() } else { rows.table.clone() };
        let net = NetOptions { seed: 0, starts: 1, steps: effort.steps };
        let options = TableOptions { family, hidden, net };
        let fitted = table::fit(&[wanted], &options, &mut |_| {}, stop)?;
        anyhow::ensure!(!stop.load(std::sync::atomic::Ordering::Relaxed), "stopped");
        step(&fitted.model.shape());
        anyhow::Ok(fitted)
    };
    let mut models = vec![(Group::Paper, fit(Family::Mlp, Some(12), true)?)];
    models.push((Group::Polynomial, fit(Family::Ridge, None, false)?));
    models.push((Group::Polynomial, fit(Family::Cubic, None, false)?));
    models.push((Group::Polynomial, fit(Family::Quadratic, None, false)?));
    for hidden in &effort.widths {
        let group = if *hidden == 16 { Group::Paper } else { Group::Net };
        models.push((group, fit(Family::Mlp, Some(*hidden), false)?));
        models.push((Group::Skip, fit(Family::Skip, Some(*hidden), false)?));
    }
    for (group, fitted) in models {
        let name = fitted.model.shape();
        methods.extend(quantised(&fitted.model));
        methods.push(Method::new(&name, group, &[&name], move |moment| {
            modelled(&fitted.model, &moment.signals)
        }));
    }
    let calibration = calibrated(device, effort, stop)?;
    step("model of the skin");
    methods.extend(firmware::all(device, &calibration)?);
    Ok(methods)
}

/// Signals and references of a calibration as table rows.
struct Rows {
    table: TableRecording,
}

impl Rows {
    fn of(device: &Device) -> Self {
        let noise = device.bias.taxels.map_or(0.0, |bias| bias.noise);
        let (mut x, mut y, mut times) = (Vec::new(), Vec::new(), Vec::new());
        let mut begin = 0.0;
        for recording in &device.recordings {
            for sample in &recording.samples {
                let moment = device.moment(*sample, Beyond::default());
                let time = begin + moment.sample.scan.time.0 as f64 * 1e-6;
                let (Some(c), [Some(fx), Some(fy), Some(fz)]) =
                    (moment.signals.taxels, moment.sample.truth.force)
                else {
                    continue;
                };
                let squares: f32 = c.iter().map(|c| c * c).sum();
                if squares > (TOUCHED * noise).powi(2) * TAXELS as f32 {
                    x.push(c.map(f64::from).to_vec());
                    y.push(vec![fx, fy, fz]);
                    times.push(time);
                }
            }
            begin = times.last().copied().unwrap_or_default() + 1.0;
        }
        let every = x.len().div_ceil(ROWS).max(1);
        let thin = |rows: Vec<Vec<f64>>| rows.into_iter().step_by(every).collect();
        let times: Vec<f64> = times.into_iter().step_by(every).collect();
        let names = (0..TAXELS).map(|k| format!("c_r{}c{}", k / COLS, k % COLS)).collect();
        let targets = ["fx_n", "fy_n", "fz_n"].map(str::to_owned).to_vec();
        let table = |names, rows, times| Table {
            path: PathBuf::from("calibration"),
            names,
            others: Vec::new(),
            rows,
            times,
        };
        Self {
            table: TableRecording {
                inputs: table(names, thin(x), times.clone()),
                targets: table(targets, thin(y), times),
            },
        }
    }

    /// Copies the rows with f_z as the only target.
    fn normal(&self) -> TableRecording {
        let mut recording = self.table.clone();
        recording.targets.keep(|name| name == "fz_n");
        recording
    }
}

fn placed(moment: &Moment, method: impl Fn(&[f32; TAXELS], u16) -> Measured<ContactPoint>) -> Said {
    let found = moment.signals.taxels.and_then(|c| method(&c, moment.signals.health.dead).ok());
    let point = found.map(|point| [f64::from(point.x.0), f64::from(point.y.0)]);
    Said { point, ..Said::default() }
}

/// Fits F_z = C·G on the finger's own matrix, [Ohka2005] eq. (3).
fn integral(rows: &Rows) -> Method {
    let measure =
        |c: [f32; TAXELS]| f64::from(Spot::measure(&c.map(|c| -c), COLS, PITCH.0).integral);
    let (mut with, mut of) = (0.0, 0.0);
    for (x, y) in rows.table.inputs.rows.iter().zip(&rows.table.targets.rows) {
        let g = measure(std::array::from_fn(|k| x[k] as f32));
        with += g * y[2];
        of += g * g;
    }
    let newtons = with / of;
    Method::new("G integral", Group::Paper, &["G integral"], move |moment| {
        let normal = moment.signals.taxels.map(|c| newtons * measure(c));
        Said { force: [None, None, normal], ..Said::default() }
    })
}

/// Returns `model` in 16-bit arithmetic if it is a net or linear.
fn quantised(model: &TableModel) -> Option<Method> {
    if model.expansion != Expansion::None {
        return None;
    }
    let group = if model.skip.is_empty() { Group::Quantised } else { Group::QuantisedSkip };
    let net = ForceNet::new(&model.layers()).ok()?;
    let net = QuantisedNet::new(&net, largest(&model.range))?;
    let name = format!("q15 {}", model.shape());
    Some(Method::new(&name, group, &[&name], move |moment| {
        let force = moment.signals.taxels.map(|c| net.forces(&c));
        Said { force: force.map_or([None; 3], |force| components(&force)), ..Said::default() }
    }))
}

fn modelled(model: &TableModel, signals: &Signals) -> Said {
    let Some(c) = signals.taxels else { return Said::default() };
    Said { force: components(&model.estimate(&c)), ..Said::default() }
}

/// Splits a net's outputs: f_z alone, or all three components.
fn components(outputs: &[f32]) -> [Option<f64>; 3] {
    match *outputs {
        [z] => [None, None, Some(f64::from(z))],
        [x, y, z] => [x, y, z].map(|f| Some(f64::from(f))),
        _ => [None; 3],
    }
}
