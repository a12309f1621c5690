//! What the finger says of a scene, and what it says when it cannot know.

use crate::common;
use crate::common::{LIT, calibration, everything, pressed, unloaded};
use taxel::calibration::Calibration;
use taxel::condition::{LowPass, PER_KELVIN};
use taxel::estimate::Force;
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::quantised::QuantisedNet;
use taxel::finger::{Estimate, Finger, FingerState};
use taxel::frame::Status;
use taxel::measured::NoValue;
use taxel::scan::Scan;
use taxel::units::{Code, Newtons};

fn calibrated() -> (Finger, FingerState) {
    Finger::new(Some(calibration()))
}

/// The estimate after the same scan has come often enough for the gate to make up its mind.
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
fn an_untouched_finger_feels_zero_force_and_runs_no_estimator_of_the_matrix() {
    let (finger, mut state) = calibrated();
    let estimate = settled(&finger, &mut state, &unloaded(0));
    assert_eq!(estimate.force, Force::known(0.0, 0.0, 0.0));
    assert_eq!(estimate.point, Err(NoValue::NoContact));
    assert_eq!(estimate.status, Status::RAN_SENSORS);
}

#[test]
fn a_press_has_a_force_and_a_place() {
    let (finger, mut state) = calibrated();
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    let Ok(Newtons(fz)) = estimate.force.z else { panic!("{:?}", estimate.force) };
    assert!((f64::from(fz) - 0.1f64.tanh()).abs() < 1e-4, "{fz}");
    assert!(near(&estimate, 1.25, -1.25), "{:?}", estimate.point);
    for bit in [Status::CONTACT, Status::RAN_NET, Status::RAN_CENTROID] {
        assert!(estimate.status.contains(bit), "{:?}", estimate.status);
    }
}

#[test]
fn a_net_in_sixteen_bits_runs_instead_of_the_other_and_the_status_says_so() {
    let float = calibration();
    let quantised = float.force.as_ref().and_then(|net| QuantisedNet::new(net, 0.5));
    let (finger, mut state) = Finger::new(Some(Calibration { force: None, quantised, ..float }));
    let quiet = settled(&finger, &mut state, &unloaded(0));
    assert_eq!(quiet.force, Force::known(0.0, 0.0, 0.0));
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    let Ok(Newtons(fz)) = estimate.force.z else { panic!("{:?}", estimate.force) };
    assert!((f64::from(fz) - 0.1f64.tanh()).abs() < 5e-4, "{fz}");
    assert!(estimate.status.contains(Status::RAN_QUANTISED), "{:?}", estimate.status);
    assert!(!estimate.status.contains(Status::RAN_NET), "{:?}", estimate.status);
}

#[test]
fn the_contact_point_method_is_selectable_and_named_in_the_status() {
    let (mut finger, mut state) = calibrated();
    finger.point_method = PointMethod::ArgMin;
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    assert!(estimate.status.contains(Status::RAN_ARG_MIN));
    assert!(!estimate.status.contains(Status::RAN_CENTROID));
}

/// Presses that flicker by ±1 % from scan to scan: with a filter a hundredth of it is left, and the gate as
/// quick as before.
#[test]
fn a_filter_quietens_forces_and_places_and_delays_nothing_but_them() {
    let (plain, mut plain_state) = calibrated();
    let (mut smooth, mut smooth_state) = calibrated();
    smooth.filter = Some(LowPass::new(100, 4000));
    let mut spread = [[f32::MAX, f32::MIN]; 2];
    for i in 0..2000u64 {
        let scan = match i {
            0..100 => unloaded(250 * i),
            _ => pressed(250 * i, 6, if i % 2 == 0 { 6_488 } else { 6_620 }),
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
fn without_a_calibration_nothing_is_said_about_force() {
    let (finger, mut state) = Finger::new(None);
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    assert_eq!(estimate.force, Force::none(NoValue::Uncalibrated));
    assert_eq!(estimate.sensors[0], Force::none(NoValue::Uncalibrated));
    assert_eq!(estimate.sensors[1], Force::none(NoValue::Absent));
    assert!(estimate.status.contains(Status::UNCALIBRATED));
}

#[test]
fn a_bias_alone_is_enough_for_contact_and_place() {
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
fn bias_is_refused_while_the_finger_is_moving_and_the_old_one_stays() {
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
fn clearing_the_bias_brings_back_the_calibrations() {
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
fn a_clipped_taxel_withholds_the_force_and_says_so() {
    let (finger, mut state) = calibrated();
    let estimate = settled(&finger, &mut state, &pressed(0, 6, u16::MAX - LIT));
    assert_eq!(estimate.force, Force::none(NoValue::Saturated));
    assert!(estimate.status.contains(Status::SATURATED));
    assert_eq!(estimate.signals.health.saturated, 1 << 6);
}

#[test]
fn a_dead_taxel_withholds_the_force_but_not_the_place() {
    let (finger, mut state) = calibrated();
    let mut scan = pressed(0, 10, 6_554);
    scan.codes.taxels.as_mut().unwrap().lit[0][0] = Code(common::DARK);
    let estimate = settled(&finger, &mut state, &scan);
    assert_eq!(estimate.force, Force::none(NoValue::DeadChannel));
    assert!(estimate.status.contains(Status::DEAD_TAXEL));
    assert!(near(&estimate, 1.25, 1.25), "{:?}", estimate.point);
}

#[test]
fn a_bias_does_not_make_a_dead_taxel_pass_for_a_dark_one() {
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
fn a_dead_taxel_alone_is_no_contact() {
    let (finger, mut state) = calibrated();
    let mut scan = unloaded(0);
    scan.codes.taxels.as_mut().unwrap().lit[0][0] = Code(common::DARK);
    let estimate = settled(&finger, &mut state, &scan);
    assert!(!estimate.status.contains(Status::CONTACT));
}

#[test]
fn beyond_the_trained_range_there_is_a_reason_not_an_extrapolation() {
    let (finger, mut state) = calibrated();
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 39_000));
    assert_eq!(estimate.force, Force::none(NoValue::OutOfTrainedRange));
    assert!(estimate.status.contains(Status::OUT_OF_RANGE));
}

#[test]
fn a_broken_bridge_arm_withholds_that_sensor() {
    let (finger, mut state) = calibrated();
    let mut scan = unloaded(0);
    scan.codes.bridges[0].as_mut().unwrap().b = Code(u16::MAX);
    let estimate = settled(&finger, &mut state, &scan);
    assert_eq!(estimate.sensors[0], Force::none(NoValue::DeadChannel));
    assert!(estimate.status.contains(Status::BRIDGE_FAULT));
    assert!(!estimate.status.contains(Status::CONTACT), "a fault is not a touch");
}

#[test]
fn an_overrun_is_flagged_in_its_frame() {
    let (finger, mut state) = calibrated();
    let scan = Scan { lost: 1, ..unloaded(0) };
    assert!(finger.estimate(&mut state, &scan).status.contains(Status::OVERRUN));
}

#[test]
fn a_normal_only_net_says_nothing_about_shear() {
    let mut record = calibration();
    let net = record.force.as_mut().unwrap();
    net.output_bias = [0.0].into_iter().collect();
    assert_eq!(record.validate(), Ok(()));
    let (finger, mut state) = Finger::new(Some(record));
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    assert_eq!(estimate.force.x, Err(NoValue::NotEstimated));
    assert!(estimate.force.z.is_ok());
}

#[test]
fn a_touch_runs_what_the_record_holds_and_the_status_says_so() {
    let (finger, mut state) = Finger::new(Some(everything()));
    let quiet = settled(&finger, &mut state, &unloaded(0));
    assert_eq!(quiet.force, Force::known(0.0, 0.0, 0.0));
    assert_eq!(quiet.status, Status::RAN_SENSORS | Status::RAN_WARMTH);
    assert_eq!(quiet.slip, Err(NoValue::NoContact));
    // The force sensors feel nothing of this press: they contradict the matrix, which is less sure.
    let pressed = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    for bit in [Status::CONTACT, Status::RAN_MODEL] {
        assert!(pressed.status.contains(bit), "{:?}", pressed.status);
    }
    assert!(!pressed.status.contains(Status::RAN_NET));
    assert!(!pressed.status.contains(Status::RAN_CENTROID));
    let point = pressed.point.unwrap();
    assert!((point.x.0 - 1.25).abs() < 0.3 && (point.y.0 + 1.25).abs() < 0.3, "{point:?}");
}

#[test]
fn a_chosen_method_of_the_paper_runs_beside_the_net() {
    let (mut finger, mut state) = Finger::new(Some(everything()));
    finger.point_method = PointMethod::Centroid;
    let estimate = settled(&finger, &mut state, &pressed(0, 6, 6_554));
    for bit in [Status::RAN_NET, Status::RAN_CENTROID] {
        assert!(estimate.status.contains(bit), "{:?}", estimate.status);
    }
}

#[test]
fn where_a_taxel_is_dead_the_force_sensors_stand_for_both() {
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
fn warm_force_sensors_are_read_with_the_gain_of_their_temperature() {
    let mut record = everything();
    let warmth = record.warmth.as_mut().unwrap();
    warmth.offset = Default::default();
    // 5 K on, in fractions of full scale.
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
