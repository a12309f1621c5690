//! Estimates of a finger, and its reasons where it cannot estimate.

use crate::common;
use crate::common::{LIT, calibration, everything, pressed, unloaded};
use taxel::calibration::Calibration;
use taxel::condition::{DriftCompensation, LagCompensation, LowPass, PER_KELVIN};
use taxel::estimate::Force;
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::inverse::Inverse;
use taxel::estimate::quantised::{Net, QuantisedNet};
use taxel::finger::{Estimate, Finger, FingerState, Wanted};
use taxel::frame::Status;
use taxel::measured::NoValue;
use taxel::scan::{Scan, TaxelCodes};
use taxel::units::{Code, Newtons};

fn calibrated() -> (Finger, FingerState) {
    Finger::new(Some(calibration()))
}

/// Returns the estimate after nine equal scans, enough for the contact gate to switch.
fn settled(finger: &Finger, state: &mut FingerState, scan: &Scan) -> Estimate {
    for _ in 0..8 {
        finger.estimate(state, scan);
    }
    finger.estimate(state, scan)
}

fn near(estimate: &Estimate, x: f32, y: f32) -> bool {
    estimate.point.is_ok_and(|p| (p.x.0 - x).abs() < 1e-5 && (p.y.0 - y).abs() < 1e-5)
}

#[test]
fn unloaded_finger_gives_zero_force() {
    let (finger, mut state) = calibrated();
    let estimate = settled(&finger, &mut state, &unloaded(0));
    assert_eq!(estimate.force, Force::known(0.0, 0.0, 0.0));
    assert_eq!(estimate.point, Err(NoValue::NoContact));
    assert_eq!(estimate.status, Status::RAN_SENSORS);
}

#[test]
fn press_has_force_and_contact_point() {
    let (finger, mut state) = calibrated();
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 3_277));
    let Ok(Newtons(fz)) = estimate.force.z else { panic!("{:?}", estimate.force) };
    assert!((f64::from(fz) - 0.1f64.tanh()).abs() < 1e-4, "{fz}");
    assert!(near(&estimate, 1.25, -1.25), "{:?}", estimate.point);
    for bit in [Status::CONTACT, Status::RAN_NET, Status::RAN_CENTROID] {
        assert!(estimate.status.contains(bit), "{:?}", estimate.status);
    }
}

#[test]
fn q15_net_replaces_net_and_sets_its_status() {
    let float = calibration();
    let net = float.net.as_ref().and_then(Net::float).and_then(|net| QuantisedNet::new(net, 0.5));
    let net = net.map(Net::Quantised);
    let (finger, mut state) = Finger::new(Some(Calibration { net, ..float }));
    let quiet = settled(&finger, &mut state, &unloaded(0));
    assert_eq!(quiet.force, Force::known(0.0, 0.0, 0.0));
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 3_277));
    let Ok(Newtons(fz)) = estimate.force.z else { panic!("{:?}", estimate.force) };
    assert!((f64::from(fz) - 0.1f64.tanh()).abs() < 5e-4, "{fz}");
    assert!(estimate.status.contains(Status::RAN_QUANTISED), "{:?}", estimate.status);
    assert!(!estimate.status.contains(Status::RAN_NET), "{:?}", estimate.status);
}

#[test]
fn contact_point_method_is_selectable() {
    let (mut finger, mut state) = calibrated();
    finger.point_method = PointMethod::ArgMin;
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    assert!(estimate.status.contains(Status::RAN_ARG_MIN));
    assert!(!estimate.status.contains(Status::RAN_CENTROID));
}

/// Presses that flicker by ±1 % from scan to scan.
///
/// The filter leaves a hundredth of the flicker and does not delay the gate.
#[test]
fn filter_smooths_estimates_and_not_the_gate() {
    let (plain, mut plain_state) = calibrated();
    let (mut smooth, mut smooth_state) = calibrated();
    smooth.filter = Some(LowPass::new(100, 4000));
    let mut spread = [[f32::MAX, f32::MIN]; 2];
    for i in 0..2000u64 {
        let scan = match i {
            0..100 => unloaded(250 * i),
            _ => pressed(250 * i, 6, if i % 2 == 0 { 3_244 } else { 3_310 }),
        };
        let estimates =
            [plain.estimate(&mut plain_state, &scan), smooth.estimate(&mut smooth_state, &scan)];
        let [plain, smooth] = estimates;
        let contact = |estimate: &Estimate| estimate.status.contains(Status::CONTACT);
        assert_eq!(contact(&plain), contact(&smooth), "scan {i}");
        if i >= 1000 {
            for (spread, estimate) in spread.iter_mut().zip(&estimates) {
                let Ok(Newtons(fz)) = estimate.force.z else { panic!("{:?}", estimate.force) };
                *spread = [spread[0].min(fz), spread[1].max(fz)];
            }
        }
    }
    let [plain, smooth] = spread.map(|[low, high]| high - low);
    assert!(plain > 1.5e-3 && smooth < 0.01 * plain, "{plain} {smooth}");
    let middle = (spread[1][0] + spread[1][1]) / 2.0;
    assert!((f64::from(middle) - 0.1f64.tanh()).abs() < 1e-4, "{middle}");
}

#[test]
fn force_is_missing_without_calibration() {
    let (finger, mut state) = Finger::new(None);
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    assert_eq!(estimate.force, Force::none(NoValue::Uncalibrated));
    assert_eq!(estimate.sensors[0], Force::none(NoValue::Uncalibrated));
    assert_eq!(estimate.sensors[1], Force::none(NoValue::Absent));
    assert!(estimate.status.contains(Status::UNCALIBRATED));
}

#[test]
fn bias_alone_gives_contact_and_point() {
    let (finger, mut state) = Finger::new(None);
    state.take_bias(50);
    let taken = (0..50).find_map(|t| finger.estimate(&mut state, &unloaded(t)).bias);
    assert!(taken.unwrap().is_ok());
    let estimate = settled(&finger, &mut state, &pressed(0, 0, 6_554));
    assert!(estimate.status.contains(Status::CONTACT));
    assert!(estimate.status.contains(Status::BIASED));
    assert!(estimate.point.is_ok());
    assert_eq!(estimate.force.z, Err(NoValue::Uncalibrated));
}

#[test]
fn bias_taken_in_motion_keeps_the_old_one() {
    let (finger, mut state) = calibrated();
    let before = *state.bias();
    state.take_bias(100);
    let taken =
        (0..100).find_map(|t| finger.estimate(&mut state, &pressed(t, 5, 40 * t as u16)).bias);
    assert!(taken.unwrap().is_err());
    assert_eq!(*state.bias(), before);
    assert!(!state.biased());
}

#[test]
fn clearing_bias_restores_calibration_bias() {
    let (finger, mut state) = calibrated();
    let before = *state.bias();
    state.take_bias(10);
    for t in 0..10 {
        finger.estimate(&mut state, &pressed(t, 3, 500));
    }
    assert!(state.biased());
    assert_ne!(*state.bias(), before);
    finger.clear_bias(&mut state);
    assert_eq!(*state.bias(), before);
}

#[test]
fn clipped_taxel_removes_force() {
    let (finger, mut state) = calibrated();
    let estimate = settled(&finger, &mut state, &pressed(0, 6, u16::MAX - LIT));
    assert_eq!(estimate.force, Force::none(NoValue::Saturated));
    assert!(estimate.status.contains(Status::SATURATED));
    assert_eq!(estimate.signals.health.saturated, 1 << 6);
}

#[test]
fn dead_taxel_removes_force_and_keeps_point() {
    let (finger, mut state) = calibrated();
    let mut scan = pressed(0, 10, 6_554);
    scan.codes.taxels.as_mut().unwrap().lit[0][0] = Code(common::DARK);
    let estimate = settled(&finger, &mut state, &scan);
    assert_eq!(estimate.force, Force::none(NoValue::DeadChannel));
    assert!(estimate.status.contains(Status::DEAD_TAXEL));
    assert!(near(&estimate, 1.25, 1.25), "{:?}", estimate.point);
}

#[test]
fn dead_taxel_stays_dead_after_a_bias() {
    let (finger, mut state) = calibrated();
    let weak = |t: u64| {
        let mut scan = unloaded(t);
        scan.codes.taxels.as_mut().unwrap().lit[1][1] = Code(common::DARK + 1_500);
        scan
    };
    state.take_bias(10);
    let taken = (0..10).find_map(|t| finger.estimate(&mut state, &weak(t)).bias);
    assert!(taken.unwrap().is_ok(), "the other taxels may have their bias");
    let estimate = settled(&finger, &mut state, &weak(11));
    assert_eq!(estimate.signals.health.dead, 1 << 5);
    assert_eq!(estimate.force, Force::none(NoValue::DeadChannel));
}

#[test]
fn dead_taxel_alone_is_no_contact() {
    let (finger, mut state) = calibrated();
    let mut scan = unloaded(0);
    scan.codes.taxels.as_mut().unwrap().lit[0][0] = Code(common::DARK);
    let estimate = settled(&finger, &mut state, &scan);
    assert!(!estimate.status.contains(Status::CONTACT));
}

#[test]
fn signal_out_of_range_is_not_extrapolated() {
    let (finger, mut state) = calibrated();
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 39_000));
    assert_eq!(estimate.force, Force::none(NoValue::OutOfTrainedRange));
    assert!(estimate.status.contains(Status::OUT_OF_RANGE));
    assert!(estimate.point.is_ok(), "the centroid needs no calibration");
    // A finger that knows its places to a tenth of a millimetre gives none from the centroid.
    let record = Calibration { model: Some(Inverse::default()), ..calibration() };
    let (finger, mut state) = Finger::new(Some(record));
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 39_000));
    assert_eq!(estimate.point, Err(NoValue::OutOfTrainedRange));
}

#[test]
fn broken_bridge_arm_removes_that_sensor() {
    let (finger, mut state) = calibrated();
    let mut scan = unloaded(0);
    scan.codes.bridges[0].as_mut().unwrap().b = Code(u16::MAX);
    let estimate = settled(&finger, &mut state, &scan);
    assert_eq!(estimate.sensors[0], Force::none(NoValue::DeadChannel));
    assert!(estimate.status.contains(Status::BRIDGE_FAULT));
    assert!(!estimate.status.contains(Status::CONTACT), "a fault is not a touch");
}

#[test]
fn overrun_is_flagged_in_its_frame() {
    let (finger, mut state) = calibrated();
    let scan = Scan { lost: 1, ..unloaded(0) };
    assert!(finger.estimate(&mut state, &scan).status.contains(Status::OVERRUN));
}

#[test]
fn net_of_one_output_gives_no_shear() {
    let mut record = calibration();
    let Some(Net::Float(net)) = &mut record.net else { panic!("a net in f32") };
    net.output_bias = [0.0].into_iter().collect();
    assert_eq!(record.validate(), Ok(()));
    let (finger, mut state) = Finger::new(Some(record));
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    assert_eq!(estimate.force.x, Err(NoValue::NotEstimated));
    assert!(estimate.force.z.is_ok());
}

#[test]
fn contact_runs_all_sections_and_sets_their_status() {
    let (finger, mut state) = Finger::new(Some(everything()));
    let quiet = settled(&finger, &mut state, &unloaded(0));
    assert_eq!(quiet.force, Force::known(0.0, 0.0, 0.0));
    assert_eq!(quiet.status, Status::RAN_SENSORS | Status::RAN_WARMTH | Status::RAN_DRIFT);
    assert_eq!(quiet.slip, Err(NoValue::NoContact));
    // The force sensors measure none of this press. They contradict the matrix, whose error is
    // larger.
    let pressed = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    for bit in [Status::CONTACT, Status::RAN_MODEL, Status::RAN_LAG] {
        assert!(pressed.status.contains(bit), "{:?}", pressed.status);
    }
    assert!(!pressed.status.contains(Status::RAN_NET));
    assert!(!pressed.status.contains(Status::RAN_CENTROID));
    // A dent of one taxel alone is no contact of this model, which cannot place it.
    assert_eq!(pressed.point, Err(NoValue::IllConditioned));
}

/// Nothing, a contact and one whose light clips, twice; into the last estimate and into an empty
/// one.
#[test]
fn no_field_keeps_the_last_contacts_value() {
    for record in [calibration(), everything()] {
        let (finger, mut state) = Finger::new(Some(record));
        let mut kept = Estimate::NOTHING;
        for i in 0..120u64 {
            let time = 1000 * i;
            let scan = match i % 60 {
                0..30 => unloaded(time),
                30..50 => pressed(time, 6, 3_277),
                _ => pressed(time, 6, u16::MAX - LIT),
            };
            let (mut alike, mut fresh) = (state.clone(), Estimate::NOTHING);
            finger.update(&mut kept, &mut state, &scan, Wanted::ALL);
            finger.update(&mut fresh, &mut alike, &scan, Wanted::ALL);
            assert_eq!(kept, fresh, "scan {i}");
        }
    }
}

#[test]
fn stated_error_of_a_force_is_wider_while_it_changes() {
    let lag = Some(LagCompensation { taxels: 4e-3, sensors: 4e-3 });
    let (finger, mut state) = Finger::new(Some(Calibration { lag, ..calibration() }));
    let mut time = 0;
    let mut stated = |codes: u16| -> Vec<f32> {
        let estimate = |_| {
            time += 1000;
            let scan = if codes == 0 { unloaded(time) } else { pressed(time, 6, codes) };
            finger.estimate(&mut state, &scan).uncertainty.ok()?.force.z.ok()
        };
        (0..80).filter_map(estimate).map(|sigma| sigma.0).collect()
    };
    assert!(stated(0).is_empty());
    let touch = stated(3_277);
    assert!(touch[0] > 0.03 && *touch.last().unwrap() < 0.0101, "{touch:?}");
    let more = stated(6_554);
    assert!(more[1] > 0.02 && *more.last().unwrap() < 0.0101, "{more:?}");
    stated(0);
    let next = stated(6_554);
    assert!(next[0] > 0.06, "a contact knows nothing of the one before: {next:?}");
}

#[test]
fn chosen_point_method_runs_with_the_net() {
    let (mut finger, mut state) = Finger::new(Some(everything()));
    finger.point_method = PointMethod::Centroid;
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    for bit in [Status::RAN_NET, Status::RAN_CENTROID] {
        assert!(estimate.status.contains(bit), "{:?}", estimate.status);
    }
}

#[test]
fn force_sensors_replace_matrix_with_dead_taxel() {
    let (finger, mut state) = Finger::new(Some(everything()));
    let mut scan = pressed(0, 10, 6_554);
    let taxels = scan.codes.taxels.as_mut().unwrap();
    taxels.lit[0][0] = taxels.dark[0];
    scan.codes.bridges = [scan.codes.bridges[0]; 4];
    let estimate = settled(&finger, &mut state, &scan);
    assert!(estimate.status.contains(Status::DEAD_TAXEL));
    assert!(estimate.status.contains(Status::RAN_ARRAY), "{:?}", estimate.status);
    assert!(estimate.force.z.is_ok(), "{:?}", estimate.force);
    scan.codes.bridges[2] = None;
    let estimate = settled(&finger, &mut state, &scan);
    assert_eq!(estimate.force.z, Err(NoValue::DeadChannel));
}

#[test]
fn force_sensors_state_their_residual_and_half_a_per_cent() {
    let (finger, mut state) = Finger::new(Some(everything()));
    let mut scan = unloaded(0);
    scan.codes.taxels = None;
    scan.codes.bridges = [scan.codes.bridges[0]; 4];
    settled(&finger, &mut state, &scan);
    scan.codes.bridges.iter_mut().flatten().for_each(|bridge| bridge.a.0 += 2_000);
    let mut estimate = Estimate::NOTHING;
    for _ in 0..100 {
        scan.time.0 += 1000;
        estimate = finger.estimate(&mut state, &scan);
    }
    let (Ok(Newtons(fz)), Ok(sure)) = (estimate.force.z, estimate.uncertainty) else {
        panic!("{estimate:?}")
    };
    let sigma = sure.force.z.unwrap().0;
    assert!(fz.abs() > 0.02 && (sigma - 1e-3 - 0.005 * fz.abs()).abs() < 1e-6, "{fz}, {sigma}");
}

#[test]
fn matrix_and_sensors_that_contradict_are_flagged() {
    let (mut finger, mut state) = Finger::new(Some(everything()));
    finger.point_method = PointMethod::Centroid;
    let with_sensors = |mut scan: Scan| {
        scan.codes.bridges = [scan.codes.bridges[0]; 4];
        scan
    };
    let alone = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    assert!(alone.force.z.is_ok() && !alone.status.contains(Status::DISAGREE));
    settled(&finger, &mut state, &with_sensors(unloaded(0)));
    // The sensors feel nothing of 0.2 N. They are the surer ones.
    let both = settled(&finger, &mut state, &with_sensors(pressed(0, 6, 6_554)));
    assert!(both.status.contains(Status::DISAGREE), "{:?}", both.status);
    assert!(both.force.z.unwrap().0.abs() < 0.01, "{:?}", both.force);
    // A contradiction of 0.02 N may be an error.
    let light = settled(&finger, &mut state, &with_sensors(pressed(0, 6, 400)));
    assert!(!light.status.contains(Status::DISAGREE), "{:?}", light.status);
}

#[test]
fn force_sensor_gain_follows_temperature() {
    let mut record = everything();
    let warmth = record.warmth.as_mut().unwrap();
    warmth.offset = Default::default();
    // A rise of 5 K as a share of full scale.
    let warmer = 5.0 * PER_KELVIN;
    let gain = 1.0 / (1.0 + warmth.sensitivity * warmer);
    let force = |codes: f32| {
        let (finger, mut state) = Finger::new(Some(record.clone()));
        let mut scan = unloaded(0);
        scan.codes.bridges[0].as_mut().unwrap().a.0 += 2_000;
        scan.codes.temperature.as_mut().unwrap().0 += codes as u16;
        finger.estimate(&mut state, &scan).sensors[0].z.unwrap().0
    };
    let (cold, warm) = (force(0.0), force(warmer * 65_535.0));
    assert!(cold.abs() > 1e-3, "{cold}");
    assert!((warm / cold - gain).abs() < 1e-3, "{warm} {cold} {gain}");
}

/// Drift of a finger that rests or is touched.
struct Drifting {
    /// Light of a row at a second, over that at the begin.
    light: fn(f32, usize) -> f32,
    /// Zero of a force sensor at a second, in codes.
    zero: fn(f32) -> f32,
}

const NOTHING_DRIFTS: Drifting = Drifting { light: |_, _| 1.0, zero: |_| 0.0 };

/// Share of scans in contact over `seconds` of a drift. A taxel is pressed in the seconds
/// `touched`; scans count from half a second after them.
fn contacts(seconds: u64, touched: core::ops::Range<f32>, drifting: &Drifting) -> f32 {
    let drift = Some(DriftCompensation { most: 0.05 });
    let (finger, mut state) = Finger::new(Some(Calibration { drift, ..calibration() }));
    let mut judged = [0.0; 2];
    for i in 0..seconds * 1000 {
        let second = i as f32 / 1000.0;
        let is_touched = touched.contains(&second);
        let mut scan = pressed(1000 * i, 6, if is_touched { 6_554 } else { 0 });
        let TaxelCodes { lit, dark } = scan.codes.taxels.as_mut().unwrap();
        // A code that never changes is a fault.
        let noise = (i % 3) as f32;
        for (row, codes) in lit.iter_mut().enumerate() {
            for code in codes {
                let dark = f32::from(dark[0].0);
                let light = (drifting.light)(second, row);
                code.0 = (dark + (f32::from(code.0) - dark) * light + noise) as u16;
            }
        }
        let midpoint = &mut scan.codes.bridges[0].as_mut().unwrap().a.0;
        *midpoint = (f32::from(*midpoint) + (drifting.zero)(second) + noise) as u16;
        let estimate = finger.estimate(&mut state, &scan);
        assert!(
            !is_touched
                || second < touched.start + 0.1
                || estimate.status.contains(Status::CONTACT)
        );
        if second > touched.end + 0.5 || touched.is_empty() {
            judged[0] += 1.0;
            judged[1] += f32::from(u8::from(estimate.status.contains(Status::CONTACT)));
        }
    }
    judged[1] / judged[0]
}

#[test]
fn light_that_drifts_is_no_touch() {
    let none = 0.0..0.0;
    for light in [|_, _| 0.99, |_, _| 1.01, |_, _| 0.96] {
        let felt = contacts(4, none.clone(), &Drifting { light, ..NOTHING_DRIFTS });
        assert!(felt < 0.005, "{} of the light: {felt} of the scans in contact", light(0.0, 0));
    }
    let drifting = Drifting { light: |second, _| 1.0 - 0.004 * second, ..NOTHING_DRIFTS };
    assert_eq!(contacts(10, none, &drifting), 0.0, "0.4 % a second");
    // The light falls while the finger is touched, as fast as is assumed at most.
    let light = |second: f32, _| 1.0 - 0.0018 * (second - 1.0).clamp(0.0, 5.0);
    let felt = contacts(10, 1.0..6.0, &Drifting { light, ..NOTHING_DRIFTS });
    assert_eq!(felt, 0.0, "0.9 % in a touch of 5 s");
}

#[test]
fn row_or_force_sensor_that_drifts_is_no_touch() {
    let light = |second: f32, row| if row == 1 { 1.0 - 0.001 * second } else { 1.0 };
    let row = Drifting { light, ..NOTHING_DRIFTS };
    assert_eq!(contacts(20, 0.0..0.0, &row), 0.0, "a row of LEDs by 2 % in 20 s");
    // A ten-thousandth of full scale a second.
    let sensor = Drifting { zero: |second| 6.5 * second, ..NOTHING_DRIFTS };
    assert_eq!(contacts(60, 0.0..0.0, &sensor), 0.0, "at rest");
    let zero = |second: f32| 6.5 * (second - 1.0).clamp(0.0, 20.0);
    let felt = contacts(30, 1.0..21.0, &Drifting { zero, ..NOTHING_DRIFTS });
    assert_eq!(felt, 0.0, "in a touch of 20 s");
}

#[test]
fn bias_follows_from_one_and_a_half_seconds_after_a_touch_on() {
    let drift = Some(DriftCompensation { most: 0.05 });
    let (finger, mut state) = Finger::new(Some(Calibration { drift, ..calibration() }));
    let before = *state.bias();
    // The zero of a sensor is off by too little for a contact. A taxel is pressed for two seconds.
    let mut way = |milliseconds: core::ops::Range<u64>| {
        for i in milliseconds {
            let mut scan = pressed(1000 * i, 6, if i < 2000 { 6_554 } else { 0 });
            scan.codes.bridges[0].as_mut().unwrap().a.0 += (4 + i % 3) as u16;
            finger.estimate(&mut state, &scan);
        }
        let [now, begin] = [state.bias(), &before].map(|bias| bias.bridges[0].unwrap().level[0]);
        (begin - now) * 65_535.0 / 5.0
    };
    let ways = [way(0..2000), way(2000..3480), way(3480..5500), way(5500..15_000)];
    assert_eq!(ways[..2], [0.0; 2]);
    assert!((0.6..0.67).contains(&ways[2]), "{ways:?}");
    assert!((0.98..1.02).contains(&ways[3]), "{ways:?}");
}

#[test]
fn finger_without_drift_section_takes_drift_for_touch() {
    let (finger, mut state) = Finger::new(Some(calibration()));
    let felt = (0..20_000u64).any(|i| {
        let mut scan = unloaded(1000 * i);
        scan.codes.bridges[0].as_mut().unwrap().a.0 += (i / 150 + i % 3) as u16;
        finger.estimate(&mut state, &scan).status.contains(Status::CONTACT)
    });
    assert!(felt, "the compensation can be switched off");
}
