//! Four MEMS-3AXIS sensors as an array (003, chapter 2): wrench, contact point and torsion out of codes.

use std::sync::atomic::AtomicBool;

use taxel::estimate::intrinsic::Surface;
use taxel::estimate::wrench::SensorPlaces;
use taxel::scan::SENSORS;
use taxel::units::Millimetres;
use taxel_fit::finger::{FitOptions, fit};
use taxel_fit::recording::Recording;

use crate::{force, run, signals};

/// Worst of what a scene's unseen recording is met with.
#[derive(Debug, Default)]
struct Worst {
    force_n: f64,
    place_mm: f64,
    torsion_nmm: f64,
}

/// Sensors are calibrated by their own columns; forces below half a newton place nothing.
fn judged(scene: &str, surface: Surface) -> Worst {
    let samples = run(scene, 1);
    let recording = Recording { name: scene.into(), samples };
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

#[test]
fn wrench_place_and_torsion_come_out_on_every_surface() {
    let sphere = Surface::Sphere { radius: Millimetres(12.0) };
    let ellipsoid = Surface::Ellipsoid { half_axes: [14.0, 10.0, 8.0].map(Millimetres) };
    for (scene, surface) in
        [("array-plane", Surface::Plane), ("array-sphere", sphere), ("array-ellipsoid", ellipsoid)]
    {
        let worst = judged(scene, surface);
        assert!(worst.force_n < 0.01, "{scene}: {worst:?}");
        assert!(worst.place_mm < 0.15, "{scene}: {worst:?}");
        assert!(worst.torsion_nmm < 0.08, "{scene}: {worst:?}");
    }
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
