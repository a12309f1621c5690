use super::history::{FINE, MERGED_KEPT};
use super::*;

fn scope() -> Scope {
    let column = |name: &str, kind| Column { name: name.to_owned(), kind };
    let mut scope = Scope::new();
    scope.set_columns(vec![
        column("t_us", Kind::Whole),
        column("seq", Kind::Whole),
        column("status", Kind::Whole),
        column("fz_n", Kind::Measured),
    ]);
    scope
}

/// Time at which the last tick of rows that just came is closed.
fn settled() -> Instant {
    Instant::now() + SETTLED
}

/// Pushes a stream of 4 kHz with one outlier at `peak`.
fn stream(scope: &mut Scope, rows: u64, peak: u64) {
    let start = Instant::now().checked_sub(Duration::from_micros(rows * 250)).unwrap();
    for i in 0..rows {
        let force = if i == peak { 9.5 } else { 1.0 };
        let status = u64::from(i == peak) << 5;
        let row = [Cell::Whole(i * 250), Cell::Whole(i), Cell::Whole(status), Cell::Real(force)];
        scope.push(&row, start + Duration::from_micros(i * 250));
    }
}

#[test]
fn ticks_keep_every_peak_and_flag() {
    let mut scope = scope();
    stream(&mut scope, 4000, 1234);
    let news = scope.news(&mut Seen::default(), settled());
    let high: Vec<f64> = news["ticks"]["high"]
        .as_array()
        .unwrap()
        .iter()
        .map(|tick| tick[0].as_f64().unwrap())
        .collect();
    assert_eq!(high.len(), 200);
    assert_eq!(high.iter().filter(|high| **high == 9.5).count(), 1);
    let status = news["ticks"]["status"].as_array().unwrap();
    assert_eq!(status.iter().filter(|bits| **bits == 32).count(), 1);
    assert!((news["rate"].as_f64().unwrap() - 4000.0).abs() < 1.0);
}

#[test]
fn slow_page_gets_every_tick_once() {
    let mut scope = scope();
    let mut seen = Seen::default();
    stream(&mut scope, 2000, 0);
    let mut told = |seen: &mut Seen, now| {
        let news = scope.news(seen, now);
        let ends = news["ticks"]["time"].as_array().unwrap().iter();
        let ends: Vec<f64> = ends.map(|time| time.as_f64().unwrap()).collect();
        let rows = news["ticks"]["rows"].as_array().unwrap().iter();
        (ends, rows.map(|rows| rows.as_u64().unwrap()).sum::<u64>())
    };
    let (mut ends, first) = told(&mut seen, Instant::now());
    assert!(ends.len() > 20);
    // The last tick, if it was still open then.
    let (last, rest) = told(&mut seen, settled());
    ends.extend(last);
    assert_eq!(first + rest, 2000);
    assert!(ends.windows(2).all(|pair| pair[0] < pair[1]), "{ends:?}");
    let news = scope.news(&mut seen, settled());
    assert_eq!(news["ticks"]["time"], json!([]));
    assert_eq!(news.get("columns"), None);
}

#[test]
fn missing_value_is_shown_as_its_reason() {
    let mut scope = scope();
    let why = taxel::measured::NoValue::NoContact;
    let row = [Cell::Whole(0), Cell::Whole(0), Cell::Whole(0), Cell::Withheld(why)];
    scope.push(&row, Instant::now());
    let news = scope.news(&mut Seen::default(), settled());
    assert_eq!(news["latest"][3], "no contact");
    assert_eq!(news["ticks"]["low"], json!([[null]]));
}

/// Returns the first and last force of each tick.
fn forces(news: &Value) -> Vec<(f64, f64)> {
    let ends = |name: &str| {
        let ticks = news["ticks"][name].as_array().unwrap().clone();
        ticks.into_iter().map(|tick| tick[0].as_f64().unwrap())
    };
    ends("low").zip(ends("high")).collect()
}

#[test]
fn stalled_host_draws_no_wedge() {
    let mut scope = scope();
    // A ramp of 1 N/s whose rows all arrive at once.
    let at = Instant::now();
    for i in 0..1000u64 {
        let force = Cell::Real(i as f32 * 1e-3);
        scope.push(&[Cell::Whole(i * 1000), Cell::Whole(i), Cell::Whole(0), force], at);
    }
    let forces = forces(&scope.news(&mut Seen::default(), settled()));
    assert_eq!(forces.len(), 200);
    assert!(forces.iter().all(|(low, high)| high - low < 0.005), "{forces:?}");
}

#[test]
fn added_column_keeps_earlier_ticks() {
    let mut scope = scope();
    stream(&mut scope, 400, 7);
    let mut columns = scope.columns.clone();
    columns.insert(3, Column { name: "fx_n".to_owned(), kind: Kind::Measured });
    scope.set_columns(columns);
    let news = scope.news(&mut Seen::default(), Instant::now());
    assert_eq!(news["ticks"]["high"][0], json!([null, 9.5]));
    assert!(news["ticks"]["high"].as_array().unwrap().len() > 15);
}

#[test]
fn opening_page_gets_history_in_pieces() {
    let mut scope = scope();
    stream(&mut scope, 20_000, 0);
    let mut seen = Seen::default();
    let sizes = [(); 3].map(|()| forces(&scope.news(&mut seen, settled())).len());
    assert_eq!(sizes, [MOST, MOST, 0]);
}

/// Collects what a page gets that opens now: times, and each tick's largest force.
fn opened(scope: &mut Scope) -> Vec<(f64, f64)> {
    let mut seen = Seen::default();
    let mut ticks = Vec::new();
    loop {
        let news = scope.news(&mut seen, settled());
        let times: Vec<_> = news["ticks"]["time"].as_array().unwrap().clone();
        if times.is_empty() {
            return ticks;
        }
        let high = forces(&news).into_iter().map(|(_, high)| high);
        ticks.extend(times.iter().map(|time| time.as_f64().unwrap()).zip(high));
    }
}

#[test]
fn opening_page_gets_two_minutes() {
    let mut scope = scope();
    // 140 s, with a peak of a single frame 110 s before the end.
    stream(&mut scope, 560_000, 120_000);
    let ticks = opened(&mut scope);
    let (first, last) = (ticks[0].0, ticks[ticks.len() - 1].0);
    assert!((119.9..120.1).contains(&(last - first)), "{first} to {last}");
    assert_eq!(ticks.len(), FINE + MERGED_KEPT);
    let peaks: Vec<f64> =
        ticks.iter().filter(|(_, high)| *high == 9.5).map(|(time, _)| *time).collect();
    assert!(peaks.len() == 1 && (peaks[0] - 30.0).abs() < 0.02, "{peaks:?}");
    assert!(ticks.windows(2).all(|pair| pair[0].0 < pair[1].0));
}

#[test]
fn length_of_force_is_a_column() {
    let mut scope = Scope::new();
    let names = ["t_us", "fx_n", "fy_n", "fz_n"];
    let column = |name: &str| Column { name: name.to_owned(), kind: Kind::Measured };
    scope.set_columns(names.map(column).to_vec());
    let row = |z| [Cell::Whole(0), Cell::Real(2.0), Cell::Real(-3.0), z];
    scope.push(&row(Cell::Real(6.0)), Instant::now());
    scope.push(&row(Cell::Real(0.0)), Instant::now());
    let news = scope.news(&mut Seen::default(), settled());
    assert_eq!(news["columns"][4], json!({ "name": "f_n", "ranged": true }));
    let ends = ["low", "high"].map(|end| news["ticks"][end][0][4].as_f64().unwrap());
    assert!((ends[0] - 13f64.sqrt()).abs() < 1e-6 && ends[1] == 7.0, "{ends:?}");
    // A force without one of its components has no length either.
    scope.push(&row(Cell::Withheld(taxel::measured::NoValue::Saturated)), Instant::now());
    let news = scope.news(&mut Seen::default(), settled());
    assert_eq!(news["latest"][4], news["latest"][3]);
    assert_eq!(news["latest"][4], reason(taxel::measured::NoValue::Saturated));
}
