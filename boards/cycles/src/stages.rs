//! List of stages: from codes to wire bytes, then the estimators one by one.

mod frame;
mod model;
mod nets;
mod papers;
mod product;
mod touch;
mod whole;

use taxel::calibration::Calibration;
use taxel::condition::{Bias, Levels, NoiseWatch, Signals, TemperatureCompensation};
use taxel::estimate::contact_point::{arg_min, centroid};
use taxel::estimate::gate::{Gate, GateState};
use taxel::estimate::tanh::tanh;
use taxel::math::{atan2, cube_root, inverse_sqrt, power, sqrt};
use taxel::measured::NoValue;
use taxel::scan::{COLS, PITCH};
use taxel_papers::feeler::Spot;

use crate::Meter;
use crate::host::Inputs;

pub use nets::{papers_net, papers_net_quantised};
pub use product::costliest;

/// Runs every stage on every input.
pub fn all(inputs: &Inputs<'_>, meter: &mut impl Meter) {
    // A rejected record leaves nothing to measure, and the meter's owner reports that.
    let Ok(calibration) = Calibration::from_bytes(inputs.record) else { return };
    frame::stages(inputs, &calibration, meter);
    product::stages(inputs, &calibration, meter);
    whole::stages(&inputs.whole, meter);
    conditioning(inputs, &calibration, meter);
    estimators(inputs, &calibration, meter);
    nets::stages(signals(inputs, &calibration.bias()).filter_map(|s| s.taxels), meter);
    model::stages(signals(inputs, &calibration.bias()).filter_map(|s| s.taxels), meter);
    touch::stages(&calibration, signals(inputs, &calibration.bias()), meter);
    papers::stages(signals(inputs, &calibration.bias()).filter_map(|s| s.taxels), meter);
    arithmetic(meter);
}

/// Conditioned signals of the finger in contact.
fn signals(inputs: &Inputs<'_>, bias: &Bias) -> impl Iterator<Item = Signals> + Clone {
    inputs.touched().map(|scan| bias.apply(&Levels::read(&scan.codes), None))
}

fn conditioning(inputs: &Inputs<'_>, calibration: &Calibration, meter: &mut impl Meter) {
    let mut bias = calibration.bias();
    let codes = inputs.touched().map(|scan| scan.codes);
    meter.stage("condition: levels", &mut (), codes.clone(), &mut [None; 2], |(), codes, out| {
        let levels = Levels::read(codes);
        *out = [levels.taxels.map(|taxels| taxels[0]), levels.bridges[0].map(|bridge| bridge[0])];
    });
    // The path of a scan; the next three stages are its steps.
    meter.stage(
        "condition: the three in one pass",
        &mut (bias, TemperatureCompensation::default()),
        codes.clone(),
        &mut Signals::default(),
        |(bias, warmth), codes, out| {
            let healthy = bias.taxels.as_ref().map(|taxels| &taxels.level);
            bias.direct(codes, healthy, Some((warmth, 0.25)), 1.0, out);
        },
    );
    let levels = codes.map(|codes| Levels::read(&codes));
    let mut warm = (TemperatureCompensation::default(), Levels::default());
    let first = &mut None;
    meter.stage(
        "condition: warmth",
        &mut warm,
        levels.clone(),
        first,
        |(warmth, out), levels, first| {
            *out = *levels;
            warmth.correct(out, 0.25, 1.0);
            *first = out.taxels.map(|taxels| taxels[0]);
        },
    );
    let out = &mut Signals::default();
    meter.stage("condition: bias", &mut bias, levels, out, |bias, levels, out| {
        *out = bias.apply(levels, bias.taxels.as_ref().map(|taxels| &taxels.level));
    });
    let seen = signals(inputs, &bias);
    let mut memory = (bias, NoiseWatch::default());
    meter.stage(
        "condition: noise",
        &mut memory,
        seen.clone(),
        &mut 0,
        |(bias, watch), signals, out| {
            *out = watch.update(signals, bias);
        },
    );
    let mut memory = (bias, Gate::default(), GateState::default());
    meter.stage("gate", &mut memory, seen, &mut false, |(bias, gate, state), signals, out| {
        let above = bias.exceeded(signals, gate.threshold(state));
        *out = gate.update_at_once(state, above, || 0.0);
    });
}

fn estimators(inputs: &Inputs<'_>, calibration: &Calibration, meter: &mut impl Meter) {
    let bias = calibration.bias();
    let c = signals(inputs, &bias).filter_map(|signals| signals.taxels);
    let nowhere = Err(NoValue::NoContact);
    meter.stage(
        "contact point: arg-min",
        &mut (),
        c.clone(),
        &mut nowhere.clone(),
        |(), c, out| {
            *out = arg_min(c, 0);
        },
    );
    meter.stage(
        "contact point: centroid",
        &mut (),
        c.clone(),
        &mut nowhere.clone(),
        |(), c, out| {
            *out = centroid(c, 0, 1e-3);
        },
    );
    let integral = &mut [0.0; 3];
    meter.stage("G integral", &mut (), c.clone(), integral, |(), c, out| {
        let spot = Spot::measure(&c.map(|c| -c), COLS, PITCH.0);
        *out = [spot.integral, spot.centroid[0], spot.centroid[1]];
    });
    let u = signals(inputs, &bias).filter_map(|signals| signals.bridges[0]);
    let all = signals(inputs, &bias).map(|signals| signals.bridges);
    let mut sensors = calibration.sensors.each_ref().map(|s| s.as_ref().map(|s| s.sensitivity));
    meter.stage("sum of four sensors", &mut sensors, all, &mut [0.0; 3], |sensors, u, out| {
        *out = [0.0; 3];
        for (s, u) in sensors.iter().zip(u) {
            let (Some(s), Some(u)) = (s, u) else { continue };
            out.iter_mut().zip(s.force(*u)).for_each(|(sum, force)| *sum += force);
        }
    });
    if let Some(sensor) = &calibration.sensors[0] {
        let mut s = sensor.sensitivity;
        meter.stage("f = S(u - b), one sensor", &mut s, u, &mut [0.0; 3], |s, u, out| {
            *out = s.force(*u);
        });
    }
}

/// Arguments over the whole range of a net's units.
fn arguments() -> impl Iterator<Item = f32> + Clone {
    (-48..=48i8).map(|i| f32::from(i) * 0.211)
}

fn arithmetic(meter: &mut impl Meter) {
    meter.stage("tanh", &mut (), arguments(), &mut 0.0, |(), x, out| *out = tanh(*x));
    meter.stage("1/sqrt", &mut (), arguments(), &mut 0.0, |(), x, out| *out = inverse_sqrt(*x));
    meter.stage("sqrt", &mut (), arguments(), &mut 0.0, |(), x, out| *out = sqrt(*x));
    // All exponents and many mantissas, subnormal numbers too.
    let bits = (0..f32::INFINITY.to_bits()).step_by(214_757);
    meter.compare("sqrt, any number", &mut (), bits, &mut 0.0, |(), bits, out| {
        *out = sqrt(f32::from_bits(*bits));
    });
    meter.stage("cube root", &mut (), arguments(), &mut 0.0, |(), x, out| *out = cube_root(*x));
    meter.stage("power", &mut (), arguments(), &mut 0.0, |(), x, out| *out = power(*x, 0.3));
    meter.stage("atan2", &mut (), arguments(), &mut 0.0, |(), x, out| *out = atan2(*x, 1.0 - *x));
}
