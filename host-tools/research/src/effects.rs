//! Effects of a real finger against the scenes in which they count: how far each moves the
//! estimates, and the simulator's time that it costs.

use std::array;
use std::fmt::Write as _;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use anyhow::Context as _;
use taxel::estimate::{ContactPoint, Force};
use taxel::finger::Estimate;
use taxel::measured::Measured;
use taxel_calibrate::evaluate::Only;
use taxel_calibrate::recording::Recording;
use taxel_files::save;
use taxel_sim::Simulator;
use taxel_sim::scene::REAL;

use crate::effort::Waiting;
use crate::reference::{calibrated, estimates, scene};

/// Scenes with the changes that shorten them.
const SCENES: [(&str, &[&str]); 6] = [
    ("presses", &["scan.duration_s=16", "random.presses=70"]),
    ("shear", &["scan.duration_s=16", "random.presses=70"]),
    ("tap", &[]),
    ("stick-slip", &[]),
    ("two-contacts", &[]),
    ("grasp", &[]),
];
const DEVICE: u64 = 1;
/// Seed of noise, lamps and random presses; no calibration has it.
const SEED: u64 = 41;
/// Number of timed runs, of which the fastest counts because the machine may disturb the others.
const RUNS: usize = 3;
const HEADER: &str = "effect,scene,matrix / sigma,both / sigma,time / %";

/// Effect in a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// Name of the effect.
    pub effect: String,
    /// Name of the scene.
    pub scene: String,
    /// Root mean square of the estimates' change by the effect, in standard deviations that they
    /// state; the largest of F_x, F_y, F_z, x and y. For the matrix alone, and with force sensors.
    pub sigmas: [f64; 2],
    /// Time of the simulator that the effect takes, as a share of that with all effects.
    pub time: f64,
}

/// Measures every effect in every scene, on one device with the calibration of all effects; takes
/// some minutes.
///
/// # Errors
/// The fit failed or was stopped.
pub fn measure(waiting: Waiting<'_>) -> anyhow::Result<Vec<Moved>> {
    let record = calibrated(DEVICE, false, waiting.stop)?;
    let mut found = Vec::new();
    for (i, (name, changes)) in SCENES.into_iter().enumerate() {
        let run = |without: Option<&str>| -> anyhow::Result<(Recording, f64)> {
            let mut set: Vec<String> = changes.iter().map(|change| (*change).to_owned()).collect();
            set.extend(without.map(|effect| format!("effects.{effect}=false")));
            let scene = scene(name, DEVICE, false, &set)?;
            let mut samples = Vec::new();
            let mut fastest = f64::INFINITY;
            for _ in 0..RUNS {
                let begin = Instant::now();
                samples = black_box(Simulator::new(&scene, SEED).collect());
                fastest = fastest.min(begin.elapsed().as_secs_f64());
            }
            Ok((Recording { name: name.into(), samples }, fastest))
        };
        let (all, time) = run(None)?;
        let parts = [Only::Matrix, Only::Both];
        let whole = parts.map(|part| estimates(part, &record, &all));
        for (k, effect) in REAL.into_iter().enumerate() {
            let share = (i * REAL.len() + k) as f64 / (SCENES.len() * REAL.len()) as f64;
            (waiting.progress)(share, &format!("{name} without {effect}"));
            let (less, shorter) = run(Some(effect))?;
            let sigmas =
                array::from_fn(|part| moved(&whole[part], &estimates(parts[part], &record, &less)));
            let time = 1.0 - shorter / time;
            found.push(Moved { effect: effect.into(), scene: name.into(), sigmas, time });
        }
    }
    Ok(found)
}

/// Largest root mean square of the components' changes in stated standard deviations; NaN without
/// a value.
fn moved(all: &[Estimate], less: &[Estimate]) -> f64 {
    let (mut sums, mut rows) = ([0.0; 5], [0usize; 5]);
    for (all, less) in all.iter().zip(less) {
        let Some(stated) = all.uncertainty.as_ref().ok() else { continue };
        let sigma = values(&stated.force, &stated.point);
        let changes =
            values(&all.force, &all.point).into_iter().zip(values(&less.force, &less.point));
        for (k, ((all, less), sigma)) in changes.zip(sigma).enumerate() {
            if let (Some(all), Some(less), Some(sigma)) = (all, less, sigma) {
                sums[k] += ((all - less) / sigma).powi(2);
                rows[k] += 1;
            }
        }
    }
    let each = sums.into_iter().zip(rows).map(|(sum, rows)| (sum / rows as f64).sqrt());
    each.fold(f64::NAN, f64::max)
}

/// F_x, F_y, F_z, x and y.
pub(crate) fn values(force: &Force, point: &Measured<ContactPoint>) -> [Option<f64>; 5] {
    let [x, y, z] = [force.x, force.y, force.z].map(|f| f.ok().map(|f| f.0.into()));
    let point = point.as_ref().ok();
    [x, y, z, point.map(|p| p.x.0.into()), point.map(|p| p.y.0.into())]
}

/// Writes the table.
///
/// # Errors
/// The file cannot be written.
pub fn write_table(moved: &[Moved], path: &Path) -> anyhow::Result<()> {
    let mut text = format!("{HEADER}\n");
    for Moved { effect, scene, sigmas: [matrix, both], time } in moved {
        writeln!(text, "{effect},{scene},{matrix:.2},{both:.2},{:.0}", 100.0 * time)?;
    }
    Ok(save(path, text)?)
}

/// Reads a table.
///
/// # Errors
/// A line is not one that [`write_table`] writes.
pub fn parse(text: &str) -> anyhow::Result<Vec<Moved>> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let rows = reader.deserialize().enumerate().map(|(i, row)| {
        let (effect, scene, matrix, both, percent): (_, _, _, _, f64) =
            row.with_context(|| format!("line {}", i + 2))?;
        Ok(Moved { effect, scene, sigmas: [matrix, both], time: percent / 100.0 })
    });
    rows.collect()
}

/// Draws the table of the page: a row an effect, a column a scene.
#[must_use]
pub fn section(moved: &[Moved]) -> String {
    let mut table = "| effect |".to_owned();
    SCENES.iter().for_each(|(scene, _)| table += &format!(" `{scene}` |"));
    table += " time |\n|---|";
    table += &"---|".repeat(SCENES.len() + 1);
    for effect in REAL {
        table += &format!("\n| `{effect}` |");
        let of: Vec<&Moved> = moved.iter().filter(|m| m.effect == effect).collect();
        for (scene, _) in SCENES {
            let cell = |sigmas: f64| match sigmas {
                s if s.is_nan() => "–".to_owned(),
                s if s >= 1.0 => format!("**{s:.1}**"),
                s => format!("{s:.1}"),
            };
            let found = of.iter().find(|m| m.scene == scene);
            let [matrix, both] = found.map_or([f64::NAN; 2], |m| m.sigmas).map(cell);
            table += &format!(" {matrix} / {both} |");
        }
        let mut times: Vec<f64> = of.iter().map(|m| m.time).collect();
        times.sort_by(f64::total_cmp);
        let time = times.get(times.len() / 2).copied().unwrap_or(f64::NAN);
        table += &format!(" {:.0} % |", 100.0 * time.max(0.0));
    }
    table
}

#[cfg(test)]
mod tests {
    use taxel::estimate::Uncertainty;
    use taxel::measured::NoValue;
    use taxel::units::Newtons;

    use super::*;

    #[test]
    fn changes_count_in_stated_deviations() {
        assert!(moved(&[Estimate::NOTHING], &[Estimate::NOTHING]).is_nan());
        let force = |x: f32| Force { x: Ok(Newtons(x)), ..Force::none(NoValue::NotEstimated) };
        let stated = Uncertainty {
            force: force(0.5),
            point: Err(NoValue::NotEstimated),
            misfit: Err(NoValue::NotEstimated),
        };
        let at =
            |x: f32| Estimate { force: force(x), uncertainty: Ok(stated), ..Estimate::NOTHING };
        assert_eq!(moved(&[at(1.0), at(1.0)], &[at(1.0), at(1.0)]), 0.0);
        assert_eq!(moved(&[at(1.0), at(1.0)], &[at(2.0), at(3.0)]), 10f64.sqrt());
    }

    #[test]
    fn table_reads_back_and_has_each_effect_and_scene() {
        let path = tempfile::tempdir().unwrap();
        let path = path.path().join("effects.csv");
        let moved = [Moved {
            effect: "walls".into(),
            scene: "tap".into(),
            sigmas: [12.5, f64::NAN],
            time: 0.25,
        }];
        write_table(&moved, &path).unwrap();
        let read = parse(&std::fs::read_to_string(&path).unwrap()).unwrap();
        assert_eq!((read[0].sigmas[0], read[0].time), (12.5, 0.25));
        assert!(read[0].sigmas[1].is_nan());
        let table = section(&read);
        assert_eq!(table.lines().count(), 2 + REAL.len());
        assert!(table.contains("| `walls` |") && table.contains("**12.5** / – |"), "{table}");
        assert!(parse("x\na,b,c\n").unwrap_err().to_string().contains("line 2"));
    }
}
