//! Sweeps of one disturbance each, from harmless to severe. **To add one**: a line in [`all`].

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::counts::Of;
use crate::runs::{
    Recorded, Run, SEED, each_code, jittered, lit, outer, placed, presses, run, sheared, sphere,
    twisted, two, unloaded, usual,
};

/// Standard deviation of a reading of the built-in fingers, in 16-bit codes.
const NOISE_CODES: f64 = 4.0;

/// Temperature of the calibration in °C.
const USUAL_C: f64 = 25.0;
/// Temperature differences from the calibration in kelvins, constant or reached during a run.
const WARMTH: [f64; 6] = [0.0, 2.0, 5.0, 10.0, 20.0, 30.0];
const WARMING: [f64; 5] = [0.0, 1.0, 2.0, 5.0, 10.0];
/// Changes of every taxel's light since calibration in per cent.
const GAINS: [f64; 8] = [0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];

/// One disturbance over its values.
///
/// A disturbance of both signs is two sweeps, each with its own boundary.
pub struct Sweep {
    /// Name in the table, with its unit.
    pub name: &'static str,
    /// Values, the harmless ones first.
    pub values: Vec<f64>,
    /// Returns whether a value lies in the working range of the finger or of its matrix alone.
    pub within: fn(Of, f64) -> bool,
    /// Records a device at a value.
    pub run: fn(u64, f64) -> anyhow::Result<Recorded>,
}

/// Lists all sweeps.
#[must_use]
pub fn all() -> Vec<Sweep> {
    let sweep =
        |name, values: &[f64], within, run| Sweep { name, values: values.to_vec(), within, run };
    vec![
        sweep(
            "load / N",
            &[1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005],
            |_, v| v >= 0.05,
            |device, v| run(device, &Run { acts: &presses([v, v], 0.0), ..Run::default() }),
        ),
        sweep(
            "overload / N",
            &[1.0, 1.5, 2.0, 2.1, 2.2, 2.3],
            |_, v| v <= 2.0,
            |device, v| run(device, &Run { acts: &presses([v, v], 0.0), ..Run::default() }),
        ),
        sweep(
            "distance from the middle / mm",
            &[0.0, 1.0, 2.0, 3.0, 3.75, 4.2, 4.5, 4.8, 5.0],
            |_, v| v <= 4.2,
            |device, v| run(device, &Run { acts: &placed(v), ..Run::default() }),
        ),
        sweep(
            "radius of a sphere / mm",
            &[6.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.5],
            |_, v| v >= 5.0,
            sphere,
        ),
        sweep(
            "radius of a sphere, flatter / mm",
            &[6.0, 8.0, 12.0, 20.0, 50.0, 100.0, 200.0],
            |_, v| v <= 8.0,
            sphere,
        ),
        sweep(
            "radius of a flat punch / mm",
            &[0.5, 1.0, 1.5, 2.0, 3.0],
            |_, _| false,
            |device, v| {
                let indenter = format!("kind = 'punch'\nradius_mm = {v}");
                run(
                    device,
                    &Run { indenter: &indenter, acts: &presses([0.2, 0.5], 0.0), ..Run::default() },
                )
            },
        ),
        sweep(
            "two contacts, distance / mm",
            &[3.0, 4.0, 5.0, 6.0, 7.0, 8.0],
            |_, _| false,
            |device, v| {
                run(device, &Run { indenter: "radius_mm = 3", acts: &two(v), ..Run::default() })
            },
        ),
        sweep(
            "two contacts, the outer from the middle / mm",
            &[2.5, 3.0, 3.5, 4.0, 4.4, 4.7],
            |_, _| false,
            |device, v| {
                run(device, &Run { indenter: "radius_mm = 3", acts: &outer(v), ..Run::default() })
            },
        ),
        sweep(
            "shear over friction / 1",
            &[0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0, 1.2, 2.0],
            |_, v| v <= 1.0,
            |device, v| run(device, &Run { acts: &sheared(v), ..Run::default() }),
        ),
        sweep(
            "torsion over friction / 1",
            &[0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0, 1.2, 2.0],
            // Torsion turns the skin and does not press it in, so the matrix alone cannot measure
            // it.
            |of, v| v <= if of == Of::Matrix { 0.0 } else { 1.0 },
            |device, v| run(device, &Run { acts: &twisted(v), ..Run::default() }),
        ),
        sweep("friction coefficient / 1", &[0.8, 0.6, 0.4, 0.2, 0.1], |_, v| v >= 0.4, rubbed),
        sweep("friction coefficient, higher / 1", &[0.8, 1.0, 1.2, 1.5], |_, v| v <= 0.8, rubbed),
        sweep(
            "noise / times",
            &[1.0, 1.2, 1.5, 2.0, 4.0, 8.0, 16.0, 32.0, 100.0],
            // The flag rises from 1.5 times the noise of the bias on; the record holds that noise.
            |_, v| v <= 1.2,
            |device, v| {
                let mut run = usual(device)?;
                let mut rng = ChaCha8Rng::seed_from_u64(SEED);
                let more = NOISE_CODES * (v * v - 1.0).max(0.0).sqrt();
                each_code(&mut run.samples, |code, _| {
                    let gauss: f64 = StandardNormal.sample(&mut rng);
                    code + more * gauss
                });
                Ok(run)
            },
        ),
        sweep(
            "ambient light / range",
            &[0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0],
            |_, v| v <= 0.1,
            |device, v| {
                run(
                    device,
                    &Run { tables: &format!("[light]\nambient_ratio = {v}\n"), ..Run::default() },
                )
            },
        ),
        sweep(
            "flicker / range",
            &[0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2],
            |_, v| v <= 0.005,
            |device, v| {
                let tables = format!("[light]\nambient_ratio = 0.2\nflicker_ratio = {v}\n");
                run(device, &Run { tables: &tables, ..Run::default() })
            },
        ),
        sweep("warmer / K", &WARMTH, |_, v| v <= 2.0, warm),
        sweep("colder / K", &WARMTH, |_, v| v <= 2.0, |device, v| warm(device, -v)),
        sweep(
            "bias drift / 16-bit codes",
            &[0.0, 4.0, 10.0, 30.0, 100.0, 300.0, 1000.0],
            |_, v| v <= 4.0,
            |device, v| {
                let mut run = usual(device)?;
                lit(&mut run.samples, |_, level, _| level + v);
                Ok(run)
            },
        ),
        sweep(
            "bias drift in a run / 16-bit codes",
            &[0.0, 4.0, 10.0, 30.0, 100.0, 300.0, 1000.0],
            |_, v| v <= 4.0,
            |device, v| {
                let mut run = usual(device)?;
                let end = run.samples.last().map_or(1, |sample| sample.scan.time.0) as f64;
                lit(&mut run.samples, |_, level, time| level + v * time as f64 / end);
                Ok(run)
            },
        ),
        sweep("warming in a run / K", &WARMING, |_, v| v <= 2.0, warming),
        sweep("cooling in a run / K", &WARMING, |_, v| v <= 2.0, |device, v| warming(device, -v)),
        sweep("gain drift up / %", &GAINS, |_, v| v <= 0.1, brighter),
        sweep("gain drift down / %", &GAINS, |_, v| v <= 0.1, |device, v| brighter(device, -v)),
        sweep(
            "dead taxels / 1",
            &[0.0, 1.0, 2.0, 3.0, 4.0],
            |_, v| v == 0.0,
            |device, v| {
                let broken = ["r1c1", "r2c2", "r1c2", "r2c1"].iter().take(v as usize);
                let fault = |taxel: &&str| {
                    format!("[[fault]]\nat_s = 0.5\nkind = 'dead-led'\nchannel = '{taxel}'\n")
                };
                let tables: String = broken.map(fault).collect();
                run(device, &Run { tables: &tables, ..Run::default() })
            },
        ),
        sweep(
            "broken bridge arms / 1",
            &[0.0, 1.0, 2.0, 3.0, 4.0],
            |_, v| v == 0.0,
            |device, v| {
                let fault = |sensor| {
                    format!(
                        "[[fault]]\nat_s = 0.5\nkind = 'broken-arm'\nchannel = 's{sensor}_r3'\n"
                    )
                };
                let tables: String = (0..v as usize).map(fault).collect();
                run(device, &Run { tables: &tables, ..Run::default() })
            },
        ),
        sweep(
            "stuck midpoints / 1",
            &[0.0, 1.0, 2.0, 3.0, 4.0],
            |_, v| v == 0.0,
            |device, v| {
                let fault = |sensor| {
                    format!(
                        "[[fault]]\nat_s = 0.5\nkind = 'stuck-channel'\nchannel = 's{sensor}_a'\n"
                    )
                };
                let tables: String = (0..v as usize).map(fault).collect();
                run(device, &Run { tables: &tables, ..Run::default() })
            },
        ),
        sweep(
            "signals beyond training / times",
            &[1.0, 1.1, 1.2, 1.5, 2.0, 3.0],
            |_, v| v <= 1.0,
            |device, v| {
                let mut run = usual(device)?;
                let rest = unloaded(&run.samples);
                lit(&mut run.samples, |k, level, _| {
                    let rest = rest.get(k).copied().unwrap_or_default();
                    rest + v * (level - rest)
                });
                Ok(run)
            },
        ),
        sweep(
            "lost scans / share",
            &[0.0, 0.1, 0.3, 0.5, 0.8, 0.95],
            |_, v| v <= 0.5,
            |device, v| {
                let mut rng = ChaCha8Rng::seed_from_u64(SEED);
                let mut run = usual(device)?;
                let mut lost = 0;
                run.samples.retain_mut(|sample| {
                    let kept = sample.scan.time.0 < 900_000 || !rng.random_bool(v);
                    sample.scan.lost = lost;
                    lost = if kept { 0 } else { lost + 1 };
                    kept
                });
                Ok(run)
            },
        ),
        sweep(
            "jitter of the time steps / share",
            &[0.0, 0.1, 0.2, 0.5, 0.8],
            |_, v| v <= 0.2,
            jittered,
        ),
        sweep(
            "first-cycle softening / share",
            &[0.0, 0.02, 0.05, 0.1, 0.2, 0.4],
            |_, v| v <= 0.02,
            |device, v| {
                let tables = format!("[material]\nfirst_cycle_ratio = {v}\n");
                run(device, &Run { effects: ", 'hysteresis'", tables: &tables, ..Run::default() })
            },
        ),
        sweep(
            "relaxation, held for / s",
            &[0.5, 2.0, 5.0, 15.0, 30.0, 60.0],
            |_, _| false,
            |device, v| {
                let tables = "[material]\nfollows = 'rD'\n";
                let acts = format!(
                    "[[press]]\nat_s = 1\nx_mm = 0.4\ny_mm = 0.2\nfz_n = 1\nrise_s = 0.2\nhold_s = {v}\nfall_s = 0.2\n"
                );
                let held = Run {
                    effects: ", 'skin-response'",
                    tables,
                    acts: &acts,
                    seconds: v + 2.0,
                    ..Run::default()
                };
                run(device, &held)
            },
        ),
    ]
}

/// Records presses of an object with another coefficient of friction.
fn rubbed(device: u64, mu: f64) -> anyhow::Result<Recorded> {
    run(device, &Run { mu, ..Run::default() })
}

/// Records at `kelvins` above the calibration's temperature.
fn warm(device: u64, kelvins: f64) -> anyhow::Result<Recorded> {
    let celsius = USUAL_C + kelvins;
    let tables = format!("[temperature]\nstart_c = {celsius}\nend_c = {celsius}\n");
    run(device, &Run { effects: ", 'temperature'", tables: &tables, ..Run::default() })
}

/// Records while the finger warms by `kelvins`.
fn warming(device: u64, kelvins: f64) -> anyhow::Result<Recorded> {
    let end = USUAL_C + kelvins;
    let tables =
        format!("[temperature]\nstart_c = {USUAL_C}\nend_c = {end}\nfrom_s = 1\nramp_s = 4\n");
    run(device, &Run { effects: ", 'temperature'", tables: &tables, ..Run::default() })
}

/// Records with `percent` more light on every taxel.
fn brighter(device: u64, percent: f64) -> anyhow::Result<Recorded> {
    let mut run = usual(device)?;
    lit(&mut run.samples, |_, level, _| level * (1.0 + percent / 100.0));
    Ok(run)
}
