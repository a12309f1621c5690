//! What goes wrong, from harmless to hopeless, one parameter at a time. **To add one**: a line in [`all`].

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use taxel::scan::TAXELS;
use taxel::units::Code;
use taxel_formats::trace::Sample;
use taxel_sim::contact::{HalfSpace, SILICONE_YOUNG_MPA};
use taxel_sim::{Scene, Simulator};

/// Effects of every run, as in calibration.
const EFFECTS: &str = "'noise', 'ambient', 'flicker', 'gain-spread', 'optical-crosstalk', \
                       'bridge-mismatch', 'bridge-crosstalk'";
/// Seed of the runs: that of no other.
const SEED: u64 = 3;
/// Scans a second.
const RATE_HZ: usize = 500;
/// Standard deviation of a reading of the built-in fingers, in 16-bit codes.
const NOISE_CODES: f64 = 4.0;

/// One parameter.
pub struct Sweep {
    /// What it is called in the table, with its unit.
    pub name: &'static str,
    /// Its values, the harmless ones first.
    pub values: Vec<f64>,
    /// The value is one that the finger is said to work with.
    pub within: fn(f64) -> bool,
    /// What is recorded on a device at a value.
    pub run: fn(u64, f64) -> anyhow::Result<Vec<Sample>>,
}

/// All of them.
#[must_use]
pub fn all() -> Vec<Sweep> {
    let sweep =
        |name, values: &[f64], within, run| Sweep { name, values: values.to_vec(), within, run };
    vec![
        sweep(
            "load / N",
            &[1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005],
            |v| v >= 0.1,
            |device, v| run(device, &Run { acts: &presses([v, v], 0.0), ..Run::default() }),
        ),
        sweep(
            "overload / N",
            &[1.0, 1.5, 2.0, 2.1, 2.2, 2.3],
            |v| v <= 2.0,
            |device, v| run(device, &Run { acts: &presses([v, v], 0.0), ..Run::default() }),
        ),
        sweep(
            "distance from the middle / mm",
            &[0.0, 1.0, 2.0, 3.0, 3.75, 4.2, 4.5, 4.8, 5.0],
            |v| v <= 4.2,
            |device, v| run(device, &Run { acts: &placed(v), ..Run::default() }),
        ),
        sweep("radius of a sphere / mm", &[6.0, 5.0, 4.0, 3.0, 2.0, 1.0], |v| v >= 5.0, sphere),
        sweep(
            "radius of a sphere, flatter / mm",
            &[6.0, 8.0, 12.0, 20.0, 50.0, 100.0, 200.0],
            |v| v <= 8.0,
            sphere,
        ),
        sweep(
            "radius of a flat punch / mm",
            &[0.5, 1.0, 1.5, 2.0, 3.0],
            |_| false,
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
            |_| false,
            |device, v| {
                run(device, &Run { indenter: "radius_mm = 3", acts: &two(v), ..Run::default() })
            },
        ),
        sweep(
            "shear over friction / 1",
            &[0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0, 1.2, 2.0],
            |v| v <= 1.0,
            |device, v| run(device, &Run { acts: &sheared(v), ..Run::default() }),
        ),
        sweep(
            "friction coefficient / 1",
            &[0.8, 0.6, 0.4, 0.2, 0.1, 1.0, 1.2, 1.5],
            |v| (0.4..=0.8).contains(&v),
            |device, v| {
                run(device, &Run { mu: v, acts: &presses([0.2, 2.0], 0.9), ..Run::default() })
            },
        ),
        sweep(
            "noise / times",
            &[1.0, 1.5, 2.0, 4.0, 8.0, 16.0, 32.0, 100.0],
            |v| v <= 1.0,
            |device, v| {
                let mut samples = usual(device)?;
                let mut rng = ChaCha8Rng::seed_from_u64(SEED);
                let more = NOISE_CODES * (v * v - 1.0).max(0.0).sqrt();
                each_code(&mut samples, |code, _| {
                    let gauss: f64 = StandardNormal.sample(&mut rng);
                    code + more * gauss
                });
                Ok(samples)
            },
        ),
        sweep(
            "ambient light / range",
            &[0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0],
            |v| v <= 0.1,
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
            |v| v <= 0.005,
            |device, v| {
                let tables = format!("[light]\nambient_ratio = 0.2\nflicker_ratio = {v}\n");
                run(device, &Run { tables: &tables, ..Run::default() })
            },
        ),
        sweep(
            "temperature / K",
            &[0.0, 2.0, 5.0, 10.0, 20.0, 30.0, -2.0, -5.0, -10.0, -20.0, -30.0],
            |v| v.abs() <= 2.0,
            |device, v| {
                let celsius = 25.0 + v;
                let tables = format!("[temperature]\nstart_c = {celsius}\nend_c = {celsius}\n");
                run(device, &Run { effects: ", 'temperature'", tables: &tables, ..Run::default() })
            },
        ),
        sweep(
            "bias drift / 16-bit codes",
            &[0.0, 4.0, 10.0, 30.0, 100.0, 300.0, 1000.0],
            |v| v <= 4.0,
            |device, v| {
                let mut samples = usual(device)?;
                lit(&mut samples, |_, level, _| level + v);
                Ok(samples)
            },
        ),
        sweep(
            "bias drift in a run / 16-bit codes",
            &[0.0, 4.0, 10.0, 30.0, 100.0, 300.0, 1000.0],
            |v| v <= 4.0,
            |device, v| {
                let mut samples = usual(device)?;
                let end = samples.last().map_or(1, |sample| sample.scan.time.0) as f64;
                lit(&mut samples, |_, level, time| level + v * time as f64 / end);
                Ok(samples)
            },
        ),
        sweep(
            "warming in a run / K",
            &[0.0, 1.0, 2.0, 5.0, 10.0, -1.0, -2.0, -5.0, -10.0],
            |v| v.abs() <= 2.0,
            |device, v| {
                let end = 25.0 + v;
                let tables =
                    format!("[temperature]\nstart_c = 25\nend_c = {end}\nfrom_s = 1\nramp_s = 4\n");
                run(device, &Run { effects: ", 'temperature'", tables: &tables, ..Run::default() })
            },
        ),
        sweep(
            "gain drift / %",
            &[0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, -0.1, -0.5, -1.0, -2.0, -5.0, -10.0, -20.0],
            |v| v.abs() <= 0.1,
            |device, v| {
                let mut samples = usual(device)?;
                lit(&mut samples, |_, level, _| level * (1.0 + v / 100.0));
                Ok(samples)
            },
        ),
        sweep(
            "dead taxels / 1",
            &[0.0, 1.0, 2.0, 3.0, 4.0],
            |v| v == 0.0,
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
            |v| v == 0.0,
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
            |v| v == 0.0,
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
            |v| v <= 1.0,
            |device, v| {
                let mut samples = usual(device)?;
                let rest = unloaded(&samples);
                lit(&mut samples, |k, level, _| {
                    let rest = rest.get(k).copied().unwrap_or_default();
                    rest + v * (level - rest)
                });
                Ok(samples)
            },
        ),
        sweep(
            "lost scans / share",
            &[0.0, 0.1, 0.3, 0.5, 0.8, 0.95],
            |v| v <= 0.5,
            |device, v| {
                let mut rng = ChaCha8Rng::seed_from_u64(SEED);
                let mut samples = usual(device)?;
                let mut lost = 0;
                samples.retain_mut(|sample| {
                    let kept = sample.scan.time.0 < 900_000 || !rng.random_bool(v);
                    sample.scan.lost = lost;
                    lost = if kept { 0 } else { lost + 1 };
                    kept
                });
                Ok(samples)
            },
        ),
        sweep(
            "jitter of the time steps / share",
            &[0.0, 0.1, 0.2, 0.5, 0.8],
            |v| v <= 0.2,
            jittered,
        ),
        sweep(
            "first-cycle softening / share",
            &[0.0, 0.02, 0.05, 0.1, 0.2, 0.4],
            |v| v <= 0.02,
            |device, v| {
                let tables = format!("[material]\nfirst_cycle_ratio = {v}\n");
                run(device, &Run { effects: ", 'hysteresis'", tables: &tables, ..Run::default() })
            },
        ),
        sweep(
            "relaxation, held for / s",
            &[0.5, 2.0, 5.0, 15.0, 30.0, 60.0],
            |_| false,
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

/// What a run is made of, where it is not the usual.
struct Run<'r> {
    effects: &'r str,
    tables: &'r str,
    indenter: &'r str,
    mu: f64,
    acts: &'r str,
    seconds: f64,
    rate_hz: usize,
}

impl Default for Run<'_> {
    fn default() -> Self {
        let (indenter, rate_hz) = ("radius_mm = 6", RATE_HZ);
        Self { effects: "", tables: "", indenter, mu: 0.8, acts: "", seconds: 6.0, rate_hz }
    }
}

fn run(device: u64, what: &Run<'_>) -> anyhow::Result<Vec<Sample>> {
    let Run { effects, tables, indenter, mu, acts, seconds, rate_hz } = what;
    let usual = presses([0.2, 2.0], 0.9);
    let acts = if acts.is_empty() { &usual } else { *acts };
    let text = format!(
        "effects = [{EFFECTS}{effects}]\n[scan]\nrate_hz = {rate_hz}\nduration_s = {seconds}\n\
         [device]\nseed = {device}\nbits = 16\n[indenter]\n{indenter}\n[friction]\nmu = {mu}\n{tables}{acts}"
    );
    Ok(Simulator::new(&Scene::parse("sweep.toml", &text)?, SEED).collect())
}

/// Presses with shear in the middle of the pad, as in calibration.
fn usual(device: u64) -> anyhow::Result<Vec<Sample>> {
    run(device, &Run::default())
}

/// Scans that come up to a share of their period too early or too late: taken out of ten times as many.
fn jittered(device: u64, share: f64) -> anyhow::Result<Vec<Sample>> {
    const FINER: usize = 10;
    let fine = run(device, &Run { rate_hz: RATE_HZ * FINER, ..Run::default() })?;
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let most = (share * FINER as f64 / 2.0).round() as usize;
    let early = |at: usize| (at + rng.random_range(0..=2 * most)).checked_sub(most);
    let taken = (0..fine.len()).step_by(FINER).filter_map(early);
    Ok(taken.filter_map(|at| fine.get(at).copied()).collect())
}

/// Twenty-four presses in the middle of the pad, with up to `shear` of what friction holds.
fn presses([low, high]: [f64; 2], shear: f64) -> String {
    format!(
        "[[random]]\nat_s = 1\npresses = 24\neach_s = 0.2\nx_mm = [-2, 2]\ny_mm = [-2, 2]\n\
         fz_n = [{low}, {high}]\nshear_of_limit = [0, {shear}]\nroll_mm = 1\n"
    )
}

/// Presses of a sphere with up to 1 N, or with what the simulator's laws hold for: a contact no wider than 0.7 of
/// the radius, and on the pad.
fn sphere(device: u64, radius: f64) -> anyhow::Result<Vec<Sample>> {
    let skin = HalfSpace::new(SILICONE_YOUNG_MPA, 0.5);
    let half_width = (0.69 * radius).min(4.9);
    let most = 4.0 / 3.0 * skin.contact_modulus() * half_width.powi(3) / radius;
    let acts = presses([0.2, 1.0].map(|load: f64| load * most.min(1.0)), 0.0);
    run(device, &Run { indenter: &format!("radius_mm = {radius}"), acts: &acts, ..Run::default() })
}

/// Normal presses at a distance from the middle, along x.
fn placed(distance: f64) -> String {
    format!(
        "[[random]]\nat_s = 1\npresses = 24\neach_s = 0.2\nx_mm = [{distance}, {distance}]\n\
         y_mm = [-1, 1]\nfz_n = [0.2, 1.5]\n"
    )
}

/// Two presses at once on a diagonal of the pad.
fn two(distance: f64) -> String {
    let half = distance / 8f64.sqrt();
    let press = |at: f64, sign: f64| {
        let place = sign * half;
        format!(
            "[[press]]\nat_s = {at}\nx_mm = {place}\ny_mm = {place}\nfz_n = 0.4\nrise_s = 0.1\n\
             hold_s = 3\nfall_s = 0.1\n"
        )
    };
    press(1.0, 1.0) + &press(1.05, -1.0)
}

/// A press that is asked for `share` of what friction holds.
fn sheared(share: f64) -> String {
    let shear = share * 0.8;
    let press = |i: i32| {
        let (at, x) = (1.0 + 1.6 * f64::from(i), 0.7 * f64::from(i - 1));
        format!(
            "[[press]]\nat_s = {at}\nx_mm = {x}\ny_mm = 0.3\nfz_n = 1\nfx_n = {shear}\nrise_s = 0.2\n\
             hold_s = 1\nfall_s = 0.2\n"
        )
    };
    (0..3).map(press).collect()
}

/// Mean lit codes of the first half second, in which nothing touches the finger.
fn unloaded(samples: &[Sample]) -> [f64; TAXELS] {
    let first: Vec<&Sample> = samples.iter().take_while(|s| s.scan.time.0 < 500_000).collect();
    std::array::from_fn(|k| {
        let levels =
            first.iter().filter_map(|s| s.scan.codes.taxels.as_ref()?.lit.as_flattened().get(k));
        levels.map(|code| f64::from(code.0)).sum::<f64>() / first.len().max(1) as f64
    })
}

fn coded(value: f64) -> Code {
    Code(value.round().clamp(0.0, f64::from(u16::MAX)) as u16)
}

/// Changes each taxel's lit code: number, code and time go in.
fn lit(samples: &mut [Sample], mut change: impl FnMut(usize, f64, u64) -> f64) {
    for sample in samples {
        let time = sample.scan.time.0;
        let Some(taxels) = &mut sample.scan.codes.taxels else { continue };
        for (k, code) in taxels.lit.as_flattened_mut().iter_mut().enumerate() {
            *code = coded(change(k, f64::from(code.0), time));
        }
    }
}

/// Changes every code of matrix and sensors.
fn each_code(samples: &mut [Sample], mut change: impl FnMut(f64, u64) -> f64) {
    for sample in samples {
        let time = sample.scan.time.0;
        let codes = &mut sample.scan.codes;
        if let Some(taxels) = &mut codes.taxels {
            for code in taxels.lit.as_flattened_mut().iter_mut().chain(&mut taxels.dark) {
                *code = coded(change(f64::from(code.0), time));
            }
        }
        for midpoints in codes.bridges.iter_mut().flatten() {
            for code in [&mut midpoints.a, &mut midpoints.b, &mut midpoints.c, &mut midpoints.d] {
                *code = coded(change(f64::from(code.0), time));
            }
        }
    }
}
