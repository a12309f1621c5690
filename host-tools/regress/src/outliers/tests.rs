//! Tests of outlier detection: sound recordings lose nothing, others little more than their wrong
//! rows.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::condition::{Bias, BiasTaker, Levels, Signals};
use taxel_files::trace::Sample;
use taxel_sim::{Scene, Simulator};

use super::*;

/// Standard deviations that the signals of a row exceed to serve a fit.
const GATE: f32 = 5.0;

/// Unloaded rows at the beginning of a built-in scene.
const UNLOADED: usize = 256;

/// Simulates a built-in scene and returns its samples, bias and signals.
fn scene_signals(scene: &str) -> (Vec<Sample>, Bias, Vec<Signals>) {
    let samples: Vec<Sample> = Simulator::new(&Scene::load(scene).unwrap(), 1).collect();
    let levels = || samples.iter().map(|sample| Levels::read(&sample.scan.codes));
    let mut taker = BiasTaker::new(UNLOADED as u16);
    let mut taken = levels().take(UNLOADED).filter_map(|l| taker.add(&l, &Bias::default()));
    let bias = taken.next().unwrap().unwrap().bias;
    let signals = levels().map(|levels| bias.apply(&levels, None)).collect();
    (samples, bias, signals)
}

/// Loaded rows of a built-in scene, as used to fit a net.
fn finger(scene: &str) -> Recorded {
    let (samples, bias, signals) = scene_signals(scene);
    let least = 16.0 * (GATE * bias.taxels.unwrap().noise).powi(2);
    let rows = samples.iter().zip(signals).filter_map(|(sample, signals)| {
        let c = signals.taxels?;
        let force = sample.truth.force.map(Option::unwrap_or_default);
        let loaded = c.iter().map(|c| c * c).sum::<f32>() > least;
        loaded.then(|| (c.map(f64::from).to_vec(), force.to_vec()))
    });
    rows.unzip()
}

/// Loads of one force sensor.
fn bench() -> Recorded {
    let (samples, _, signals) = scene_signals("bench-s0");
    let rows = samples.iter().zip(signals).filter_map(|(sample, signals)| {
        let force = sample.truth.force.map(Option::unwrap_or_default);
        Some((signals.bridges[0]?.map(f64::from).to_vec(), force.to_vec()))
    });
    rows.unzip()
}

/// Keeps every `every`-th row.
fn thinned((x, y): &Recorded, every: usize) -> Recorded {
    let thin = |rows: &[Vec<f64>]| rows.iter().step_by(every).cloned().collect();
    (thin(x), thin(y))
}

fn found(recordings: &[Recorded]) -> Vec<Vec<bool>> {
    let still: Vec<Vec<bool>> = recordings.iter().map(still::wrong).collect();
    wrong(recordings, None, &still)
}

fn count(wrong: &[Vec<bool>]) -> usize {
    wrong.iter().flatten().filter(|wrong| **wrong).count()
}

/// Rows of a generic sensor of three channels at 50 Hz, pressed at uneven intervals.
fn table(rows: usize) -> Recorded {
    let load = |t: f64| {
        let i = (t / 2.5).floor();
        let share = (t - 2.5 * i - 0.2) / (1.4 + 0.6 * (5.0 * i * i).sin());
        let peak = 6.0 + 4.0 * (7.0 * i).sin();
        if (0.0..1.0).contains(&share) { peak * (std::f64::consts::PI * share).sin() } else { 0.0 }
    };
    let row = |i: usize| {
        let t = 0.02 * i as f64;
        let noise = |k: usize| (12.9898 * ((3 * i + k) as f64).powi(2)).sin();
        let f = load(t);
        let channels = vec![
            90.0 + 30.0 * f + 0.5 * noise(0),
            12.0 * f + 1.2 * f * f + 0.5 * noise(1),
            20.0 * (0.4 * t).sin() + 5.0 * f,
        ];
        (channels, vec![f])
    };
    (0..rows).map(row).unzip()
}

#[test]
fn sound_recordings_lose_only_single_outliers() {
    let scenes = ["presses", "shear", "tap", "edge"];
    let each = scenes.map(|scene| (scene, finger(scene)));
    for (name, recorded) in each {
        for every in [1, 3, 8] {
            let thin = thinned(&recorded, every);
            let rows = thin.0.len();
            let thin = [thin];
            let lost = found(&thin);
            // Quick presses have single outliers after thinning; these few rows were always lost.
            let (_, scaled) = scaled(&thin);
            let beside = alone(&thin, &ridge::residual(&scaled, DECAY).unwrap());
            let (count, few) = (count(&lost), count(&beside));
            println!("{name}: {count} for {few} of {rows} rows, every {every}-th");
            assert!(count * 500 <= rows, "{name}: {count} of {rows} rows, every {every}-th");
            assert!(lost == beside, "{name}: {count} for {few} of {rows} rows, every {every}-th");
        }
    }
}

#[test]
fn sound_references_are_never_flagged_as_stuck() {
    let scenes = ["presses", "shear", "tap", "edge", "tour", "grasp", "torsion", "roll"];
    let fingers = scenes.map(|scene| (scene, finger(scene)));
    for (name, sound) in fingers.into_iter().chain([("bench", bench()), ("table", table(3000))]) {
        for every in [1, 4] {
            let found = still::wrong(&thinned(&sound, every));
            let rows = (0..found.len()).filter(|i| found[*i]).collect::<Vec<_>>();
            assert!(rows.is_empty(), "{name}, every {every}-th: {rows:?} of {}", found.len());
        }
    }
}

#[test]
fn stuck_reference_is_found_without_jump() {
    for (name, sound) in [("presses", finger("presses")), ("table", table(3000))] {
        let load: Vec<f64> = sound.1.iter().map(|y| y[y.len() - 1]).collect();
        let most = load.iter().copied().fold(0.0, f64::max);
        for share in [0.06, 0.15, 0.4] {
            // Cut from rest to rest: the nearest unloaded rows about a share of the recording.
            let rest = |from: usize| {
                (from..load.len()).find(|i| load[*i] < 0.06 * most).unwrap_or(load.len())
            };
            let from = rest(load.len() / 3);
            let until = rest(from + (share * load.len() as f64) as usize);
            let mut dead = sound.clone();
            dead.1[from..until].iter_mut().for_each(|y| y.fill(0.0));
            let wrong = still::wrong(&dead);
            let pressed = |i: &usize| load[*i] > 0.15 * most;
            let missed = (from..until).filter(pressed).filter(|i| !wrong[*i]).count();
            let beyond = (0..load.len()).filter(|i| wrong[*i] && !(from..until).contains(i));
            let (missed, beyond) = (missed as f64 / (until - from) as f64, beyond.count());
            println!("{name}, {share}: {missed:.3} missed, {beyond} beyond, {}", until - from);
            assert!(missed < 0.02, "{name}, {share}: {missed} missed");
            assert_eq!(beyond, 0, "{name}, {share}");
        }
        assert!(!still::wrong(&sound).contains(&true), "{name}");
    }
}

/// Short recordings, with fewer rows than usual but enough to judge.
#[test]
fn short_recordings_lose_almost_only_single_outliers() {
    let scenes = ["presses", "shear", "tap", "edge"].map(|scene| (scene, finger(scene)));
    for (name, sound) in scenes.into_iter().chain([("bench", bench()), ("table", table(3000))]) {
        for every in [1, 8] {
            let (x, y) = thinned(&sound, every);
            let (mut all, mut extra) = (0, 0);
            for rows in [64, 100, 191] {
                for (x, y) in x.chunks_exact(rows).zip(y.chunks_exact(rows)).take(20) {
                    let short = [(x.to_vec(), y.to_vec())];
                    let (_, scaled) = scaled(&short);
                    let Some(residual) = ridge::residual(&scaled, DECAY) else { continue };
                    let beside = count(&alone(&short, &residual));
                    let lost = count(&found(&short));
                    all += rows;
                    extra += lost.saturating_sub(beside);
                }
            }
            // A linear law does not fit a tenth of a press alone.
            assert!(extra * 1000 <= all, "{name}, every {every}-th: {extra} of {all} rows");
        }
    }
}

/// Patterns of wrong rows.
#[derive(Clone, Copy, Debug)]
enum Spoilt {
    Alone,
    Runs,
    Ends,
}

/// Spoils a share of the rows and returns their flags.
///
/// Half of them are spoiled in the targets, half in one input.
fn spoil((x, y): &mut Recorded, share: f64, how: Spoilt) -> Vec<bool> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let rows = x.len();
    let most =
        |rows: &[Vec<f64>]| rows.iter().flatten().fold(0.0, |most: f64, v| most.max(v.abs()));
    let (far_x, far_y) = (2.0 * most(x), 1.5 * most(y));
    let mut wrong = vec![false; rows];
    let wanted = (share * rows as f64) as usize;
    let mut spoilt = 0;
    while spoilt < wanted {
        let length = match how {
            Spoilt::Alone => 1,
            Spoilt::Runs => rng.random_range(5..60),
            Spoilt::Ends => wanted / 2,
        };
        let first = match how {
            Spoilt::Ends if spoilt == 0 => 0,
            Spoilt::Ends => rows - length,
            _ => rng.random_range(0..rows - length),
        };
        let channel = rng.random_range(0..x[0].len());
        let reference = rng.random_range(0..2) == 0;
        for row in first..first + length {
            if reference {
                y[row].iter_mut().for_each(|y| *y = far_y);
            } else {
                x[row][channel] = far_x;
            }
            spoilt += usize::from(!wrong[row]);
            wrong[row] = true;
        }
        if matches!(how, Spoilt::Ends) && first > 0 {
            break;
        }
    }
    wrong
}

#[test]
fn wrong_rows_are_found_alone_in_runs_and_at_ends() {
    let kinds =
        [("presses", thinned(&finger("presses"), 8)), ("table", table(3000)), ("bench", bench())];
    for (name, sound) in &kinds {
        for (share, how) in [
            (0.01, Spoilt::Alone),
            (0.05, Spoilt::Alone),
            (0.10, Spoilt::Alone),
            (0.03, Spoilt::Runs),
            (0.05, Spoilt::Runs),
            (0.10, Spoilt::Runs),
            (0.04, Spoilt::Ends),
        ] {
            let mut recorded = sound.clone();
            let spoilt = spoil(&mut recorded, share, how);
            let found = &found(&[recorded])[0];
            let both = |f: bool, s: bool| {
                found
                    .iter()
                    .zip(&spoilt)
                    .filter(|(found, spoilt)| (**found, **spoilt) == (f, s))
                    .count()
            };
            let (right, lost, missed, kept) =
                (both(true, true), both(true, false), both(false, true), both(false, false));
            println!("{name}, {how:?} {share}: {right} found, {missed} missed, {lost} lost");
            assert!(lost * 1000 <= 12 * (lost + kept), "{name}, {how:?} {share}: {lost} lost");
            assert!(missed * 20 <= right, "{name}, {how:?} {share}: {missed} missed");
        }
    }
}
