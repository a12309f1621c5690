//! Every method on every kind of scene: `estimators.csv`.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use taxel_files::save;

use crate::costs::{Cost, Costs};
use crate::device::{Device, Moment};
use crate::methods::{self, Group, Method, Said, Stages};
use crate::papers::{self, Paper};
use crate::scatter::{self, Title};
use crate::{Effort, Waiting, page};

/// What is judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// f_z.
    Normal,
    /// f_x and f_y, a component.
    Shear,
    /// Distance of the contact point.
    Point,
    /// Of the contact along a line.
    Place,
    /// Of the force to the skin.
    Angle,
    /// About the normal.
    Torsion,
    /// What is left of the friction, a share.
    Margin,
    /// Whether it slides: the square of the error is the share of frames that are wrong.
    Slide,
}

impl Quantity {
    /// Its name in the tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal force",
            Self::Shear => "shear force",
            Self::Point | Self::Place => "contact point",
            Self::Angle => "angle",
            Self::Torsion => "torsion",
            Self::Margin => "slip margin",
            Self::Slide => "slide",
        }
    }

    /// The unit of its error.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Normal | Self::Shear => "N",
            Self::Point | Self::Place => "mm",
            Self::Angle => "°",
            Self::Torsion => "N·mm",
            Self::Margin | Self::Slide => "1",
        }
    }

    /// The unit of its error in the pictures, and how many of them are one of [`Self::unit`].
    pub(crate) fn shown(self) -> (&'static str, f64) {
        match self {
            Self::Normal | Self::Shear => ("mN", 1e3),
            Self::Point | Self::Place => ("µm", 1e3),
            Self::Angle => ("°", 1.0),
            Self::Torsion => ("N·µm", 1e3),
            Self::Margin | Self::Slide => ("%", 1e2),
        }
    }

    /// Squared error of what was said, if it was said and is known.
    fn squared(self, said: &Said, moment: &Moment) -> Option<f64> {
        let truth = &moment.sample.truth;
        let off = |axis: usize| Some((said.force[axis]? - truth.force[axis]?).powi(2));
        match self {
            Self::Normal => off(2),
            Self::Shear => Some(0.5 * (off(0)? + off(1)?)),
            Self::Point => {
                let ([x, y], [tx, ty]) = (said.point?, truth.point);
                Some((x - tx?).powi(2) + (y - ty?).powi(2))
            }
            Self::Place => Some((said.point?[0] - truth.point[0]?).powi(2)),
            Self::Angle => {
                let asked = truth.force[2]?.atan2(truth.force[0]?).to_degrees();
                Some((said.angle? - asked).powi(2))
            }
            Self::Torsion => Some((said.torsion? - truth.torsion?).powi(2)),
            Self::Margin => Some((said.margin? - moment.beyond.margin?).powi(2)),
            Self::Slide => Some(f64::from(u8::from(said.slides? != truth.slip?))),
        }
    }
}

use Quantity::{Margin, Normal, Point, Shear, Slide, Torsion};

/// The built-in scenes that methods are judged on, and what for.
pub const SCENES: [(&str, &[Quantity]); 8] = [
    ("presses", &[Normal, Point]),
    ("shear", &[Normal, Shear, Point, Margin]),
    ("roll", &[Normal, Point]),
    ("edge", &[Normal, Point]),
    ("tap", &[Normal, Point]),
    ("tour", &[Normal, Shear, Point, Margin, Slide]),
    ("torsion", &[Point, Torsion, Margin]),
    ("stick-slip", &[Margin, Slide]),
];

/// Loads below this many newtons are not judged: there is nothing to know of them yet.
pub(crate) const LEAST_N: f64 = 0.05;

/// The most shear in newtons that a finger takes for none: 5 mN and a hundredth of 2 N.
const SHEARED_N: f64 = 0.025;

/// A method on a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the method.
    pub name: String,
    /// Its kind.
    pub group: Group,
    /// Name of the scene.
    pub scene: &'static str,
    /// What was judged.
    pub quantity: Quantity,
    /// Root mean square error, the mean over the devices.
    pub rmse: f64,
    /// What an estimate costs.
    pub cost: Cost,
}

/// Judges every method; a device a thread.
///
/// # Errors
/// A fit failed, or it was stopped.
pub fn measure(effort: &Effort, waiting: Waiting<'_>) -> anyhow::Result<Vec<Row>> {
    let costs = Costs::committed()?;
    let done = AtomicUsize::new(0);
    let next = AtomicUsize::new(0);
    // Three methods of the papers and the sensors need no long fit.
    let of = effort.devices.len() * (5 + 2 * effort.widths.len() + papers::all().len());
    let work = || {
        let mut judged = Vec::new();
        while let Some(seed) = effort.devices.get(next.fetch_add(1, Ordering::Relaxed)) {
            let mut step = |what: &str| {
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                (waiting.progress)(done as f64 / of as f64, what);
            };
            let device = Device::new(*seed)?;
            judged.push((*seed, judge(&device, effort, &mut step, waiting)?));
        }
        anyhow::Ok(judged)
    };
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let mut devices = std::thread::scope(|scope| {
        let workers: Vec<_> =
            (0..workers.min(effort.devices.len())).map(|_| scope.spawn(work)).collect();
        let mut devices = Vec::new();
        for worker in workers {
            match worker.join() {
                Ok(judged) => devices.extend(judged?),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        anyhow::Ok(devices)
    })?;
    devices.sort_by_key(|(seed, _)| *seed);
    let devices: Vec<_> = devices.into_iter().map(|(_, judged)| judged).collect();
    mean(&devices, &costs)
}

/// A method on a scene of one device.
struct Judged {
    name: String,
    group: Group,
    stages: Vec<String>,
    scene: &'static str,
    quantity: Quantity,
    rmse: Option<f64>,
}

fn judge(
    device: &Device,
    effort: &Effort,
    step: &mut dyn FnMut(&str),
    waiting: Waiting<'_>,
) -> anyhow::Result<Vec<Judged>> {
    let mut methods = methods::all(device, effort, step, waiting.stop)?;
    let mut judged = Vec::new();
    for (scene, quantities) in SCENES {
        let moments = device.unseen(scene)?;
        for method in &mut methods {
            judged.extend(method_on(method, &moments, scene, quantities, |[_, _, z]| z >= LEAST_N));
        }
    }
    for paper in papers::all() {
        let (mut method, moments) = paper.on(device.seed)?;
        step(paper.name);
        let Paper { judged: scene, quantities, holds, .. } = paper;
        judged.extend(method_on(&mut method, &moments, scene, quantities, holds));
    }
    Ok(judged)
}

/// A method on the moments of a scene under loads that it is judged under, a row a quantity.
fn method_on(
    method: &mut Method,
    moments: &[Moment],
    scene: &'static str,
    quantities: &[Quantity],
    holds: fn([f64; 3]) -> bool,
) -> Vec<Judged> {
    let mut errors = vec![(0.0, 0usize); quantities.len()];
    for moment in moments {
        let said = (method.says)(moment);
        let touched = papers::loaded(&moment.sample, holds).is_some();
        for ((sum, count), quantity) in errors.iter_mut().zip(quantities) {
            if let (true, Some(squared)) = (touched, quantity.squared(&said, moment)) {
                *sum += squared;
                *count += 1;
            }
        }
    }
    let row = |((sum, count), quantity): ((f64, usize), &Quantity)| Judged {
        name: method.name.clone(),
        group: method.group,
        stages: match &method.stages {
            Stages::Together(stages) => stages.clone(),
            Stages::Whole => vec![dearest(moments).to_owned()],
        },
        scene,
        quantity: *quantity,
        rmse: (count > 0).then(|| (sum / count as f64).sqrt()),
    };
    errors.into_iter().zip(quantities).map(row).collect()
}

/// The stage of the dearest kind of scene that is in a run.
fn dearest(moments: &[Moment]) -> &'static str {
    let sheared = |moment: &Moment| match moment.sample.truth.force {
        [Some(x), Some(y), _] => x.hypot(y) > SHEARED_N,
        _ => false,
    };
    if moments.iter().any(sheared) {
        "finger: shear, estimates"
    } else {
        "finger: normal contact, estimates"
    }
}

/// The mean over devices, of what all of them can say.
fn mean(devices: &[Vec<Judged>], costs: &Costs) -> anyhow::Result<Vec<Row>> {
    let Some(first) = devices.first() else { return Ok(Vec::new()) };
    let mut rows = Vec::new();
    for (i, judged) in first.iter().enumerate() {
        let errors: Option<Vec<f64>> =
            devices.iter().map(|device| device.get(i).and_then(|judged| judged.rmse)).collect();
        let Some(errors) = errors else { continue };
        rows.push(Row {
            name: judged.name.clone(),
            group: judged.group,
            scene: judged.scene,
            quantity: judged.quantity,
            rmse: errors.iter().sum::<f64>() / errors.len() as f64,
            cost: costs.of(&judged.stages)?,
        });
    }
    Ok(rows)
}

/// The table `estimators.csv`.
#[must_use]
pub fn csv(rows: &[Row]) -> String {
    let mut table =
        String::from("name,scene,quantity,unit,rmse,cycles_low,cycles_high,instructions\n");
    for Row { name, scene, quantity, rmse, cost, .. } in rows {
        let (quantity, unit) = (quantity.name(), quantity.unit());
        let Cost { instructions, cycles_low, cycles_high } = cost;
        // Writing into a string cannot fail.
        let _ = writeln!(
            table,
            "{name},{scene},{quantity},{unit},{rmse:.7},{cycles_low},{cycles_high},{instructions}"
        );
    }
    table
}

/// The panels of the first picture, which tell most, and of the second.
const PANELS: [Title<'_>; 4] =
    [("presses", Normal), ("shear", Normal), ("shear", Shear), ("presses", Point)];
const MORE: [Title<'_>; 4] = [("edge", Normal), ("edge", Point), ("tour", Normal), ("tour", Shear)];

/// How near to slip it is, and whether it slides.
const SLIP: [Title<'_>; 4] =
    [("shear", Margin), ("stick-slip", Margin), ("tour", Slide), ("stick-slip", Slide)];

/// Writes table, pictures and page into `folder`.
///
/// # Errors
/// One of them cannot be written.
pub fn write(rows: &[Row], folder: &Path) -> anyhow::Result<()> {
    save(folder.join("estimators.csv"), csv(rows))?;
    save(folder.join("estimators.svg"), scatter::draw(rows, &PANELS)?)?;
    save(folder.join("estimators-more.svg"), scatter::draw(rows, &MORE)?)?;
    save(folder.join("estimators-slip.svg"), scatter::draw(rows, &SLIP)?)?;
    let own = papers::all().into_iter().map(|paper| (paper.judged, paper.quantities));
    let all: Vec<Title<'_>> = SCENES
        .into_iter()
        .chain(own)
        .flat_map(|(scene, quantities)| quantities.iter().map(move |q| (scene, *q)))
        .collect();
    save(folder.join("estimators.html"), page::estimators(rows, &all))?;
    Ok(())
}

/// Of the rows of one panel those that no other beats in both cost and error, the cheapest first. What needs the
/// force sensors is other hardware and stands apart: no choice of method puts them into a finger.
#[must_use]
pub fn front<'r>(rows: &[&'r Row]) -> Vec<&'r Row> {
    let of_matrix = |row: &&&Row| !matches!(row.group, Group::Sensors | Group::Finger);
    let mut sorted: Vec<&Row> = rows.iter().filter(of_matrix).copied().collect();
    sorted.sort_by(|a, b| {
        a.cost.cycles().total_cmp(&b.cost.cycles()).then(a.rmse.total_cmp(&b.rmse))
    });
    let mut front: Vec<&Row> = Vec::new();
    for row in sorted {
        if front.last().is_none_or(|best| row.rmse < best.rmse) {
            front.push(row);
        }
    }
    front
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(cycles: u64, rmse: f64) -> Row {
        Row {
            name: String::new(),
            group: Group::Net,
            scene: "press",
            quantity: Normal,
            rmse,
            cost: Cost { instructions: 0, cycles_low: cycles, cycles_high: cycles },
        }
    }

    #[test]
    fn the_front_holds_what_nothing_beats_in_both_cost_and_error() {
        let sensors = Row { group: Group::Sensors, ..row(10, 0.1) };
        let rows =
            [row(100, 3.0), row(200, 1.0), row(150, 4.0), row(100, 2.0), row(300, 1.0), sensors];
        let front = front(&rows.each_ref());
        assert_eq!(front, [&rows[3], &rows[1]]);
    }
}
