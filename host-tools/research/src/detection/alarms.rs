//! False alarms: flags of a fault in sound runs of the built-in scenes.

use taxel::finger::Estimate;
use taxel::scan::{COLS, Codes, Scan, TAXELS};
use taxel_sim::scene::{Kind, built_in};
use taxel_sim::{Scene, Simulator};

use super::DEVICES;
use super::bench::{Bench, Has, SEED, WANTED};
use super::judge::Frame;
use super::table::Row;
use crate::faults::{RATE_HZ, flat};
use crate::reference::scene;

/// Scenes that a sound finger may meet: those of the 4×4 finger without a fault of their own.
pub(super) fn scenes() -> anyhow::Result<Vec<&'static str>> {
    let mut names = Vec::new();
    for (name, _) in built_in() {
        let scene = Scene::load(name)?;
        if scene.faults().next().is_none() && scene.device.kind == Kind::Taxel4x4 {
            names.push(name);
        }
    }
    Ok(names)
}

/// Scans from one report of the progress to the next.
const TOLD: usize = 1000;

/// Number of scans of all scenes on all devices, in steps of [`TOLD`].
pub(super) fn steps(names: &[&str], runs: u64) -> anyhow::Result<usize> {
    let seconds = names.iter().map(|name| Ok(Scene::load(name)?.scan.duration_s));
    let seconds: f64 = seconds.sum::<anyhow::Result<f64>>()?;
    Ok((seconds * RATE_HZ * (runs as usize * DEVICES.len()) as f64) as usize / TOLD)
}

/// Taxels that are clipped in the codes, a bit each: a dark code clips its column.
fn clipped(codes: &Codes) -> u32 {
    let limit = codes.full_scale.clipped();
    let codes = flat(codes);
    (0..TAXELS)
        .filter(|k| codes[*k].max(codes[TAXELS + k % COLS]) >= limit.0)
        .fold(0, |all, k| all | 1 << k)
}

/// Counts the flags of one scene at 4 kHz, over all devices and both fingers.
///
/// `tell` is called after each thousand scans.
pub(super) fn judge(
    name: &'static str,
    benches: &[Bench],
    runs: u64,
    tell: impl Fn() -> anyhow::Result<()>,
) -> anyhow::Result<Vec<Row>> {
    let mut rows = [Has::Matrix, Has::Sensors].map(|has| Row::clean(name, has));
    let rate = [format!("scan.rate_hz={RATE_HZ}")];
    for bench in benches.iter().filter(|bench| bench.is(Has::Sensors)) {
        let scene = scene(name, bench.device(), false, &rate)?;
        for seed in SEED..SEED + runs {
            let mut fingers = [Has::Matrix, Has::Sensors].map(|has| (has, bench.finger(has)));
            let mut estimate = Estimate::NOTHING;
            for (n, sample) in Simulator::new(&scene, seed).enumerate() {
                if n % TOLD == TOLD - 1 {
                    tell()?;
                }
                for ((has, (finger, state)), row) in fingers.iter_mut().zip(&mut rows) {
                    let scan = Scan { codes: has.cut(sample.scan.codes), ..sample.scan };
                    finger.update(&mut estimate, state, &scan, WANTED);
                    row.add_clean(&Frame::of(&estimate), clipped(&scan.codes));
                }
            }
        }
    }
    Ok(rows.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_sound_and_of_the_finger() {
        let names = scenes().unwrap();
        assert!(names.contains(&"press") && names.contains(&"tour") && names.contains(&"flicker"));
        assert!(!names.iter().any(|name| name.starts_with("fault") || *name == "mems"));
    }
}
