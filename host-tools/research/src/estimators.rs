//! Error and cost of every method on every kind of scene: `estimators.csv`.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use taxel_files::save;

use crate::costs::{Cost, Costs};
use crate::device::{Device, Moment};
use crate::effort::{Effort, Waiting, on_all_cores};
use crate::methods::{self, Group, Method, Stages};
use crate::papers::{self, Paper};
use crate::picture::save_page;
use crate::results::{Quantity, Row, Title};
use crate::scatter;
use crate::truth::LEAST_N;

use Quantity::{Margin, Normal, Point, Shear, Slide, Torsion};

/// Built-in scenes on which methods are judged, with the judged quantities.
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

/// Largest shear in newtons that counts as none: 5 mN and 1 % of 2 N.
const SHEARED_N: f64 = 0.025;

/// Judges every method, one thread for each device.
///
/// # Errors
/// A fit failed, or it was stopped.
pub fn measure(effort: &Effort, waiting: Waiting<'_>) -> anyhow::Result<Vec<Row>> {
    let costs = Costs::committed()?;
    let done = AtomicUsize::new(0);
    // The papers' methods and the force sensors need no long fit.
    let of = effort.devices.len() * (5 + 2 * effort.widths.len() + papers::all().len());
    let devices = on_all_cores(&effort.devices, |seed| {
        let mut step = |what: &str| {
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            (waiting.progress)(done as f64 / of as f64, what);
        };
        judge(&Device::new(*seed)?, effort, &mut step, waiting)
    })?;
    mean(&devices, &costs)
}

/// Error of a method on a scene of one device.
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

/// Judges a method on a scene; returns a row for each quantity.
///
/// `holds` selects the judged loads.
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
            Stages::Whole => vec![costliest_stage(moments).to_owned()],
        },
        scene,
        quantity: *quantity,
        rmse: (count > 0).then(|| (sum / count as f64).sqrt()),
    };
    errors.into_iter().zip(quantities).map(row).collect()
}

/// Returns the whole-finger stage of a run's costliest contact.
fn costliest_stage(moments: &[Moment]) -> &'static str {
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

/// Averages over the devices the quantities that all of them give.
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

/// Formats the table `estimators.csv`.
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

/// Panels of the first picture; [`MORE`] holds those of the second.
const PANELS: [Title<'_>; 4] =
    [("presses", Normal), ("shear", Normal), ("shear", Shear), ("presses", Point)];
const MORE: [Title<'_>; 4] = [("edge", Normal), ("edge", Point), ("tour", Normal), ("tour", Shear)];

/// Panels of slip margin and gross slip.
const SLIP: [Title<'_>; 4] =
    [("shear", Margin), ("stick-slip", Margin), ("tour", Slide), ("stick-slip", Slide)];

/// Writes table, pictures and page into `folder`.
///
/// # Errors
/// One of them cannot be written.
pub fn write(rows: &[Row], folder: &Path) -> anyhow::Result<()> {
    save(folder.join("estimators.csv"), csv(rows))?;
    for (name, panels) in [("", &PANELS), ("-more", &MORE), ("-slip", &SLIP)] {
        scatter::draw(rows, panels)?.save(folder.join(format!("estimators{name}.svg")))?;
    }
    let own = papers::all().into_iter().map(|paper| (paper.judged, paper.quantities));
    let mut all: Vec<Title<'_>> = Vec::new();
    for (scene, quantities) in SCENES.into_iter().chain(own) {
        // Two fingertips share the scene `array`, and a panel.
        let new = quantities.iter().map(|q| (scene, *q)).filter(|title| !all.contains(title));
        all.extend(new.collect::<Vec<_>>());
    }
    let lead = "Root mean square error on runs that the fits have not seen, the mean over the devices, over the \
                modelled cycles of one estimate from conditioned signals.";
    save_page(
        folder.join("estimators.html"),
        "Error over cost",
        lead,
        &[&scatter::draw(rows, &all)?],
    )
}
