//! Series of references and estimates, row by row, by the arithmetic of the chip.

use crate::evaluate::FLAGS;
use crate::recording::Recording;
use taxel::calibration::Calibration;
use taxel::estimate::{Force, Uncertainty};
use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::scan::SENSORS;
use taxel_files::trace::{Sample, sensor_truth_names};

/// Quantity of a series.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Component of the finger's force, newtons.
    Force(usize),
    /// Component of the contact point, millimetres.
    Point(usize),
    /// Component of a sensor's force, newtons.
    Sensor(usize, usize),
    /// Reference column of any other sensor.
    Column(String),
}

/// Time to either side in which a label at rest does not change: the longest lag of a coating.
const BESIDE_US: u64 = 20_000;
/// Largest change of a label at rest, as a share of the largest force.
const AT_REST: f64 = 0.01;
/// Rows between two questions whether to go on.
const ASKED: usize = 512;

/// Units by the last part of a column's name.
const UNITS: [(&str, &str); 8] = [
    ("n", "N"),
    ("mm", "mm"),
    ("nmm", "N·mm"),
    ("deg", "°"),
    ("pa", "Pa"),
    ("kpa", "kPa"),
    ("g", "g"),
    ("s", "s"),
];

/// Splits a column's name into quantity and unit; the unit is empty if unknown.
pub(crate) fn split_unit(name: &str) -> (&str, &'static str) {
    let known = name.rsplit_once('_').and_then(|(quantity, end)| {
        let (_, unit) = UNITS.iter().find(|(short, _)| *short == end)?;
        Some((quantity, *unit))
    });
    known.unwrap_or((name, ""))
}

/// Unit of an error, and how many of it make one of `unit`.
pub(crate) fn fine(unit: &'static str) -> (f64, &'static str) {
    match unit {
        "N" => (1e3, "mN"),
        "mm" => (1e3, "µm"),
        unit => (1.0, unit),
    }
}

impl Kind {
    /// All kinds in the order of the report.
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        let sensors = (0..SENSORS).flat_map(|i| (0..3).map(move |axis| Self::Sensor(i, axis)));
        (0..3).map(Self::Force).chain((0..2).map(Self::Point)).chain(sensors)
    }

    /// Name of the reference column.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Force(axis) => ["fx_n", "fy_n", "fz_n"][*axis].into(),
            Self::Point(axis) => ["x_mm", "y_mm"][*axis].into(),
            Self::Sensor(sensor, axis) => sensor_truth_names(*sensor)[*axis].clone(),
            Self::Column(name) => name.clone(),
        }
    }

    /// Unit of the quantity.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        split_unit(&self.name()).1
    }

    /// Group of quantities measured together.
    ///
    /// Groups are the finger's force, the point, a sensor's force, and the columns of a table with
    /// one unit.
    pub(crate) fn group(&self) -> (usize, &'static str) {
        let number = match self {
            Self::Force(_) => 0,
            Self::Point(_) => 1,
            Self::Sensor(sensor, _) => 2 + sensor,
            Self::Column(_) => 2 + SENSORS,
        };
        (number, self.unit())
    }
}

/// One reference column and its estimates, row by row.
#[derive(Clone, Debug)]
pub struct Series {
    /// Quantity of the series.
    pub kind: Kind,
    /// Seconds since the first row; row numbers if the recording has no times.
    pub time: Vec<f64>,
    /// Reference values.
    pub reference: Vec<f64>,
    /// Estimates; `None` where the finger gave none.
    pub estimate: Vec<Option<f64>>,
    /// Whether the recording has times.
    pub timed: bool,
    /// Standard deviation that each estimate states; empty for a table.
    pub(crate) sigma: Vec<Option<f64>>,
    /// Circumstances of each row; empty for a table.
    pub(crate) rows: Vec<Row>,
    /// Standard deviation of the reference at rest; zero if it is exact or unknown.
    pub(crate) label_noise: f64,
}

/// Circumstances of a row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Row {
    /// Index of the recording's sample.
    pub sample: usize,
    /// Number of the press, counted again after each second of it; `None` without a load.
    pub press: Option<usize>,
    /// Whether the finger flags a fault.
    pub flagged: bool,
    /// Labelled contact point, else the estimated one.
    pub place: Option<[f64; 2]>,
    /// Whether the label changes where the clock of its reference may hide a lag.
    pub changing: bool,
}

impl Series {
    /// Series without rows.
    pub(crate) fn empty(kind: Kind) -> Self {
        Self {
            kind,
            time: Vec::new(),
            reference: Vec::new(),
            estimate: Vec::new(),
            timed: true,
            sigma: Vec::new(),
            rows: Vec::new(),
            label_noise: 0.0,
        }
    }

    /// Reference and error of every row with an estimate.
    pub(crate) fn errors(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.reference.iter().zip(&self.estimate).filter_map(|(r, e)| Some((*r, (*e)? - r)))
    }

    /// Loaded rows with their errors, `None` without a value or with a flagged one.
    ///
    /// All rows of a table count as loaded.
    pub(crate) fn loaded(&self) -> impl Iterator<Item = (Row, Option<f64>)> + '_ {
        let pairs = self.reference.iter().zip(&self.estimate).enumerate();
        pairs.filter_map(|(i, (reference, estimate))| {
            let row = self.rows.get(i).copied().unwrap_or_default();
            let error = estimate.filter(|_| !row.flagged).map(|estimate| estimate - reference);
            (self.rows.is_empty() || row.press.is_some()).then_some((row, error))
        })
    }

    /// Loaded rows as [`Self::loaded`], without those whose label changes behind a hidden lag.
    pub(crate) fn judged(&self) -> impl Iterator<Item = (Row, Option<f64>)> + '_ {
        self.loaded().filter(|(row, _)| !row.changing)
    }

    /// Whether the clock of the reference may hide a lag.
    pub(crate) fn hides_lag(&self) -> bool {
        self.rows.iter().any(|row| row.changing)
    }

    /// Largest minus smallest reference.
    pub(crate) fn span(&self) -> f64 {
        let (low, high) = extent(self.reference.iter().copied());
        (high - low).max(0.0)
    }
}

/// Smallest and largest value; infinity and minus infinity for no values.
pub(crate) fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// Series of every reference column that the calibration estimates.
///
/// On the bench, with only one calibrated sensor, `fx_n` … are the force on that sensor. `goes_on`
/// is asked now and then, with the number of the row; the series ends where it says no.
pub(crate) fn run(
    calibration: &Calibration,
    recording: &Recording,
    goes_on: &mut dyn FnMut(usize) -> bool,
) -> Vec<Series> {
    let mut all: Vec<Series> = Kind::all().map(Series::empty).collect();
    let noise = recording.reference_noise();
    for series in &mut all {
        if let Kind::Force(axis) = series.kind {
            series.label_noise = noise[axis];
        }
    }
    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let bench = bench_sensor(calibration);
    let begin = recording.samples.first().map_or(0, |sample| sample.scan.time.0);
    let presses = presses(recording);
    for (at, (sample, press)) in recording.samples.iter().zip(presses).enumerate() {
        if at % ASKED == 0 && !goes_on(at) {
            break;
        }
        let estimate = finger.estimate(&mut state, &sample.scan);
        let time = sample.scan.time.0.saturating_sub(begin) as f64 * 1e-6;
        let place = match sample.truth.point {
            [Some(x), Some(y)] => Some([x, y]),
            _ => estimate.point.ok().map(|point| [point.x, point.y].map(|c| f64::from(c.0))),
        };
        let flagged = FLAGS.iter().any(|flag| estimate.status.contains(*flag));
        for series in &mut all {
            if let Some(reference) = reference(&series.kind, sample, &estimate, press) {
                series.time.push(time);
                series.reference.push(reference);
                series.estimate.push(said(&series.kind, &estimate, bench).map(f64::from));
                series.sigma.push(stated(&series.kind, &estimate, bench).map(f64::from));
                series.rows.push(Row { sample: at, press, flagged, place, changing: false });
            }
        }
    }
    // A labelled quantity without any value is missing, unless no part could give it.
    let expected = |kind: &Kind| match kind {
        Kind::Sensor(sensor, _) => calibration.sensors[*sensor].is_some(),
        _ => bench.is_none(),
    };
    all.retain(|series| {
        let labelled = !series.reference.is_empty();
        labelled && (expected(&series.kind) || series.estimate.iter().any(Option::is_some))
    });
    all
}

/// Marks the rows of forces that change, because a hidden lag errs there and only there.
///
/// A row is at rest if no component differs from it by more than [`AT_REST`] within [`BESIDE_US`].
pub(crate) fn leave_changing_out(all: &mut [Series], recording: &Recording) {
    let noise = recording.reference_noise().into_iter().fold(0.0, f64::max);
    let forces = all.iter().filter(|series| matches!(series.kind, Kind::Force(_)));
    let peak = forces.map(|series| extent(series.reference.iter().map(|f| f.abs())).1);
    let most = AT_REST * peak.fold(0.0, f64::max) + 4.0 * noise;
    let time = |i: usize| recording.samples[i].scan.time.0;
    let differs = |i: usize, j: usize| {
        let [a, b] = [i, j].map(|at| recording.samples[at].truth.force);
        a.into_iter().zip(b).any(|(a, b)| a.zip(b).is_some_and(|(a, b)| (a - b).abs() > most))
    };
    let (mut first, mut changing) = (0, Vec::with_capacity(recording.samples.len()));
    for i in 0..recording.samples.len() {
        while time(first) + BESIDE_US < time(i) {
            first += 1;
        }
        let after = (i..recording.samples.len()).take_while(|j| time(*j) <= time(i) + BESIDE_US);
        changing.push((first..i).chain(after).any(|j| differs(i, j)));
    }
    for series in all.iter_mut().filter(|series| matches!(series.kind, Kind::Force(_))) {
        series.rows.iter_mut().for_each(|row| row.changing = changing[row.sample]);
    }
}

/// Number of the press of each row.
///
/// A press is a run of loaded rows. It counts again after each second, because a long slide shows
/// as much as many presses.
fn presses(recording: &Recording) -> Vec<Option<usize>> {
    const SECOND_US: u64 = 1_000_000;
    let touched = recording.touched().unwrap_or_else(|| vec![false; recording.samples.len()]);
    let mut number = 0;
    let mut began = None;
    let rows = recording.samples.iter().zip(touched).map(|(sample, touched)| {
        if !touched {
            began = None;
            return None;
        }
        let now = sample.scan.time.0;
        if began.is_none_or(|began: u64| now.saturating_sub(began) >= SECOND_US) {
            (began, number) = (Some(now), number + 1);
        }
        Some(number)
    });
    rows.collect()
}

fn bench_sensor(calibration: &Calibration) -> Option<usize> {
    let mut calibrated = (0..SENSORS).filter(|i| calibration.sensors[*i].is_some());
    match (calibration.net.is_none(), calibrated.next(), calibrated.next()) {
        (true, Some(sensor), None) => Some(sensor),
        _ => None,
    }
}

fn reference(
    kind: &Kind,
    sample: &Sample,
    estimate: &Estimate,
    press: Option<usize>,
) -> Option<f64> {
    let truth = &sample.truth;
    match kind {
        Kind::Force(axis) => truth.force[*axis],
        // A point is judged only during contact.
        Kind::Point(axis) => truth
            .contact
            .unwrap_or_else(|| press.is_some() || estimate.status.contains(Status::CONTACT))
            .then_some(truth.point[*axis])
            .flatten(),
        Kind::Sensor(sensor, axis) => truth.sensors[*sensor][*axis],
        Kind::Column(_) => None,
    }
}

fn said(kind: &Kind, estimate: &Estimate, bench: Option<usize>) -> Option<f32> {
    let component = |force: &Force, axis: usize| {
        [force.x, force.y, force.z][axis].ok().map(|newtons| newtons.0)
    };
    match kind {
        Kind::Force(axis) => {
            component(bench.map_or(&estimate.force, |i| &estimate.sensors[i]), *axis)
        }
        Kind::Point(axis) => estimate.point.ok().map(|point| [point.x, point.y][*axis].0),
        Kind::Sensor(sensor, axis) => component(&estimate.sensors[*sensor], *axis),
        Kind::Column(_) => None,
    }
}

/// Standard deviation that an estimate states. A single force sensor states none.
fn stated(kind: &Kind, estimate: &Estimate, bench: Option<usize>) -> Option<f32> {
    let Uncertainty { force, point, .. } = estimate.uncertainty.as_ref().ok()?;
    match kind {
        Kind::Force(axis) if bench.is_none() => {
            [force.x, force.y, force.z][*axis].ok().map(|newtons| newtons.0)
        }
        Kind::Point(axis) => point.ok().map(|point| [point.x, point.y][*axis].0),
        _ => None,
    }
}
