//! Four MEMS-3AXIS sensors as an array ([Ospina2017], chapter 2): wrench, contact point and torsion
//! from codes.

use std::sync::atomic::AtomicBool;

use taxel::estimate::intrinsic::Surface;
use taxel::estimate::wrench::SensorPlaces;
use taxel::scan::SENSORS;
use taxel::units::Millimetres;
use taxel_calibrate::finger::{FitOptions, fit};
use taxel_calibrate::recording::Recording;

use crate::{changed, force, signals};

/// Largest errors on a scene's unseen recording.
#[derive(Debug, Default)]
struct Worst {
    force_n: f64,
    place_mm: f64,
    torsion_nmm: f64,
}

/// Calibrates the sensors by their own columns in the scene `array` and judges them with changes.
///
/// Forces below half a newton give no contact point.
fn judged(fingertip: &str, set: &[&str], surface: Surface) -> Worst {
    let fingertip = format!("device.surface{fingertip}");
    let run = |set: &[&str], seed| changed("array", &[&[fingertip.as_str()], set].concat(), seed);
    let recording = Recording { name: fingertip.clone(), samples: run(&[], 1) };
    let stop = AtomicBool::new(false);
    let fitted = fit(&[recording], &FitOptions::default(), &mut |_| {}, &stop).unwrap();
    let sensors = fitted.calibration.sensors;
    let unseen = run(set, 2);
    let mut worst = Worst::default();
    let mut placed = 0;
    for (signals, sample) in signals(&unseen) {
        let forces: [[f32; 3]; SENSORS] = std::array::from_fn(|i| {
            sensors[i].as_ref().unwrap().sensitivity.force(signals.bridges[i].unwrap())
        });
        let wrench = SensorPlaces::default().wrench(&forces);
        for (found, asked) in wrench.force.into_iter().zip(force(sample)) {
            worst.force_n = worst.force_n.max((f64::from(found) - asked).abs());
        }
        if force(sample)[2] < 0.5 {
            continue;
        }
        placed += 1;
        let contact = surface.contact(&wrench, 0.2).unwrap();
        let [x, y] = sample.truth.point.map(Option::unwrap);
        let off = (f64::from(contact.place[0]) - x).hypot(f64::from(contact.place[1]) - y);
        worst.place_mm = worst.place_mm.max(off);
        let torsion = (f64::from(contact.torsion.0) - sample.truth.torsion.unwrap()).abs();
        worst.torsion_nmm = worst.torsion_nmm.max(torsion);
    }
    assert!(placed > unseen.len() / 4);
    worst
}

const SPHERE: Surface = Surface::Sphere { radius: Millimetres(12.0) };
const ELLIPSOID: Surface =
    Surface::Ellipsoid { half_axes: [Millimetres(14.0), Millimetres(10.0), Millimetres(8.0)] };

/// Fingertips as scenes write them, with the surface that judges them.
const FINGERTIPS: [(&str, Surface); 3] =
    [("=plane", Surface::Plane), (".sphere=12", SPHERE), (".ellipsoid=[14, 10, 8]", ELLIPSOID)];

#[test]
fn wrench_point_torsion_hold_on_every_surface() {
    for (fingertip, surface) in FINGERTIPS {
        let worst = judged(fingertip, &[], surface);
        assert!(worst.force_n < 0.01, "{fingertip}: {worst:?}");
        assert!(worst.place_mm < 0.15, "{fingertip}: {worst:?}");
        assert!(worst.torsion_nmm < 0.08, "{fingertip}: {worst:?}");
    }
}

#[test]
fn moving_contact_point_is_tracked() {
    // The sensors lag, all alike, so that the contact point lags by a few milliseconds.
    let lags = ["random=", "press=", "effects.response=true"];
    let [_, (sphere, _), (ellipsoid, _)] = FINGERTIPS;
    let roll = |at_s: &str, from: &str, to: &str, fz_n: &str| {
        let roll = "rise_s=0.2,travel_s=1.4,fall_s=0.2";
        format!("{{at_s={at_s},from_mm={from},to_mm={to},fz_n={fz_n},{roll}}}")
    };
    let there = roll("0.5", "[-3.5, -1]", "[3.5, 1]", "1");
    let rolls = format!("roll=[{there},{}]", roll("2.6", "[1, 3.5]", "[-1, -3.5]", "0.6"));
    let set = [&lags[..], &["friction=", "scan.duration_s=5", &rolls]].concat();
    let rolled = judged(ellipsoid, &set, ELLIPSOID);
    assert!(rolled.place_mm < 0.2 && rolled.torsion_nmm < 0.1, "{rolled:?}");
    let slide = "slide=[{at_s=0.5,from_mm=[-3, 0.5],to_mm=[3, -0.5],fz_n=1,rise_s=0.3,travel_s=2,\
                 fall_s=0.3,spring={stiffness_n_mm=1,mass_g=20}}]";
    let timing = ["scan.rate_hz=2000", "scan.duration_s=4"];
    let set = [&lags[..], &timing, &["friction.mu_kinetic=0.5", slide]].concat();
    let dragged = judged(sphere, &set, SPHERE);
    assert!(dragged.place_mm < 0.3, "{dragged:?}");
}

#[test]
fn torsion_slips_in_the_truth_of_every_surface() {
    for (fingertip, _) in FINGERTIPS {
        let samples = changed("array", &[&format!("device.surface{fingertip}")], 1);
        let slips = |twisted: bool| {
            let slips = samples.iter().filter(|s| s.truth.slip == Some(true));
            slips.filter(|s| (s.truth.torsion != Some(0.0)) == twisted).count()
        };
        assert!(slips(true) > 100 && slips(false) == 0, "{fingertip}");
    }
}
