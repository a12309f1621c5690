//! Tests with faulty recordings: each is fitted with a warning, or refused with a reason.

use std::fmt::Write as _;
use std::sync::atomic::AtomicBool;

use taxel_files::table::read_from;
use taxel_papers::feeler::{BrightSpot, Shear};
use taxel_regress::FitError;
use taxel_regress::align::Alignment;
use taxel_regress::model::Family;
use taxel_regress::table::{FittedTable, TableOptions, TableRecording, evaluate, fit};

/// Presses of uneven length and height, one after the other.
fn load(t: f64) -> f64 {
    let i = (t / 2.5).floor();
    let length = 1.4 + 0.6 * (5.0 * i * i).sin();
    let share = (t - 2.5 * i - 0.2) / length;
    let peak = 6.0 + 4.0 * (7.0 * i).sin();
    if (0.0..1.0).contains(&share) { peak * (std::f64::consts::PI * share).sin() } else { 0.0 }
}

/// One row of a sensor of three channels with its reference.
struct Row {
    t: f64,
    channels: [f64; 3],
    force: f64,
}

/// Builds `rows` rows at 50 Hz from `from`; `spoil` gets each row with its index.
fn recording(
    name: &str,
    rows: usize,
    from: f64,
    spoil: impl Fn(usize, &mut Row),
) -> TableRecording {
    let mut text = String::from("t_s,m0,m1,m2,force_n\n");
    for i in 0..rows {
        let t = from + i as f64 * 0.02;
        let noise = |k: usize| (12.9898 * ((3 * i + k) as f64).powi(2)).sin();
        let f = load(t);
        let channels = [
            90.0 + 30.0 * f + 0.5 * noise(0),
            12.0 * f + 1.2 * f * f + 0.5 * noise(1),
            20.0 * (0.4 * t).sin() + 5.0 * f,
        ];
        let mut row = Row { t, channels, force: f };
        spoil(i, &mut row);
        let [a, b, c] = row.channels;
        writeln!(text, "{:.6},{a},{b},{c},{}", row.t, row.force).unwrap();
    }
    let stretch = name.parse().unwrap();
    TableRecording {
        inputs: read_from(text.as_bytes(), &stretch, &["m*"]).unwrap(),
        targets: read_from(text.as_bytes(), &stretch, &["force_n"]).unwrap(),
    }
}

fn ridge(recordings: &[TableRecording]) -> Result<FittedTable, FitError> {
    fit_to(recordings, Family::Ridge)
}

fn fit_to(recordings: &[TableRecording], family: Family) -> Result<FittedTable, FitError> {
    let options = TableOptions { family, ..TableOptions::default() };
    fit(recordings, &options, &mut |_| {}, &AtomicBool::new(false))
}

fn good(name: &str) -> TableRecording {
    recording(name, 2000, 0.0, |_, _| {})
}

/// Warnings of a fit, except that about too few recordings for whole ones to be left out.
fn told(fitted: &FittedTable) -> Vec<&str> {
    let warnings = fitted.warnings.iter().map(String::as_str);
    warnings.filter(|warning| !warning.contains("not by whole ones left out")).collect()
}

/// RMS error in newtons on a recording without faults.
fn error_of(fitted: &FittedTable) -> f64 {
    let unseen = recording("unseen.csv", 1500, 60.0, |_, _| {});
    evaluate(&fitted.model, &unseen).unwrap().targets[0].figures.unwrap().rmse
}

#[test]
fn sound_recording_is_warned_of_only_if_alone() {
    let fitted = ridge(&[good("good.csv")]).unwrap();
    let [alone] = &fitted.warnings[..] else { panic!("{:?}", fitted.warnings) };
    assert!(alone.starts_with("ridge: chosen by stretches of the recordings"), "{alone}");
    let three = [("one.csv", 0.0), ("two.csv", 30.0), ("three.csv", 50.0)]
        .map(|(name, from)| recording(name, 2000, from, |_, _| {}));
    assert_eq!(ridge(&three).unwrap().warnings, Vec::<String>::new());
    assert!(error_of(&fitted) < 0.15, "{}", error_of(&fitted));
}

#[test]
fn collinear_channels_are_named_and_share_weight() {
    let collinear = recording("collinear.csv", 2000, 0.0, |_, row| {
        row.channels[2] = 0.25 * row.channels[0] + 7.0;
    });
    let fitted = ridge(&[collinear]).unwrap();
    assert!(fitted.warnings[0].starts_with("m0, m2: together"), "{:?}", fitted.warnings);
    // A duplicate channel with its own weight would get the opposite sign.
    let [a, _, c] = *fitted.model.skip.as_slice() else { panic!("{:?}", fitted.model) };
    assert!(a * c > 0.0 && a.abs() < 0.1, "{:?}", fitted.model.skip);
    assert!(f64::from(fitted.model.residual[0]) < 0.15);
}

#[test]
fn near_duplicates_are_warned_of_without_decay() {
    let twins = recording("twins.csv", 2000, 0.0, |_, row| {
        row.channels[2] = 0.25 * row.channels[0] + 0.1 * row.channels[2];
    });
    let twins = std::slice::from_ref(&twins);
    let bare = fit_to(twins, Family::LeastSquares).unwrap();
    assert!(bare.condition.is_some_and(|c| (30.0..1e4).contains(&c)), "{:?}", bare.condition);
    assert!(bare.warnings[0].contains("without a decay"), "{:?}", bare.warnings);
    assert_eq!(told(&ridge(twins).unwrap()), Vec::<&str>::new());
    assert!(fit_to(&[good("good.csv")], Family::LeastSquares).unwrap().warnings.is_empty());

    let same = recording("same.csv", 2000, 0.0, |_, row| {
        row.channels[2] = 0.25 * row.channels[0] + 1e-7 * row.channels[2];
    });
    let bare = fit_to(std::slice::from_ref(&same), Family::LeastSquares).unwrap();
    let said = &bare.warnings[0];
    assert!(said.starts_with("m0, m2: together") && said.contains("without a decay"), "{said}");
    let shared = &ridge(&[same]).unwrap().warnings[0];
    assert!(shared.starts_with("m0, m2: together") && shared.contains("by the decay"), "{shared}");
}

#[test]
fn constant_channel_is_named_and_ignored() {
    let constant = recording("constant.csv", 2000, 0.0, |_, row| row.channels[2] = 3.5);
    let fitted = ridge(&[constant]).unwrap();
    assert!(fitted.warnings[0].starts_with("m2: the same value"), "{:?}", fitted.warnings);
    assert_eq!(fitted.model.skip[2], 0.0);
    assert!(error_of(&fitted) < 0.15);
}

#[test]
fn targets_in_sensor_file_are_not_inputs() {
    let TableRecording { mut inputs, targets } = good("good.csv");
    inputs.names.push("force_n".into());
    inputs.rows.iter_mut().zip(&targets.rows).for_each(|(row, target)| row.push(target[0]));
    let (found, _) = TableRecording::aligned(inputs.clone(), targets.clone()).unwrap();
    assert_eq!(found.inputs.names, ["m0", "m1", "m2"]);
    inputs.keep(|name| name == "force_n");
    let error = TableRecording::aligned(inputs, targets).unwrap_err().to_string();
    assert!(error.starts_with("good.csv: only targets and the time match"), "{error}");
}

#[test]
fn twelve_rows_are_too_few() {
    let error = ridge(&[recording("few.csv", 12, 0.0, |_, _| {})]).unwrap_err().to_string();
    let few = "few.csv: ridge: 12 usable rows where at least 16 are needed; record for longer";
    assert_eq!(error, few);
}

#[test]
fn five_percent_outliers_are_counted_without_effect() {
    let clean = error_of(&ridge(&[good("good.csv")]).unwrap());
    let loose = recording("loose.csv", 2000, 0.0, |i, row| match i % 40 {
        7 => row.force = 60.0,
        29 => row.channels[1] = -900.0,
        _ => {}
    });
    let fitted = ridge(&[loose]).unwrap();
    assert!(
        fitted.warnings[0].starts_with("loose.csv: 100 of 2000 rows (5 %) stand far out"),
        "{:?}",
        fitted.warnings
    );
    assert!(error_of(&fitted) < 1.1 * clean, "{} {clean}", error_of(&fitted));
}

#[test]
fn wrong_run_in_short_recording_is_left_out() {
    for rows in [100, 150] {
        let clean = error_of(&ridge(&[recording("short.csv", rows, 0.0, |_, _| {})]).unwrap());
        let hangs = recording("short.csv", rows, 0.0, |i, row| {
            if (70..80).contains(&i) {
                row.force = 40.0;
            }
        });
        let fitted = ridge(&[hangs]).unwrap();
        let said =
            format!("short.csv: 10 of {rows} rows ({:.0} %) stand far out", 1e3 / rows as f64);
        let told = fitted.warnings.iter().any(|w| w.starts_with(&said));
        assert!(told && fitted.left_out == 10, "{said}: {:?}", fitted.warnings);
        assert!(error_of(&fitted) < 1.5 * clean, "{rows}: {} {clean}", error_of(&fitted));
    }
}

#[test]
fn wrong_runs_and_ends_are_warned_of_without_effect() {
    let clean = error_of(&ridge(&[good("good.csv")]).unwrap());
    let hangs = |i: usize| (600..640).contains(&i) || !(20..1980).contains(&i);
    let loose = recording("loose.csv", 2000, 0.0, |i, row| match i {
        i if hangs(i) => row.force = 40.0,
        1300..1330 => row.channels[1] = -900.0,
        _ => {}
    });
    let fitted = ridge(&[good("good.csv"), loose]).unwrap();
    let said = &fitted.warnings[0];
    assert!(said.starts_with("loose.csv: 110 of 2000 rows (6 %) stand far out"), "{said}");
    assert!(error_of(&fitted) < 1.1 * clean, "{} {clean}", error_of(&fitted));
    assert!(f64::from(fitted.model.residual[0]) < 1.1 * clean, "{:?}", fitted.model.residual);
}

#[test]
fn fifteen_percent_outliers_pass_and_over_20_fail() {
    let clean = error_of(&ridge(&[good("good.csv")]).unwrap());
    let loose = |every: usize, of: usize| {
        recording("loose.csv", 2000, 0.0, move |i, row| {
            if (7 * i) % every < of {
                row.force = 40.0;
            }
        })
    };
    let fitted = ridge(&[loose(20, 3)]).unwrap();
    assert!(fitted.warnings[0].contains("(15 %) stand far out"), "{:?}", fitted.warnings);
    assert!(error_of(&fitted) < 1.1 * clean, "{} {clean}", error_of(&fitted));
    let error = ridge(&[good("good.csv"), loose(4, 1)]).unwrap_err().to_string();
    assert!(error.starts_with("loose.csv: ") && error.contains("more than can be left"), "{error}");
}

#[test]
fn stuck_reference_is_left_out_or_refused() {
    let clean = error_of(&ridge(&[good("good.csv")]).unwrap());
    // The reference drops to zero between two presses and returns between two others, without a
    // jump.
    let dead = |rows: std::ops::Range<usize>| {
        recording("dead.csv", 2000, 0.0, move |i, row| {
            if rows.contains(&i) {
                row.force = 0.0;
            }
        })
    };
    let fitted = ridge(&[dead(500..875)]).unwrap();
    let said = &fitted.warnings[0];
    // All rows of the three presses except those with almost no load.
    let pressed = (500..875).filter(|i| load(0.02 * f64::from(*i)) > 0.1).count();
    let found = format!("dead.csv: in {pressed} of 2000 rows (7 %) the reference stays at zero");
    assert!(said.starts_with(&found), "{said}, {found}");
    assert!(error_of(&fitted) < 1.1 * clean, "{} {clean}", error_of(&fitted));
    let error = ridge(&[good("good.csv"), dead(500..1500)]).unwrap_err().to_string();
    assert!(
        error.starts_with("dead.csv: in ") && error.contains("more than can be left"),
        "{error}"
    );
}

#[test]
fn flipped_reference_is_refused_by_name() {
    let turned = recording("turned.csv", 2000, 40.0, |_, row| row.force = -row.force);
    let other = recording("other.csv", 2000, 80.0, |_, _| {});
    let said = |recordings: &[TableRecording]| ridge(recordings).unwrap_err().to_string();
    let error = said(&[good("good.csv"), turned.clone(), other]);
    assert!(error.starts_with("turned.csv: force_n has the opposite sign of the other"), "{error}");
    // If two recordings disagree, the one that pulls is flipped.
    for pair in [[good("good.csv"), turned.clone()], [turned.clone(), good("good.csv")]] {
        let error = said(&pair);
        assert!(
            error.starts_with("turned.csv: force_n has the opposite sign of good.csv"),
            "{error}"
        );
    }
    let alone = ridge(&[turned]).unwrap();
    assert!(
        alone.warnings[0].starts_with("turned.csv: force_n: always negative"),
        "{:?}",
        alone.warnings
    );
}

#[test]
fn wrong_time_base_is_corrected_with_warning() {
    let clean = error_of(&ridge(&[good("good.csv")]).unwrap());
    let off = |rate: f64| {
        recording("off.csv", 2000, 0.0, move |_, row| row.force = load(row.t * (1.0 + rate)))
    };
    for (rate, told) in [(0.03, "-2.91 %"), (-0.03, "+3.09 %")] {
        let fitted = ridge(&[off(rate)]).unwrap();
        let said = &fitted.warnings[0];
        assert!(said.contains("off.csv: the reference fits far better"), "{said}");
        assert!(said.contains(told) && said.contains("--reference"), "{said}");
        assert!(error_of(&fitted) < 1.1 * clean, "{rate}: {} {clean}", error_of(&fitted));
    }

    // The misaligned reference again, with the times of its own clock.
    let mut reference = off(0.03).targets;
    reference.rows = reference.times.iter().map(|t| vec![load(*t)]).collect();
    reference.times.iter_mut().for_each(|t| *t = 700.0 + 1.03 * *t);
    let (aligned, found) = TableRecording::aligned(good("good.csv").inputs, reference).unwrap();
    let Alignment { offset, rate, residual, .. } = found;
    assert!((offset - 700.0).abs() < 2e-3 && (rate - 0.03).abs() < 1e-4, "{found:?}");
    assert!(residual < 2e-3, "{found:?}");
    let fitted = ridge(&[aligned]).unwrap();
    assert_eq!(told(&fitted), Vec::<&str>::new());
    assert!(error_of(&fitted) < 0.15);
}

#[test]
fn table_without_times_warns_of_unchecked_reference() {
    let mut timeless = good("timeless.csv");
    timeless.inputs.times.clear();
    timeless.targets.times.clear();
    let fitted = ridge(&[good("good.csv"), timeless]).unwrap();
    let [said] = told(&fitted)[..] else { panic!("{:?}", fitted.warnings) };
    assert!(said.starts_with("timeless.csv: no time column (t_s or t_us)"), "{said}");
}

#[test]
fn rounded_times_are_checked_and_stuck_times_warned() {
    let rounded = |rate: f64| {
        recording("rounded.csv", 2000, 0.0, move |_, row| {
            row.force = load(row.t * (1.0 + rate));
            row.t = (10.0 * row.t).floor() / 10.0;
        })
    };
    let clean = ridge(&[rounded(0.0)]).unwrap();
    assert_eq!(told(&clean), Vec::<&str>::new());
    let fitted = ridge(&[rounded(0.03)]).unwrap();
    let said = &fitted.warnings[0];
    assert!(said.contains("rounded.csv: the reference fits far better"), "{said}");
    assert!(error_of(&fitted) < 1.2 * error_of(&clean), "{}", error_of(&fitted));

    let hangs = recording("hangs.csv", 2000, 0.0, |_, row| row.t = row.t.min(20.0));
    let fitted = ridge(&[hangs]).unwrap();
    let [said] = told(&fitted)[..] else { panic!("{:?}", fitted.warnings) };
    assert!(
        said.starts_with("hangs.csv: 1000 rows have one time, 20 s, so that it was not"),
        "{said}"
    );
}

#[test]
fn number_beyond_f32_is_refused_by_position() {
    let text = "t_s,m0,force_n\n0,1,2\n1,1e300,2\n";
    let error = read_from(text.as_bytes(), &"huge.csv".parse().unwrap(), &["m*"]).unwrap_err();
    let error = error.to_string();
    assert!(error.starts_with("huge.csv:3: `m0`: expected a number up to 1e12, found"), "{error}");
}

/// A feeler of [Ohka2005] that sticks and slips by turns; `spoil` gets every row.
fn feeler(spoil: impl Fn(usize, &mut [f32; 3])) -> TableRecording {
    let shear = Shear { stuck: 1.7, sheet: 0.067, friction: 0.25, adhesion: 0.56 };
    let spot = BrightSpot { normal: 0.03, x: shear, y: shear };
    let mut text = String::from("t_s,G,ux,uy,fx_n,fy_n,fz_n\n");
    for i in 0..900 {
        let t = i as f32;
        let (g, [ux, uy]) =
            (150.0 + 60.0 * (0.035 * t).sin(), [3.0 * (0.0933 * t).sin(), 3.0 * (0.091 * t).cos()]);
        let mut force = spot.force(g, [ux, uy]);
        spoil(i, &mut force);
        let [fx, fy, fz] = force;
        writeln!(text, "{:.2},{g},{ux},{uy},{fx},{fy},{fz}", 0.01 * t).unwrap();
    }
    let stretch = "feeler.csv".parse().unwrap();
    TableRecording {
        inputs: read_from(text.as_bytes(), &stretch, &["G", "u*"]).unwrap(),
        targets: read_from(text.as_bytes(), &stretch, &["f*"]).unwrap(),
    }
}

#[test]
fn outliers_are_judged_by_the_fitted_law() {
    let clean = fit_to(&[feeler(|_, _| {})], Family::Feeler).unwrap();
    assert_eq!(clean.warnings, Vec::<String>::new());
    let loose = feeler(|i, force| {
        if i % 45 == 20 {
            force[0] += 4.0;
        }
    });
    let fitted = fit_to(&[loose], Family::Feeler).unwrap();
    assert!(
        fitted.warnings[0].starts_with("feeler.csv: 20 of 900 rows (2 %) stand far"),
        "{:?}",
        fitted.warnings
    );
    let unseen = evaluate(&fitted.model, &feeler(|_, _| {})).unwrap();
    let off = unseen.targets[0].figures.unwrap().rmse;
    assert!(off < 0.01, "{off}");
}
