//! What the finger says of a scene, and what it says when it cannot know.

mod common;

use common::{LIT, calibration, everything, pressed, unloaded};
use proptest::prelude::*;
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::condition::{LowPass, Warmth};
use taxel::estimate::array::WrenchMethod;
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::field::{Field, Radial};
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::inverse::Curves;
use taxel::estimate::net::{ForceNet, Unit};
use taxel::estimate::quantised::{Group, QuantisedNet, Rows};
use taxel::estimate::wrench::{SensorPlaces, WrenchMatrix};
use taxel::estimate::{ContactPoint, Force};
use taxel::finger::{Estimate, Finger, FingerState};
use taxel::frame::Status;
use taxel::measured::NoValue;
use taxel::scan::{Codes, Midpoints, Scan, TaxelCodes};
use taxel::units::{Code, FullScale, Micros, Millimetres, Newtons};

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

fn any_codes() -> impl Strategy<Value = Codes> {
    let midpoints = any::<[u16; 4]>().prop_map(|[a, b, c, d]| Midpoints {
        a: Code(a),
        b: Code(b),
        c: Code(c),
        d: Code(d),
    });
    (
        1u16..,
        proptest::option::of(any::<([[u16; 4]; 4], [u16; 4])>()),
        proptest::array::uniform4(proptest::option::of(midpoints)),
        any::<(Option<u16>, Option<u16>)>(),
    )
        .prop_map(|(top, taxels, bridges, (reference, temperature))| Codes {
            full_scale: FullScale::new(top).unwrap(),
            taxels: taxels.map(|(lit, dark)| TaxelCodes {
                lit: lit.map(|row| row.map(Code)),
                dark: dark.map(Code),
            }),
            bridges,
            reference: reference.map(Code),
            temperature: temperature.map(Code),
        })
}

fn finite(estimate: &Estimate) -> bool {
    let forces = estimate.sensors.iter().chain([&estimate.force]);
    let forces = forces.flat_map(|f| [f.x, f.y, f.z]).flatten().map(|n| n.0);
    let at = |p: ContactPoint| [p.x.0, p.y.0];
    let contacts = estimate.contacts.into_iter().flatten();
    let slip = estimate.slip.into_iter().flat_map(|v| [v.margin, v.friction, v.grip.0]);
    forces
        .chain(estimate.point.into_iter().flat_map(at))
        .chain(contacts.flat_map(|c| [c.point.x.0, c.point.y.0, c.normal.0]))
        .chain(slip)
        .chain(estimate.torsion.into_iter().map(|t| t.0))
        .chain(estimate.signals.taxels.into_iter().flatten())
        .chain(estimate.signals.bridges.into_iter().flatten().flatten())
        .all(f32::is_finite)
}

/// A net in 16 bits that fills its sums as far as it may: a record's other net is not asked beside it.
fn hostile_in_sixteen_bits(weight: f32) -> QuantisedNet {
    // Sums of products stay within 32 bits: 1000 · 2¹⁵ · 32 is half of them.
    let most: [i16; 16] = core::array::from_fn(|k| if k % 2 == 0 { -1000 } else { 1000 });
    let sign = if weight < 0.0 { most } else { most.map(|w| !w) };
    let bias = [if weight < 0.0 { 1 } else { -1 }; 4];
    let group = Group { weights: Rows::new(&[sign; 4]), bias };
    QuantisedNet {
        signal: 1.0 + 9e8 * weight.abs().min(1.0),
        hidden: core::iter::repeat_n(group, 8).collect(),
        shift: 31,
        output: core::iter::repeat_n(Rows::new(&[most; 3]), 2).collect(),
        skip: Some(Rows::new(&[most; 3])),
        scale: [weight.clamp(-9e19, 9e19), -weight.clamp(-9e19, 9e19)],
        output_bias: core::iter::repeat_n(weight, 3).collect(),
    }
}

/// A record whose every number is hostile but accepted.
fn hostile(weight: f32, level: f32, sixteen_bits: bool) -> Calibration {
    let mut record = everything();
    let taxels = record.taxels.as_mut().unwrap();
    taxels.bias.level = [level; 16];
    taxels.bias.noise = 1e-9;
    taxels.range = [[-9e29, 9e29]; 16];
    let unit = Unit { weights: [weight; 16], bias: -weight, output: [weight; 3] };
    record.force = Some(ForceNet {
        units: core::iter::repeat_n(unit, 32).collect(),
        skip: Some([[weight; 16]; 3]),
        output_bias: [weight; 3].into(),
    });
    if sixteen_bits {
        (record.force, record.quantised) = (None, Some(hostile_in_sixteen_bits(weight)));
    }
    // Half of the light and of the sensitivity over the farthest that is followed, 60 K of 758 µ each.
    let share = 10.9 * (level / 2.0);
    record.warmth = Some(Warmth {
        reference: level.abs() / 2.0,
        range: [-9e29, 9e29],
        light: share,
        sensitivity: -share,
        offset: [[weight.clamp(-1e3, 1e3); 3]; 4],
    });
    for sensor in record.sensors.iter_mut().flatten() {
        sensor.range = [[-9e29, 9e29]; 3];
        sensor.sensitivity.0 = [[weight; 3]; 3];
    }
    let model = record.model.as_mut().unwrap();
    model.curves = Curves { stray: [[level / 2.5; 4]; 16], gap: [[weight; 5]; 16] };
    let radial = Radial { depth: [level, weight], terms: [[weight, level, -weight]; 4] };
    model.field = Field { normal: radial, shear: radial, slip: level / 2.0 };
    let array = record.array.as_mut().unwrap();
    array.method = match level > 0.0 {
        true => WrenchMethod::Sum(SensorPlaces([[weight; 3]; 4])),
        false => WrenchMethod::Matrix(WrenchMatrix([[[weight; 3]; 4]; 6])),
    };
    array.surface = Surface::Sphere { radius: Millimetres(1.0 + level.abs()) };
    record
}

#[test]
fn a_touch_runs_what_the_record_holds_and_the_status_says_so() {
    let (finger, mut state) = Finger::new(Some(everything()));
    let quiet = settled(&finger, &mut state, &unloaded(0));
    assert_eq!(quiet.force, Force::known(0.0, 0.0, 0.0));
    assert_eq!(quiet.status, Status(Status::RAN_SENSORS.0 | Status::RAN_WARMTH.0));
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn no_codes_and_no_accepted_calibration_give_nan_or_infinity(
        scans in proptest::collection::vec(any_codes(), 1..8),
        weight in prop_oneof![-9e29f32..9e29, -1e-38f32..1e-38, -10.0f32..10.0],
        level in -2.0f32..2.0,
        (sixteen_bits, taking) in any::<(bool, bool)>(),
        method in prop_oneof![
            Just(PointMethod::Model), Just(PointMethod::Centroid), Just(PointMethod::ArgMin),
        ],
        corner in proptest::option::of(1u16..2000),
    ) {
        let record = hostile(weight, level, sixteen_bits);
        prop_assert_eq!(record.validate(), Ok(()));
        let (mut finger, mut state) = Finger::new(Some(record));
        finger.point_method = method;
        finger.filter = corner.map(|corner| LowPass::new(corner, 4000));
        if taking {
            state.take_bias(3);
        }
        for (t, codes) in scans.into_iter().enumerate() {
            for _ in 0..6 {
                let scan = Scan { time: Micros(t as u64), lost: 0, codes };
                let estimate = finger.estimate(&mut state, &scan);
                prop_assert!(finite(&estimate), "{estimate:?}");
            }
        }
    }

    #[test]
    fn no_bytes_make_the_calibration_reader_panic(
        bytes in proptest::collection::vec(any::<u8>(), 0..300),
    ) {
        let _ = Calibration::from_bytes(&bytes);
    }

    #[test]
    fn a_record_with_any_field_overwritten_is_refused_or_harmless(
        at in any::<usize>(), with in any::<[u8; 4]>(), codes in any_codes(),
    ) {
        // The CRC is made right again, so that the fields themselves have to hold.
        let mut buffer = [0; MAX_BYTES];
        let length = everything().to_bytes(&mut buffer).unwrap().len();
        let at = 2 + at % (length - 10);
        buffer[at..at + 4].copy_from_slice(&with);
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&buffer[..length - 4]);
        buffer[length - 4..length].copy_from_slice(&crc.to_le_bytes());
        if let Ok(record) = Calibration::from_bytes(&buffer[..length]) {
            let (finger, mut state) = Finger::new(Some(record));
            for t in 0..8 {
                let scan = Scan { time: Micros(1000 * t), lost: 0, codes };
                prop_assert!(finite(&finger.estimate(&mut state, &scan)));
            }
        }
    }
}
