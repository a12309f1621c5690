//! Tests of aligning a load cell on its own clock with a sensor.

use super::*;

/// Presses of uneven length at uneven intervals, at a time of the true clock.
fn force(t: f64) -> f64 {
    let press = |at: f64, length: f64, peak: f64| {
        let share = (t - at) / length;
        if (0.0..1.0).contains(&share) { peak * (std::f64::consts::PI * share).sin() } else { 0.0 }
    };
    (0..24)
        .map(f64::from)
        .map(|i| {
            press(
                2.0 + 2.3 * i + 0.6 * (5.0 * i * i).sin(),
                1.0 + 0.4 * (3.0 * i).cos(),
                1.0 + 0.5 * (7.0 * i).sin(),
            )
        })
        .sum()
}

fn noise(i: usize) -> f64 {
    (12.9898 * (i * i) as f64).sin()
}

/// A sensor of three channels at 200 Hz for a minute.
fn sensor() -> (Vec<f64>, Vec<Vec<f64>>) {
    let times: Vec<f64> = (0..12_000).map(|i| i as f64 * 0.005).collect();
    let rows = times.iter().enumerate().map(|(i, t)| {
        let f = force(*t);
        vec![
            5.0 - 2.0 * f + 0.02 * noise(i),
            0.4 * f + 0.1 * f * f + 0.02 * noise(i + 7),
            0.02 * noise(i + 3),
        ]
    });
    (times.clone(), rows.collect())
}

/// A load cell at 80 Hz whose clock shows `offset` + (1 + `rate`)·t.
fn load_cell(offset: f64, rate: f64, load: impl Fn(f64) -> f64) -> (Vec<f64>, Vec<Vec<f64>>) {
    let times: Vec<f64> = (0..4700).map(|i| offset + 0.4 + i as f64 * 0.0125).collect();
    let rows = times
        .iter()
        .enumerate()
        .map(|(i, t)| vec![load((t - offset) / (1.0 + rate)) + 0.005 * noise(i)]);
    (times.clone(), rows.collect())
}

fn aligned(offset: f64, rate: f64) -> Result<Alignment, FitError> {
    let (st, sx) = sensor();
    let (rt, ry) = load_cell(offset, rate, force);
    align(
        ["skin.csv", "cell.csv"],
        Series { times: &st, rows: &sx },
        Series { times: &rt, rows: &ry },
    )
}

#[test]
fn offset_and_rate_are_found_to_a_millisecond() {
    for (offset, rate) in [(0.0, 0.0), (3.7, 0.0), (-1234.5, 0.03), (8.0, -0.03)] {
        let found = aligned(offset, rate).unwrap();
        for t in [2.0, 30.0, 55.0] {
            let off = found.time(t) - (offset + (1.0 + rate) * t);
            assert!(off.abs() < 1e-3, "{offset} {rate}: {off} s at {t}: {found:?}");
        }
        assert!(found.residual < 2e-3 && found.correlation > 0.99, "{found:?}");
    }
}

#[test]
fn repeating_or_missing_load_is_refused() {
    let (st, _) = sensor();
    let wave = |t: f64| (2.0 * std::f64::consts::PI * t).sin();
    let sx: Vec<Vec<f64>> = st.iter().map(|t| vec![wave(*t)]).collect();
    let (rt, ry) = load_cell(0.0, 0.0, wave);
    let of = |sx: &[Vec<f64>], ry: &[Vec<f64>]| {
        align(
            ["skin.csv", "cell.csv"],
            Series { times: &st, rows: sx },
            Series { times: &rt, rows: ry },
        )
        .unwrap_err()
        .to_string()
    };
    assert!(of(&sx, &ry).contains("cell.csv: the load repeats itself"), "{}", of(&sx, &ry));
    let hiss: Vec<Vec<f64>> = (0..ry.len()).map(|i| vec![noise(i)]).collect();
    assert!(of(&sensor().1, &hiss).contains("correlate by"), "{}", of(&sensor().1, &hiss));
    let still = vec![vec![2.5]; ry.len()];
    assert!(of(&sensor().1, &still).contains("never changes"));
}

#[test]
fn resample_interpolates_but_bridges_no_gaps() {
    let times = [0.0, 1.0, 2.0, 3.0, 20.0, 21.0];
    let rows: Vec<Vec<f64>> = times.iter().map(|t| vec![10.0 * t]).collect();
    let found =
        resample(Series { times: &times, rows: &rows }, &[-0.1, 0.0, 1.25, 9.0, 21.0, 21.1]);
    let expected = [None, Some(vec![0.0]), Some(vec![12.5]), None, Some(vec![210.0]), None];
    assert_eq!(found, expected);
}

#[test]
fn resample_keeps_the_tops_of_short_presses() {
    let press = |t: f64| 0.5 - 0.5 * (std::f64::consts::TAU * t / 0.2).cos();
    let times: Vec<f64> = (0..200).map(|i| f64::from(i) * 0.01).collect();
    let rows: Vec<Vec<f64>> = times.iter().map(|t| vec![press(*t)]).collect();
    let at: Vec<f64> = (100..900).map(|i| f64::from(i) * 0.002 + 0.001).collect();
    let found = resample(Series { times: &times, rows: &rows }, &at);
    let most = at.iter().zip(found).map(|(t, row)| (row.unwrap()[0] - press(*t)).abs());
    let most = most.fold(0.0, f64::max);
    assert!(most < 5e-4, "{most}");
}

#[test]
fn resample_is_straight_where_readings_come_in_bursts() {
    let times = [0.0, 0.001, 0.05, 0.1, 0.101, 0.15];
    let rows = [0.0, 1.0, 0.0, 0.0, 1.0, 0.0].map(|x| vec![x]);
    let found = resample(Series { times: &times, rows: &rows }, &[0.0005, 0.1005]);
    assert!(found.iter().all(|row| (row.as_ref().unwrap()[0] - 0.5).abs() < 1e-9), "{found:?}");
}

#[test]
fn misaligned_finds_rate_error_of_three_percent() {
    let (times, rows) = sensor();
    let series = Series { times: &times, rows: &rows };
    let at = |rate: f64| -> Vec<Vec<f64>> {
        times.iter().map(|t| vec![force(t * (1.0 + rate))]).collect()
    };
    assert_eq!(misaligned(series, &at(0.0)), None);
    let found = misaligned(series, &at(0.03)).unwrap();
    assert!((found.time(50.0) - 50.0 / 1.03).abs() < 2e-3, "{found:?}");
}

#[test]
fn rate_is_found_for_repeating_load() {
    let wave = |t: f64| (2.0 * std::f64::consts::PI * t).sin();
    let (times, _) = sensor();
    let rows: Vec<Vec<f64>> = times.iter().map(|t| vec![wave(*t)]).collect();
    let series = Series { times: &times, rows: &rows };
    let at = |rate: f64| -> Vec<Vec<f64>> {
        times.iter().map(|t| vec![wave(t * (1.0 + rate))]).collect()
    };
    assert_eq!(misaligned(series, &at(0.0)), None);
    for rate in [0.03, -0.03] {
        let found = misaligned(series, &at(rate)).unwrap();
        assert!((found.time(50.0) - 50.0 / (1.0 + rate)).abs() < 2e-3, "{found:?}");
    }
}
