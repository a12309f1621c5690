//! Tests with faulty recordings of a finger: a warning or an error for each.

use std::sync::atomic::AtomicBool;

use taxel_calibrate::evaluate;
use taxel_calibrate::finger::{FitOptions, Fitted, Subject, fit};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::{Sample, Truth};
use taxel_regress::FitError;
use taxel_regress::network::NetOptions;
use taxel_sim::{Scene, Simulator};

use crate::judge::{FRICTION, presses, run};

/// Records `count` presses all over the pad, five a second.
fn recording(name: &str, seed: u64, count: u32) -> Recording {
    let seconds = 1.2 + 0.2 * f64::from(count);
    let samples = run(5, seed, 250, seconds, FRICTION, &presses(count, [0.0, 0.0], 0.0));
    // Without contact points and force sensors the net alone is fitted.
    let samples = samples.into_iter().map(|mut sample| {
        sample.scan.codes.bridges = [None; 4];
        let truth = Truth { point: [None; 2], sensors: [[None; 3]; 4], ..sample.truth };
        Sample { truth, ..sample }
    });
    Recording { name: name.into(), samples: samples.collect() }
}

fn fitted(recordings: &[Recording], hidden: usize) -> Result<Fitted, FitError> {
    let net = NetOptions { seed: 0, starts: 1, steps: 60 };
    let options =
        FitOptions { subject: Subject::Finger, net, hidden: Some(hidden), ..FitOptions::default() };
    fit(recordings, &options, &mut |_| {}, &AtomicBool::new(false))
}

/// RMS error of f_z in newtons on a recording without faults.
fn error_of(fitted: &Fitted) -> f64 {
    let found = evaluate::finger(&fitted.calibration, &recording("unseen", 9, 55));
    found.iter().find(|m| m.target == "fz_n").and_then(|m| m.figures).unwrap().rmse
}

#[test]
fn flipped_force_is_refused_by_recording_and_column() {
    let sheared = |name: &str, seed: u64| {
        let samples = Simulator::new(&Scene::load("shear").unwrap(), seed).take(20_000).step_by(2);
        Recording { name: name.into(), samples: samples.collect() }
    };
    let turned = |axes: &[usize]| {
        let mut recording = sheared("turned.csv", 2);
        for sample in &mut recording.samples {
            axes.iter().for_each(|k| sample.truth.force[*k] = sample.truth.force[*k].map(|f| -f));
        }
        recording
    };
    let others = || [sheared("one.csv", 1), sheared("two.csv", 3)];
    for (axes, said) in [
        (&[0, 1][..], "turned.csv: fx_n, fy_n have the opposite sign of the other recordings"),
        (&[1], "turned.csv: fy_n has the opposite sign of the other recordings"),
        (&[2], "turned.csv: fz_n is negative where something presses"),
    ] {
        let [one, two] = others();
        let error = fitted(&[one, turned(axes), two], 4).unwrap_err().to_string();
        assert!(error.starts_with(said), "{axes:?}: {error}");
    }
    let [one, _] = others();
    let error = fitted(&[one, turned(&[0])], 4).unwrap_err().to_string();
    assert!(error.starts_with("turned.csv: fx_n has the opposite sign of one.csv"), "{error}");
}

#[test]
fn a_time_base_that_is_off_is_put_right_and_told() {
    let good = recording("good.csv", 1, 55);
    let clean = fitted(std::slice::from_ref(&good), 4).unwrap();
    assert_eq!(clean.warnings, Vec::<String>::new());
    let force = |at: f64| -> Option<[Option<f64>; 3]> {
        let [a, b] = [0, 1].map(|next| good.samples.get(at as usize + next).map(|s| s.truth.force));
        let (a, b) = (a?, b?);
        Some([0, 1, 2].map(|k| Some(a[k]? + at.fract() * (b[k]? - a[k]?))))
    };
    let off = good.samples.iter().enumerate().map_while(|(i, sample)| {
        let truth = Truth { force: force(1.03 * i as f64)?, contact: None, ..sample.truth };
        Some(Sample { truth, ..*sample })
    });
    let off = Recording { name: "off.csv".into(), samples: off.collect() };
    let put_right = fitted(&[off], 4).unwrap();
    let said = &put_right.warnings[0];
    assert!(said.starts_with("off.csv: the reference fits far better"), "{said}");
    assert!(said.contains("at a rate -2.9"), "{said}");
    let [clean, put_right] = [clean, put_right].map(|fitted| error_of(&fitted));
    assert!(put_right < 1.3 * clean, "{put_right} N, {clean} N without");
}

#[test]
fn wrong_runs_are_warned_of_or_refused() {
    let good = recording("good.csv", 1, 55);
    let rows = good.samples.len();
    let loose = |wrong: &dyn Fn(usize) -> bool| {
        let mut loose = Recording { name: "loose.csv".into(), ..good.clone() };
        for (i, sample) in loose.samples.iter_mut().enumerate().filter(|(i, _)| wrong(*i)) {
            let taxels = sample.scan.codes.taxels.as_mut().unwrap();
            if i % 500 < 250 {
                sample.truth.force[2] = Some(9.0);
            } else {
                taxels.lit[1][1].0 = 60_000;
            }
        }
        loose
    };
    let told = fitted(&[loose(&|i| i % 500 > 480 || i > rows - 40 || i % 500 == 77)], 4).unwrap();
    let said = &told.warnings[0];
    assert!(said.starts_with("loose.csv: ") && said.contains("stand far out"), "{said}");
    let [clean, told] =
        [fitted(std::slice::from_ref(&good), 4).unwrap(), told].map(|fitted| error_of(&fitted));
    assert!(told < 1.3 * clean, "{told} N, {clean} N without");

    let error = fitted(&[loose(&|i| i % 4 == 1)], 4).unwrap_err().to_string();
    assert!(error.starts_with("loose.csv: ") && error.contains("more than can be left"), "{error}");
}

#[test]
fn detached_load_cell_rows_are_left_out_with_warning() {
    let good = recording("good.csv", 1, 55);
    // Five presses a second, from 1 s on: the cell is missing from one rest to another.
    let dead = |share: f64| {
        let mut dead = Recording { name: "dead.csv".into(), ..good.clone() };
        let from = 1000;
        let until = from + 50 * (share * 55.0) as usize;
        dead.samples[from..until].iter_mut().for_each(|s| s.truth.force = [Some(0.0); 3]);
        dead
    };
    let told = fitted(&[dead(0.15)], 4).unwrap();
    let said = &told.warnings[0];
    assert!(said.starts_with("dead.csv: in ") && said.contains("stays at zero while"), "{said}");
    let [clean, told] =
        [fitted(std::slice::from_ref(&good), 4).unwrap(), told].map(|fitted| error_of(&fitted));
    assert!(told < 1.3 * clean, "{told} N, {clean} N without");
    let error = fitted(&[dead(0.4)], 4).unwrap_err().to_string();
    assert!(
        error.starts_with("dead.csv: in ") && error.contains("more than can be left"),
        "{error}"
    );
}
