//! Tests of a report's warnings: sound recordings give none, and each defect gives its own.
//!
//! Page and JSON show the same warnings.

use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel_calibrate::recording::Recording;
use taxel_calibrate::report::{self, Report, html};
use taxel_files::table::Table;
use taxel_files::trace::Sample;
use taxel_regress::model::Family;
use taxel_regress::network::NetOptions;
use taxel_regress::table::{self, TableModel, TableOptions, TableRecording};
use taxel_sim::{Scene, Simulator};

/// Warnings of a report, checked to be the same on the page and in the JSON.
fn warnings(report: &Report) -> Vec<String> {
    let page = html::page(report, "today", "yesterday");
    let json = serde_json::to_value(report).unwrap();
    assert_eq!(json["warnings"], serde_json::json!(report.warnings));
    for warning in &report.warnings {
        assert!(page.contains(&format!("<li>{warning}</li>")), "{warning}");
    }
    report.warnings.clone()
}

fn assert_begin(found: &[String], wanted: &[&str]) {
    let same = found.len() == wanted.len()
        && found.iter().zip(wanted).all(|(found, wanted)| found.starts_with(wanted));
    assert!(same, "{found:#?}\nwhere these are wanted: {wanted:#?}");
}

/// Presses all over the pad, sheared in every direction.
fn finger(seed: u64) -> Recording {
    let text = "effects = ['noise']\n[scan]\nrate_hz = 200\nduration_s = 40\n[indenter]\nradius_mm = 6\n\
                [friction]\nmu = 1\n[[random]]\nat_s = 1\npresses = 190\neach_s = 0.2\nx_mm = [-4, 4]\n\
                y_mm = [-4, 4]\nfz_n = [0.2, 2]\nshear_of_limit = [0.2, 0.9]\n";
    let scene = Scene::parse("warnings.toml", text).unwrap();
    Recording { name: format!("{seed}.csv"), samples: Simulator::new(&scene, seed).collect() }
}

/// Reads the virtual finger's calibration of net and sensors.
fn calibration() -> Calibration {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");
    taxel_files::calibration::read(path).unwrap()
}

/// Judges the virtual finger's calibration without a break.
fn judge(judged: &[Recording], fitted: &[Recording], hidden: &[bool]) -> Report {
    judge_record(&calibration(), judged, fitted, hidden)
}

fn judge_record(
    calibration: &Calibration,
    judged: &[Recording],
    fitted: &[Recording],
    hidden: &[bool],
) -> Report {
    let go_on = AtomicBool::new(false);
    report::judge(calibration, judged, fitted, hidden, &mut |_| {}, &go_on).unwrap()
}

/// Warnings on one judged and three fitted recordings with every row spoiled.
fn of_finger(spoil: fn(&mut Sample)) -> Vec<String> {
    let spoiled = |seed| {
        let mut recording = finger(seed);
        recording.samples.iter_mut().for_each(spoil);
        recording
    };
    let fitted = [1, 2, 3].map(spoiled);
    warnings(&judge(&[spoiled(4)], &fitted, &[]))
}

#[test]
fn full_coverage_of_finger_raises_no_warning() {
    assert_begin(&of_finger(|_| {}), &[]);
}

#[test]
fn missing_or_one_sided_shear_is_warned_of() {
    let found = of_finger(|sample| sample.truth.force[0] = Some(0.0));
    assert_begin(&found, &["no shear in x (less than 1 % of the normal force): fx is a guess"]);
    let found = of_finger(|sample| {
        sample.truth.force[1] = sample.truth.force[1].map(f64::abs);
    });
    assert_begin(&found, &["fy goes one way only (0.00 … "]);
}

#[test]
fn duplicate_taxel_and_constant_sensor_are_named() {
    let found = of_finger(|sample| {
        let taxels = sample.scan.codes.taxels.as_mut().unwrap();
        taxels.lit[2][1] = taxels.lit[1][1];
    });
    assert_begin(&found, &["r2c1 duplicates r1c1 (correlation 1.0000"]);
    let found = of_finger(|sample| {
        let still = sample.scan.codes.bridges[1].as_mut().unwrap();
        (still.a.0, still.b.0, still.c.0, still.d.0) = (40_000, 30_000, 35_000, 31_000);
    });
    let still =
        ["u_x of s1", "u_y of s1", "u_z of s1"].map(|u| format!("{u} never changes: is it"));
    assert_begin(&found, &still.each_ref().map(String::as_str));
}

#[test]
fn few_unknown_or_judged_recordings_raise_warnings() {
    let all = [1, 2, 3, 4].map(finger);
    let of =
        |judged: usize, fitted: &[Recording]| warnings(&judge(&all[judged..=judged], fitted, &[]));
    assert_begin(&of(3, &all[..2]), &["fitted to 2 recordings: with 3 or more"]);
    assert_begin(&of(3, &[]), &["the recordings that the calibration was fitted to were not"]);
    assert_begin(&of(1, &all[..3]), &["2.csv: the calibration was fitted to these rows"]);
    // A copy has another name, and may have another reference.
    let mut copy = Recording { name: "copy.csv".into(), ..all[1].clone() };
    copy.samples.iter_mut().for_each(|sample| {
        sample.truth.force[2] = sample.truth.force[2].map(|force| 1.01 * force);
    });
    let copied = judge(&[copy], &all[..3], &[]);
    assert_begin(&warnings(&copied), &["copy.csv: the calibration was fitted to these rows"]);
    let doubts = |fitted: &[Recording]| judge(&all[3..], fitted, &[]).verdict.doubts;
    assert_begin(&doubts(&[]), &["not known whether these rows were fitted to"]);
    assert_begin(&doubts(&all[..3]), &[]);
}

#[test]
fn share_of_loads_beyond_the_fit_is_warned_of() {
    let mut beyond = finger(4);
    for sample in &mut beyond.samples {
        sample.truth.force = sample.truth.force.map(|force| Some(3.0 * force?));
    }
    let fitted = [1, 2, 3].map(finger);
    let found = warnings(&judge(&[beyond], &fitted, &[]));
    let told = |y: &str| {
        let end = format!("% of the judged rows lie where nothing was fitted to ({y} over fx_n):");
        found.iter().any(|warning| warning.contains(&end))
    };
    assert!(told("fy_n") && told("fz_n") && found.len() == 2, "{found:#?}");
}

#[test]
fn channels_name_faults_and_unused_columns() {
    let mut judged = finger(4);
    for sample in judged.samples.iter_mut().step_by(4) {
        let taxels = sample.scan.codes.taxels.as_mut().unwrap();
        taxels.lit[2][1] = taxels.dark[1];
    }
    let mut calibration = calibration();
    calibration.sensors[3] = None;
    let report = judge_record(&calibration, &[judged], &[], &[]);
    let of = |begins: &str| {
        let channel = report.channels.iter().find(|channel| channel.columns.starts_with(begins));
        channel.unwrap_or_else(|| panic!("{begins}: {:?}", report.channels))
    };
    let matrix = of("lit_*, dark_*");
    assert!(matrix.used.contains(&"net".to_owned()), "{matrix:?}");
    assert_eq!(matrix.why, "r2c1 dark or clipped, at fault in 25.0 % of the rows");
    assert_eq!(of("bridge_s0_*").why, "");
    assert_eq!(of("bridge_s3_*").why, "the record has no matrix for it");
    assert!(of("torsion_nmm").used.is_empty() && !of("fx_n").used.is_empty());
}

/// Table of a generic sensor: three channels, two forces that go both ways and one that presses.
fn table(phase: f64, spoil: fn(&mut [f64], &mut [f64])) -> TableRecording {
    let (mut inputs, mut targets) = (Vec::new(), Vec::new());
    for i in 0..1500 {
        let t = 0.1 * f64::from(i) + phase;
        let (fx, fy, fz) = ((0.9 * t).sin(), (1.3 * t).cos(), 2.0 + (0.31 * t).sin());
        let mut m = [3.0 * fx + 0.2 * fz, 2.0 * fy - 0.1 * fx, fz + 0.3 * fy];
        let mut y = [fx, fy, fz];
        spoil(&mut m, &mut y);
        inputs.push(m.to_vec());
        targets.push(y.to_vec());
    }
    let part = |names: [&str; 3], rows| Table {
        path: format!("{phase}.csv").into(),
        names: names.map(str::to_owned).to_vec(),
        others: Vec::new(),
        rows,
        times: (0..1500).map(|i| 0.1 * f64::from(i)).collect(),
    };
    TableRecording {
        inputs: part(["m0", "m1", "m2"], inputs),
        targets: part(["fx_n", "fy_n", "fz_n"], targets),
    }
}

fn model() -> TableModel {
    let options = TableOptions { family: Family::Ridge, hidden: None, net: NetOptions::default() };
    let recordings = [0.0, 40.0, 80.0].map(|phase| table(phase, |_, _| {}));
    table::fit(&recordings, &options, &mut |_| {}, &AtomicBool::new(false)).unwrap().model
}

fn of_table(spoil: fn(&mut [f64], &mut [f64])) -> Vec<String> {
    let fitted = [0.0, 40.0, 80.0].map(|phase| table(phase, spoil));
    warnings(&taxel_calibrate::report::table::judge(&model(), &[table(120.0, spoil)], &fitted))
}

#[test]
fn full_coverage_of_table_raises_no_warning() {
    assert_begin(&of_table(|_, _| {}), &[]);
}

#[test]
fn table_shear_and_channel_faults_raise_warnings() {
    let found = of_table(|_, y| y[1] = 0.0);
    assert_begin(&found, &["no shear in y"]);
    let found = of_table(|_, y| y[0] = -y[0].abs());
    assert_begin(&found, &["fx goes one way only (-1.00 … "]);
    let found = of_table(|m, _| m[1] = m[0] / 2.0);
    assert_begin(&found, &["m1 duplicates m0 (correlation 1.00000)"]);
    // The mean of this value over the rows is rounded.
    let found = of_table(|m, _| m[2] = 2.1);
    assert_begin(&found, &["m2 never changes: is it connected?"]);
}

#[test]
fn few_unknown_or_judged_tables_raise_warnings() {
    let all = [0.0, 40.0, 80.0, 120.0].map(|phase| table(phase, |_, _| {}));
    let judge = |judged: usize, fitted: &[TableRecording]| {
        warnings(&taxel_calibrate::report::table::judge(&model(), &all[judged..=judged], fitted))
    };
    assert_begin(&judge(3, &all[..1]), &["fitted to 1 recording: with 3 or more"]);
    assert_begin(&judge(3, &[]), &["the recordings that the calibration was fitted to were not"]);
    assert_begin(&judge(0, &all[..3]), &["0.csv: the calibration was fitted to these rows"]);
    let mut copy = all[0].clone();
    copy.inputs.path = "copy.csv".into();
    let copied = taxel_calibrate::report::table::judge(&model(), &[copy], &all[..3]);
    assert_begin(&warnings(&copied), &["copy.csv: the calibration was fitted to these rows"]);
}

#[test]
fn table_rows_beyond_training_are_counted() {
    let fitted = [0.0, 40.0, 80.0].map(|phase| table(phase, |_, _| {}));
    let judged = table(120.0, |m, y| {
        m.iter_mut().for_each(|m| *m *= 3.0);
        y.iter_mut().for_each(|y| *y *= 3.0);
    });
    let found = warnings(&taxel_calibrate::report::table::judge(&model(), &[judged], &fitted));
    let inputs = |warning: &String| {
        warning.starts_with("120.csv: ")
            && warning.ends_with(" of 1500 rows have inputs beyond the trained range")
    };
    assert!(inputs(&found[0]), "{found:#?}");
    assert!(found[1..].iter().all(|w| w.contains("nothing was fitted to")), "{found:#?}");
    assert!(found.iter().any(|w| w.contains("(inputs, second direction over")), "{found:#?}");
}

/// Labels with the clock of a load cell, whose offset hides the finger's lag.
#[test]
fn short_presses_behind_a_hidden_lag_are_not_judged() {
    let judged = [finger(4)];
    let by = |hidden: &[bool]| judge(&judged, &[finger(1)], hidden);
    let forces = |report: &Report| -> Vec<Option<bool>> {
        let needs = report.verdict.needs.iter();
        needs.filter(|need| need.quantity == "normal force").map(|need| need.met).collect()
    };
    assert!(!forces(&by(&[false])).contains(&None));
    let hidden = by(&[true]);
    assert_eq!(forces(&hidden), [None; 3], "{:?}", hidden.verdict);
    let changing = "changing forces: a clock offset may hide a lag";
    assert_eq!(hidden.verdict.not_judged[0], changing);
    // Contact points have the clock of the frames.
    let points = |report: &Report| report.errors.iter().any(|map| map.unit == "mm");
    assert!(points(&hidden));
}
