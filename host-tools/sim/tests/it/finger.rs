//! TAXEL-4x4 ([DeMaria2011]): contact and contact point from codes, without a calibration.

use taxel::finger::{Finger, FingerState};
use taxel::frame::Status;
use taxel_files::trace::Sample;

use crate::{force, run};

/// Every frame after the bias: whether the finger reports contact, and its contact point.
fn detected(samples: &[Sample]) -> Vec<(bool, Option<[f64; 2]>, &Sample)> {
    let (finger, mut state): (Finger, FingerState) = Finger::new(None);
    state.take_bias(crate::UNLOADED);
    let estimates = samples.iter().map(|sample| {
        let estimate = finger.estimate(&mut state, &sample.scan);
        let point = estimate.point.ok().map(|p| [p.x.0, p.y.0].map(f64::from));
        (estimate.status.contains(Status::CONTACT), point, sample)
    });
    estimates.skip(crate::UNLOADED.into()).collect()
}

#[test]
fn every_grid_press_is_detected_and_located() {
    let samples = run("press-grid", 1);
    let rows = detected(&samples);
    let missed = rows.iter().filter(|(contact, _, s)| force(s)[2] > 0.02 && !contact).count();
    let made_up = rows.iter().filter(|(contact, _, s)| force(s)[2] == 0.0 && *contact).count();
    // The gate waits some frames before it opens and before it closes: 49 of them.
    assert!(missed <= 2 * 49 && made_up <= 3 * 49, "{missed}, {made_up}");
    let (mut squares, mut n) = (0.0, 0.0);
    for (_, point, sample) in &rows {
        let [x, y] = sample.truth.point.map(|c| c.unwrap_or(f64::MAX));
        if force(sample)[2] > 0.5 && x.abs() < 2.0 && y.abs() < 2.0 {
            let [px, py] = point.unwrap();
            squares += (px - x).powi(2) + (py - y).powi(2);
            n += 2.0;
        }
    }
    let rms = f64::sqrt(squares / n);
    assert!(n > 0.0 && rms < 0.75, "{rms} mm");
}

#[test]
fn two_contacts_have_one_combined_truth() {
    let samples = run("two-contacts", 1);
    let both = samples.iter().find(|s| force(s)[2] > 1.599).unwrap();
    // Forces: 0.6 N at (−3.5, −3.5) and 1 N at (3.5, 3.5).
    let middle = (1.0 - 0.6) / 1.6 * 3.5;
    for place in both.truth.point {
        assert!((place.unwrap() - middle).abs() < 0.01);
    }
    assert_eq!(both.truth.contact, Some(true));
}
