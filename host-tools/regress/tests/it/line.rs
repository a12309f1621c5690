//! Test of the 4×1 prototype of [DeMaria2011] with an automatically chosen model.
//!
//! Contact position and angle are estimated directly from the codes.

use std::fmt::Write as _;
use std::sync::atomic::AtomicBool;

use taxel_files::table::read_from;
use taxel_files::trace::Sample;
use taxel_regress::model::Family;
use taxel_regress::table::{TableOptions, TableRecording, evaluate, fit};
use taxel_sim::{Scene, Simulator};

/// Light gained by the four taxels, less the dark, as a share of full scale.
fn light(sample: &Sample) -> [f64; 4] {
    let taxels = sample.scan.codes.taxels.unwrap();
    std::array::from_fn(|c| (f64::from(taxels.lit[0][c].0) - f64::from(taxels.dark[c].0)) / 65535.0)
}

/// Table of one row a press: mean light over the 80 ms hold, position and angle.
fn presses(scene: &str, seed: u64) -> (usize, TableRecording) {
    let samples: Vec<Sample> = Simulator::new(&Scene::load(scene).unwrap(), seed).collect();
    let mean = |rows: &[Sample]| -> [f64; 4] {
        let sums =
            rows.iter().map(light).fold([0.0; 4], |sum, c| std::array::from_fn(|k| sum[k] + c[k]));
        sums.map(|sum| sum / rows.len() as f64)
    };
    let unloaded = mean(&samples[..250]);
    let mut text = String::from("c0,c1,c2,c3,p_mm,theta_deg\n");
    let touches = |s: &Sample| s.truth.contact == Some(true);
    let mut count = 0;
    for press in samples.chunk_by(|a, b| touches(a) == touches(b)).filter(|run| touches(&run[0])) {
        let fz = |s: &Sample| s.truth.force[2].unwrap();
        let most = press.iter().map(fz).fold(0.0, f64::max);
        let held: Vec<Sample> = press.iter().filter(|s| fz(s) > 0.999 * most).copied().collect();
        let c = mean(&held);
        let place = held[0].truth.point[0].unwrap();
        let angle = most.atan2(held[0].truth.force[0].unwrap()).to_degrees();
        for (c, unloaded) in c.iter().zip(unloaded) {
            write!(text, "{:.7},", c - unloaded).unwrap();
        }
        writeln!(text, "{place:.4},{angle:.4}").unwrap();
        count += 1;
    }
    let stretch = scene.parse().unwrap();
    let read = |columns: &[&str]| read_from(text.as_bytes(), &stretch, columns).unwrap();
    (count, TableRecording { inputs: read(&["c*"]), targets: read(&["p_mm", "theta_deg"]) })
}

/// Trials lie half-way between the positions and angles of the data set.
///
/// [DeMaria2011] reports 0.3 mm and 10°.
#[test]
fn line_of_four_errs_below_0_15_mm_and_5_degrees() {
    let ((fitted, data), (tried, trials)) = (presses("line-fit", 1), presses("line-trial", 2));
    assert_eq!((fitted, tried), (7 * 13, 6 * 12));
    let options = TableOptions { family: Family::Auto, ..TableOptions::default() };
    let stop = AtomicBool::new(false);
    let model = fit(&[data], &options, &mut |_| {}, &stop).unwrap().model;
    let judged = evaluate(&model, &trials).unwrap().targets;
    let [place, angle] = [0, 1].map(|k| judged[k].figures.unwrap().max);
    println!("{}: {place} mm, {angle} degrees", model.shape());
    assert!(place < 0.15 && angle < 5.0, "{place} mm, {angle} degrees");
}
