//! Disturbances under which the stated uncertainty is judged.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use taxel::calibration::Calibration;
use taxel::scan::{Codes, TaxelCodes};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::Sample;
use taxel_sim::Simulator;

use super::SEED;
use crate::faults::{brighten, shift};
use crate::reference::scene;

/// Change of a recording's codes.
#[derive(Clone, Copy, Debug)]
enum Codewise {
    None,
    /// All LEDs brighten by this share within five seconds.
    Brighten(f64),
    /// So much noise is added that there is this many times the usual one.
    Noise(f64),
}

/// Disturbance: its name, scene, changes to this, and change of the codes.
pub(super) struct Condition {
    pub name: &'static str,
    scene: &'static str,
    set: &'static [&'static str],
    codewise: Codewise,
}

impl Condition {
    const fn scene(name: &'static str, set: &'static [&'static str]) -> Self {
        Self { name, scene: "shear", set, codewise: Codewise::None }
    }

    const fn codes(name: &'static str, codewise: Codewise) -> Self {
        Self { name, scene: "shear", set: &[], codewise }
    }
}

/// Changes to every scene of random presses: 24 s of them, with exact labels.
const SHORT: [&str; 3] = ["scan.duration_s=26", "random.presses=120", "effects.bench-error=false"];
pub(super) const CONDITIONS: [Condition; 9] = [
    Condition::scene("as calibrated", &[]),
    Condition::scene(
        "sphere of 3 mm for one of 6",
        &["indenter.radius_mm=3", "random.fz_n=[0.2, 1.2]"],
    ),
    Condition::scene("flat punch of 2 mm", &["indenter.kind=\"punch\"", "indenter.radius_mm=2"]),
    Condition::scene("presses of 1 s", &["random.presses=24", "random.each_s=1"]),
    Condition {
        name: "hold of 58 s",
        scene: "grasp",
        set: &["effects.temperature=false", "temperature="],
        codewise: Codewise::None,
    },
    Condition::scene(
        "warms by 10 K",
        &[
            "effects.temperature=true",
            "temperature.end_c=35",
            "temperature.from_s=1",
            "temperature.ramp_s=20",
        ],
    ),
    Condition::scene(
        "cools by 10 K",
        &[
            "effects.temperature=true",
            "temperature.end_c=15",
            "temperature.from_s=1",
            "temperature.ramp_s=20",
        ],
    ),
    Condition::codes("LEDs brighten by 1 %", Codewise::Brighten(0.01)),
    Condition::codes("twice the noise", Codewise::Noise(2.0)),
];

/// Simulates a recording of a device in this condition.
pub(super) fn recorded(
    device: u64,
    condition: &Condition,
    record: &Calibration,
) -> anyhow::Result<Recording> {
    let short = if condition.scene == "shear" { &SHORT[..] } else { &SHORT[2..] };
    let set: Vec<String> =
        short.iter().chain(condition.set).map(|change| (*change).to_owned()).collect();
    let scene = scene(condition.scene, device, false, &set)?;
    let mut samples: Vec<Sample> = Simulator::new(&scene, SEED).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(SEED + device);
    for sample in &mut samples {
        let seconds = sample.scan.time.0 as f64 * 1e-6;
        change(&mut sample.scan.codes, condition.codewise, seconds, record, &mut rng);
    }
    Ok(Recording { name: condition.name.into(), samples })
}

/// Changes the codes of a scan.
fn change(
    codes: &mut Codes,
    codewise: Codewise,
    seconds: f64,
    record: &Calibration,
    rng: &mut ChaCha8Rng,
) {
    let top = codes.full_scale.top().0;
    match codewise {
        Codewise::None => {}
        Codewise::Brighten(share) => {
            let share = share * ((seconds - 0.5) / 5.0).clamp(0.0, 1.0);
            let Some(TaxelCodes { lit, dark }) = &mut codes.taxels else { return };
            lit.iter_mut().for_each(|row| brighten(row, dark, share, top));
        }
        Codewise::Noise(times) => {
            let more = f64::from(top) * (times * times - 1.0).sqrt();
            let mut draw = |noise: f32| -> f64 {
                let unit: f64 = StandardNormal.sample(rng);
                more * f64::from(noise) * unit
            };
            let noise = record.taxels.as_ref().map_or(0.0, |taxels| taxels.bias.noise);
            let lit = codes.taxels.iter_mut().flat_map(|taxels| taxels.lit.as_flattened_mut());
            lit.for_each(|code| shift(code, draw(noise), top));
            for (midpoints, sensor) in codes.bridges.iter_mut().zip(&record.sensors) {
                let (Some(midpoints), Some(sensor)) = (midpoints, sensor) else { continue };
                // An output is the difference of two midpoints.
                let noise = sensor.bias.noise * core::f32::consts::FRAC_1_SQRT_2;
                let [a, b, c, d] = [(); 4].map(|()| draw(noise));
                shift(&mut midpoints.a, a, top);
                shift(&mut midpoints.b, b, top);
                shift(&mut midpoints.c, c, top);
                shift(&mut midpoints.d, d, top);
            }
        }
    }
}
