//! Test of a recording that the page plays.

use std::time::{Duration, Instant};

use taxel::frame::Fields;
use taxel_cli::Files;
use taxel_cli::view::{Feed, Source};
use taxel_client::Client;
use taxel_files::frames::Cell;
use taxel_files::recording::{Existing, Recording};

use super::{Browser, finger, serve};

#[test]
fn recording_plays_pauses_and_seeks() {
    let folder = tempfile::tempdir().unwrap();
    let finger = finger("press");
    let client = Client::open(finger.port()).unwrap();
    client.set_fields(Fields::SIGNALS | Fields::ESTIMATES).unwrap();
    let path = folder.path().join("press.mcap");
    let mut files = Files::create(&client, std::slice::from_ref(&path), Existing::Keep).unwrap();
    client.stream(true).unwrap();
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(4) {
        if let Some(received) = client.next(Duration::from_millis(50)).unwrap() {
            files.write(&received).unwrap();
        }
    }
    files.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    let (time, force) = (recording.position("t_us").unwrap(), recording.position("fz_n").unwrap());
    let rows: Vec<_> = recording.map(Result::unwrap).collect();

    let server = serve(vec![Feed::start(Source::File(path, None)).unwrap()]);
    let mut browser = Browser::open(&server.url(), 1280, 900);
    browser.wait_for("taxel.playback.of > 3.5 && taxel.playback.at > 0.5");
    let seek = |browser: &mut Browser, to: f64| {
        browser.value(&format!(
            "(s => {{ s.value = {to}; s.onchange(); }})(document.getElementById('scrubber'))"
        ));
    };
    // A slow browser may find that the recording has ended, where the space bar plays it again.
    seek(&mut browser, 0.0);
    browser.wait_for("taxel.playback.at < 2.5");
    if browser.value("taxel.playback.runs") == false {
        browser.key(" ");
        browser.wait_for("taxel.playback.runs && taxel.playback.at > 0");
    }
    browser.key(" ");
    browser.wait_for("!taxel.playback.runs");
    for to in [3.0, 1.0, 2.0] {
        seek(&mut browser, to);
        browser.wait_for(&format!("Math.abs(taxel.playback.at - {to}) < .01"));
        browser.wait_for(&format!(
            "Math.abs(taxel.latest[taxel.at.t_us] - taxel.times.at(-1) * 1e6) < 1 && taxel.times.at(-1) * 1e6 - {} <= {to} * 1e6 + 1",
            whole(&rows[0][time])
        ));
        let latest = browser.value("taxel.latest");
        let row = rows.iter().find(|row| latest[time] == whole(&row[time])).unwrap();
        let at = (whole(&row[time]) - whole(&rows[0][time])) as f64 * 1e-6;
        assert!((at - to).abs() < 0.01, "{at} where {to} was sought");
        match row[force] {
            Cell::Real(value) => {
                assert_eq!(latest[force].as_f64().map(|v| v as f32), Some(value))
            }
            Cell::Withheld(why) => {
                assert_eq!(latest[force], taxel_files::frames::reason(why));
            }
            other => panic!("{other:?}"),
        }
    }
    browser.key("b");
    assert_eq!(browser.text("said"), "", "a recording has no bias to take");
}

fn whole(cell: &Cell) -> u64 {
    match cell {
        Cell::Whole(value) => *value,
        other => panic!("{other:?}"),
    }
}
