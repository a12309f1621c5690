//! Runs for the [sweeps](crate::sweeps): a device in a scene with one unusual condition.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::scan::TAXELS;
use taxel::units::Code;
use taxel_files::trace::Sample;
use taxel_sim::contact::{HalfSpace, SILICONE_YOUNG_MPA};
use taxel_sim::{Scene, Simulator};

use crate::truth::Touches;

/// Effects of every run, the same as in calibration.
const EFFECTS: &str = "'noise', 'ambient', 'flicker', 'gain-spread', 'optical-crosstalk', \
                       'bridge-mismatch', 'bridge-crosstalk'";
/// Seed of the runs, which no other run uses.
pub(crate) const SEED: u64 = 3;
/// Scans per second.
const RATE_HZ: usize = 500;

/// Parts of a run's scene; the default is the usual scene.
pub(crate) struct Run<'r> {
    pub effects: &'r str,
    pub tables: &'r str,
    pub indenter: &'r str,
    pub mu: f64,
    pub acts: &'r str,
    pub seconds: f64,
    pub rate_hz: usize,
}

impl Default for Run<'_> {
    fn default() -> Self {
        let (indenter, rate_hz) = ("radius_mm = 6", RATE_HZ);
        Self { effects: "", tables: "", indenter, mu: 0.8, acts: "", seconds: 6.0, rate_hz }
    }
}

/// Samples of a run with the scene's contacts as truth.
pub struct Recorded {
    pub(crate) samples: Vec<Sample>,
    pub(crate) touches: Touches,
}

pub(crate) fn run(device: u64, what: &Run<'_>) -> anyhow::Result<Recorded> {
    let Run { effects, tables, indenter, mu, acts, seconds, rate_hz } = what;
    let usual = presses([0.2, 2.0], 0.9);
    let acts = if acts.is_empty() { &usual } else { *acts };
    let text = format!(
        "effects = [{EFFECTS}{effects}]\n[scan]\nrate_hz = {rate_hz}\nduration_s = {seconds}\n\
         [device]\nseed = {device}\nbits = 16\n[indenter]\n{indenter}\n[friction]\nmu = {mu}\n{tables}{acts}"
    );
    let scene = Scene::parse("sweep.toml", &text)?;
    let samples = Simulator::new(&scene, SEED).collect();
    Ok(Recorded { samples, touches: Touches::new(&scene, SEED) })
}

/// Records presses with shear in the middle of the pad, as in calibration.
pub(crate) fn usual(device: u64) -> anyhow::Result<Recorded> {
    run(device, &Run::default())
}

/// Records scans that are early or late by up to `share` of their period.
///
/// They are picked from a run at ten times the rate.
pub(crate) fn jittered(device: u64, share: f64) -> anyhow::Result<Recorded> {
    const FINER: usize = 10;
    let Recorded { samples: fine, touches } =
        run(device, &Run { rate_hz: RATE_HZ * FINER, ..Run::default() })?;
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let most = (share * FINER as f64 / 2.0).round() as usize;
    let early = |at: usize| (at + rng.random_range(0..=2 * most)).checked_sub(most);
    let taken = (0..fine.len()).step_by(FINER).filter_map(early);
    let samples = taken.filter_map(|at| fine.get(at).copied()).collect();
    Ok(Recorded { samples, touches })
}

/// Twenty-four presses in the middle of the pad, with up to `shear` of the friction limit.
pub(crate) fn presses([low, high]: [f64; 2], shear: f64) -> String {
    format!(
        "[[random]]\nat_s = 1\npresses = 24\neach_s = 0.2\nx_mm = [-2, 2]\ny_mm = [-2, 2]\n\
         fz_n = [{low}, {high}]\nshear_of_limit = [0, {shear}]\nroll_mm = 1\n"
    )
}

/// Records presses of a sphere with up to 1 N, or with less where the simulator's laws end.
///
/// The laws hold for a contact no wider than 0.7 of the radius, and on the pad.
pub(crate) fn sphere(device: u64, radius: f64) -> anyhow::Result<Recorded> {
    let skin = HalfSpace::new(SILICONE_YOUNG_MPA, 0.5);
    let half_width = (0.69 * radius).min(4.9);
    let most = 4.0 / 3.0 * skin.contact_modulus() * half_width.powi(3) / radius;
    let acts = presses([0.2, 1.0].map(|load: f64| load * most.min(1.0)), 0.0);
    run(device, &Run { indenter: &format!("radius_mm = {radius}"), acts: &acts, ..Run::default() })
}

/// Normal presses at `distance` mm from the middle, along x.
pub(crate) fn placed(distance: f64) -> String {
    format!(
        "[[random]]\nat_s = 1\npresses = 24\neach_s = 0.2\nx_mm = [{distance}, {distance}]\n\
         y_mm = [-1, 1]\nfz_n = [0.2, 1.5]\n"
    )
}

/// Forty-eight presses right and left of the middle at `distance` mm.
///
/// They shear by `shear` of the friction limit in all directions.
pub(crate) fn off_middle(distance: f64, shear: f64) -> String {
    let presses = |at: f64, x: f64| {
        format!(
            "[[random]]\nat_s = {at}\npresses = 24\neach_s = 0.2\nx_mm = [{x}, {x}]\ny_mm = [-1, 1]\n\
             fz_n = [0.2, 1.5]\nshear_of_limit = [{shear}, {shear}]\n"
        )
    };
    presses(1.0, distance) + &presses(6.0, -distance)
}

/// Two simultaneous presses on a diagonal of the pad, `distance` mm apart.
pub(crate) fn two(distance: f64) -> String {
    let half = distance / 8f64.sqrt();
    pressed([[half, half], [-half, -half]])
}

/// Two simultaneous presses 5 mm apart, the outer one at `distance` mm from the middle along x.
pub(crate) fn outer(distance: f64) -> String {
    pressed([[distance, 0.5], [distance - 5.0, -0.5]])
}

/// A press at each position, the second one a little later.
fn pressed(places: [[f64; 2]; 2]) -> String {
    let press = |at_s: f64, [x, y]: [f64; 2]| {
        format!(
            "[[press]]\nat_s = {at_s}\nx_mm = {x}\ny_mm = {y}\nfz_n = 0.4\nrise_s = 0.1\n\
             hold_s = 3\nfall_s = 0.1\n"
        )
    };
    let [one, other] = places;
    press(1.0, one) + &press(1.05, other)
}

/// A press with shear of `share` of the friction limit.
pub(crate) fn sheared(share: f64) -> String {
    thrice(&format!("fx_n = {}", share * 0.8))
}

/// A press with torsion of `share` of the friction limit: 1.15 N·mm under 1 N.
pub(crate) fn twisted(share: f64) -> String {
    thrice(&format!("torsion_nmm = {}", share * 1.15))
}

/// Presses of 1 N with another load at three positions.
fn thrice(load: &str) -> String {
    let press = |i: i32| {
        let (at, x) = (1.0 + 1.6 * f64::from(i), 0.7 * f64::from(i - 1));
        format!(
            "[[press]]\nat_s = {at}\nx_mm = {x}\ny_mm = 0.3\nfz_n = 1\n{load}\nrise_s = 0.2\n\
             hold_s = 1\nfall_s = 0.2\n"
        )
    };
    (0..3).map(press).collect()
}

/// Mean lit codes of the first half second, which has no contact.
pub(crate) fn unloaded(samples: &[Sample]) -> [f64; TAXELS] {
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

/// Changes each taxel's lit code by a function of taxel number, code and time.
pub(crate) fn lit(samples: &mut [Sample], mut change: impl FnMut(usize, f64, u64) -> f64) {
    for sample in samples {
        let time = sample.scan.time.0;
        let Some(taxels) = &mut sample.scan.codes.taxels else { continue };
        for (k, code) in taxels.lit.as_flattened_mut().iter_mut().enumerate() {
            *code = coded(change(k, f64::from(code.0), time));
        }
    }
}

/// Changes every code of the matrix and the force sensors.
pub(crate) fn each_code(samples: &mut [Sample], mut change: impl FnMut(f64, u64) -> f64) {
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
