//! Committed calibration records of simulated devices, and the fits that produce them.

use std::path::PathBuf;
use std::thread;

use taxel::calibration::Calibration;
use taxel_files::calibration;

use crate::judge::{self, Rms, With, newtons, presses, replay, run};
use crate::{adjust, warmth};

/// Environment variable that makes the tests below write the records instead of comparing them.
const WRITE: &str = "TAXEL_WRITE_FIXTURES";
/// Largest RMS differences of forces and contact points due to another processor's rounding.
const SAME_NEWTONS: f64 = 0.001;
const SAME_MM: f64 = 0.01;

/// A committed record.
struct Fixture {
    name: String,
    device: u32,
    fit: Box<dyn Fn() -> Calibration + Send + Sync>,
}

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/fixtures/{name}.toml"))
}

/// Reads a committed record.
pub fn record(name: &str) -> Calibration {
    calibration::read(path(name)).unwrap()
}

fn judged(device: u32) -> Fixture {
    let fit = Box::new(move || judge::fitted(device));
    Fixture { name: judge::name(device), device, fit }
}

fn warm(warm_up: bool) -> Fixture {
    let fit = Box::new(move || warmth::fitted(warm_up));
    Fixture { name: warmth::name(warm_up).into(), device: warmth::DEVICE, fit }
}

fn aged() -> Fixture {
    Fixture { name: adjust::NAME.into(), device: adjust::DEVICE, fit: Box::new(adjust::fitted) }
}

/// Repeats the fits, two at once, and compares them with the committed records.
fn check(fixtures: &[Fixture]) {
    for pair in fixtures.chunks(2) {
        thread::scope(|scope| {
            for fixture in pair {
                scope.spawn(|| compare(fixture));
            }
        });
    }
}

/// Compares a fit with its committed record.
///
/// The same processor must give the same bits. Others may round differently in vector units and
/// mathematical library; their record must give the same estimates.
fn compare(Fixture { name, device, fit }: &Fixture) {
    let fitted = fit();
    if std::env::var_os(WRITE).is_some() {
        return calibration::write(path(name), &fitted).unwrap();
    }
    let committed = record(name);
    if committed == fitted {
        return;
    }
    let samples = run(*device, 41, 500, 13.0, 0.8, &presses(60, [0.0, 0.99], 2.0));
    let [before, now] = [&committed, &fitted].map(|record| replay(record, &samples, With::Both));
    let (mut forces, mut points) = (Rms::default(), Rms::default());
    for (before, now) in before.iter().zip(&now) {
        let axes = |e: &taxel::finger::Estimate| [e.force.x, e.force.y, e.force.z].map(newtons);
        for (before, now) in axes(before).into_iter().zip(axes(now)) {
            before.zip(now).into_iter().for_each(|(a, b)| forces.add(a - b));
        }
        if let (Ok(a), Ok(b)) = (before.point, now.point) {
            points.add(f64::from((a.x.0 - b.x.0).hypot(a.y.0 - b.y.0)));
        }
    }
    println!("{name}: {} N, {} mm apart", forces.value(), points.value());
    assert!(
        forces.count() > 0 && forces.value() < SAME_NEWTONS && points.value() < SAME_MM,
        "{name}: the fit gives another record than the committed one: {} N, {} mm apart. If that is meant, write all \
         of them: {WRITE}=1 cargo test -p taxel-calibrate --test it fixtures::",
        forces.value(),
        points.value()
    );
}

/// Refits too long for the quick profile. One command writes all records: two of its devices tell
/// whether they are of another fit.
mod endurance {
    use super::{check, judged, warm};

    #[test]
    fn judged_records_match_fit() {
        check(&[11, 20].map(judged));
    }

    #[test]
    fn warm_finger_records_match_fit() {
        check(&[warm(true), warm(false)]);
    }
}

mod nightly {
    use super::{aged, check, judged};

    #[test]
    fn all_judged_records_match_fit() {
        check(&[12, 13, 14, 15, 17, 18, 19, 21, 22].map(judged));
        check(&[aged()]);
    }
}
