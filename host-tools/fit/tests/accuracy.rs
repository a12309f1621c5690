//! What the estimators are worth on devices and runs that no fit has met, noise on. `cargo bench -p taxel-fit
//! --bench accuracy` prints the figures.

mod judge;

use judge::{
    Ring, With, calibrated, errors, false_pairs, false_warnings, mean, onsets, pairs, presses,
    replay, resolution, run, tap_at_200_hz,
};

const DEVICES: [u32; 5] = [11, 12, 13, 14, 15];

#[test]
fn a_single_contact_is_placed_and_weighed_on_five_devices() {
    let mut rings: [Vec<[Ring; 3]>; 3] = Default::default();
    let (mut frames, mut doubled) = (0, 0);
    for device in DEVICES {
        let record = calibrated(device);
        let samples = run(device, 77, 1000, 13.0, 0.8, &presses(60, [0.0, 0.99], 2.0));
        for (rings, with) in rings.iter_mut().zip([With::Matrix, With::Array, With::Both]) {
            let estimates = replay(&record, &samples, with);
            let (touched, two) = false_pairs(&estimates);
            (frames, doubled) = (frames + touched, doubled + two);
            rings.push(errors(&samples, &estimates, if with == With::Array { 0.2 } else { 0.1 }));
        }
        for with in [With::Matrix, With::Both] {
            let sigma = resolution(device, &record, with);
            println!("{device} {with:?}: resolution {sigma:.5?} N");
            assert!(sigma[2] < 0.002, "{with:?}: {sigma:?}");
            let left = tap_at_200_hz(device, &record, with);
            println!("{device} {with:?}: {left:.3} of a tap of 2.5 ms is left");
            assert!((0.707..1.3).contains(&left), "{with:?}: {left}");
        }
    }
    assert!(doubled * 100 < frames, "{doubled} of {frames} single contacts taken for two");
    let [matrix, array, both] = rings.each_ref().map(|devices| {
        move |i: usize, of: fn(&Ring) -> f64| mean(devices.iter().map(|rings| of(&rings[i])))
    });
    let point: fn(&Ring) -> f64 = |ring| ring.point.value();
    let direction: fn(&Ring) -> f64 = |ring| ring.direction.value();
    let torsion: fn(&Ring) -> f64 = |ring| ring.torsion.value();
    let force: [fn(&Ring) -> f64; 3] =
        [|ring| ring.force[0].value(), |ring| ring.force[1].value(), |ring| ring.force[2].value()];
    for (name, of) in [("matrix", &matrix as &dyn Fn(usize, _) -> f64), ("both", &both)] {
        let places = [of(0, point), of(1, point)];
        assert!(places[0] < 0.1 && places[1] < 0.2, "{name}: {places:?} mm");
        let central = force.map(|axis| of(0, axis));
        assert!(central[0] < 0.03 && central[1] < 0.03, "{name}: {central:?} N");
        assert!(of(2, force[2]) < 0.02, "{name}: {} N", of(2, force[2]));
        assert!(of(0, direction) < 3.0, "{name}: {} degrees", of(0, direction));
    }
    assert!(array(1, point) < 0.2, "{} mm", array(1, point));
    assert!(array(2, torsion) < 0.3, "{} N mm", array(2, torsion));
}

#[test]
fn two_contacts_two_pitches_apart_are_found() {
    let record = calibrated(16);
    let pairs = pairs(16, &record, 200, With::Matrix);
    println!("{pairs:?}");
    assert!(pairs.found * 100 >= pairs.shown * 95, "{pairs:?}");
    assert!(pairs.point.value() < 0.1 && pairs.normal.value() < 0.02, "{pairs:?}");
}

#[test]
fn slip_is_told_20_ms_ahead_in_95_of_100_onsets_known_friction_or_not() {
    let mut all = [0; 2];
    for device in [17, 18, 19] {
        let onsets = onsets(device, &calibrated(device), With::Both);
        println!("{device}: {onsets:?}");
        let [first, later] = [onsets.first, onsets.later];
        assert_eq!(later[0], later[1], "{device}: {onsets:?}");
        (0..2).for_each(|i| all[i] += first[i] + later[i]);
    }
    let [shown, ahead] = all;
    assert!(ahead * 100 >= shown * 95, "{ahead} of {shown}");
}

#[test]
fn force_sensors_alone_tell_slip_20_ms_ahead_once_friction_has_been_felt() {
    let [shown, ahead] = onsets(17, &calibrated(17), With::Array).later;
    assert!(ahead * 100 >= shown * 95, "{ahead} of {shown}");
}

#[test]
fn a_grasp_on_known_friction_is_left_in_peace() {
    let record = calibrated(17);
    for mu in [0.2, 0.6, 1.2] {
        let warnings = false_warnings(17, &record, (With::Both, mu, true), 4.0);
        println!("mu {mu}: {warnings} false warnings in 4 min");
        assert_eq!(warnings, 0, "friction {mu}");
    }
}
