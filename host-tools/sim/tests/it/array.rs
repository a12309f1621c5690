//! Four MEMS-3AXIS sensors as an array ([Ospina2017], chapter 2): wrench, contact point and torsion
//! from codes.

use std::sync::atomic::AtomicBool;

use taxel::estimate::intrinsic::Surface;
use taxel::estimate::wrench::SensorPlaces;
use taxel::scan::SENSORS;
use taxel::units::Millimetres;
use taxel_calibrate::finger::{FitOptions, fit};
use taxel_calibrate::recording::Recording;

use crate::{force, run, signals};

/// Largest errors on a scene's unseen recording.
#[derive(Debug, Default)]
struct Worst {
    force_n: f64,
    place_mm: f64,
    torsion_nmm: f64,
}

/// Calibrates the sensors by their own columns in one scene and judges them in another.
///
/// Forces below half a newton give no contact point.
fn judged(calibrated: &str, scene: &str, surface: Surface) -> Worst {
    let recording = Recording { name: calibrated.into(), samples: run(calibrated, 1) };
    let stop = AtomicBool::new(false);
    let fitted = fit(&[recording], &FitOptions::default(), &mut |_| {}, &stop).unwrap();
    let sensors = fitted.calibration.sensors;
    let unseen = run(scene, 2);
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

#[test]
fn wrench_point_torsion_hold_on_every_surface() {
    for (scene, surface) in
        [("array-plane", Surface::Plane), ("array-sphere", SPHERE), ("array-ellipsoid", ELLIPSOID)]
    {
        let worst = judged(scene, scene, surface);
        assert!(worst.force_n < 0.01, "{scene}: {worst:?}");
        assert!(worst.place_mm < 0.15, "{scene}: {worst:?}");
        assert!(worst.torsion_nmm < 0.08, "{scene}: {worst:?}");
    }
}

#[test]
fn moving_contact_point_is_tracked() {
    // The sensors lag, all alike, so that the contact point lags by a few milliseconds.
    let rolled = judged("array-ellipsoid", "array-roll", ELLIPSOID);
    assert!(rolled.place_mm < 0.2 && rolled.torsion_nmm < 0.1, "{rolled:?}");
    let dragged = judged("array-sphere", "array-slide", SPHERE);
    assert!(dragged.place_mm < 0.3, "{dragged:?}");
}

#[test]
fn torsion_slips_in_the_truth_of_every_surface() {
    for scene in ["array-plane", "array-sphere", "array-ellipsoid"] {
        let samples = run(scene, 1);
        let slips = |twisted: bool| {
            let slips = samples.iter().filter(|s| s.truth.slip == Some(true));
            slips.filter(|s| (s.truth.torsion != Some(0.0)) == twisted).count()
        };
        assert!(slips(true) > 100 && slips(false) == 0, "{scene}");
    }
}
