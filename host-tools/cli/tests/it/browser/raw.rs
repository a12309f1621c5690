//! Tests of the strips of raw codes: they move, pause, are read and zoomed like the charts.

use taxel_cli::VirtualFinger;

use super::instrument::centre;
use super::*;

/// Opens the page of a finger without a calibration.
fn raw_page() -> (VirtualFinger, Server, Browser, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let finger = VirtualFinger::on_tcp("127.0.0.1:0", source("press"), None).unwrap();
    let server = show(finger.port(), folder.path());
    let browser = Browser::open(&server.url(), 1280, 900);
    (finger, server, browser, folder)
}

const CANVAS: &str = "#raw [data-name=lit_r1c1] canvas";

fn shown(browser: &mut Browser) -> String {
    let code = "document.querySelector('#raw [data-name=lit_r1c1] b').innerText";
    browser.value(code).as_str().unwrap().to_owned()
}

#[test]
fn uncalibrated_finger_shows_raw_codes() {
    let (_finger, _server, mut browser, _folder) = raw_page();
    browser.wait_for("document.querySelectorAll('#raw .moved').length >= 16");
    assert_eq!(browser.value("document.getElementById('raw-panel').open"), true);
    let cells = "document.querySelector('#raw .group').querySelectorAll('.cell').length";
    assert_eq!(browser.value(cells), 16);
    assert!(!browser.text("strips").contains("Force"), "an empty chart of newtons");
    assert!(browser.text("verdict").starts_with("Contact is not known"));
    // The code shown is one of the finger's last second; its tick may not have ended yet.
    browser.value(
        "void (window.shown = { code: Number(document.querySelector('#raw [data-name=lit_r1c1] b').innerText),
            at: taxel.times.at(-1) })",
    );
    browser.wait_for("taxel.times.at(-1) > shown.at + 0.2");
    let code = browser.value(
        "[shown.code, Math.min(...taxel.low.lit_r1c1.slice(-300)), Math.max(...taxel.high.lit_r1c1.slice(-300))]",
    );
    let [code, low, high] = [0, 1, 2].map(|i| code[i].as_f64().unwrap());
    assert!((low..=high).contains(&code), "{code} of {low} to {high}");
    let ink = "(canvas => canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some((v) => v))
        (document.querySelector('#raw [data-name=lit_r1c1] canvas'))";
    assert_eq!(browser.value(ink), true, "an empty strip");
    choose_window(&mut browser, 10);
    browser.wait_for("taxel.times.at(-1) - taxel.times[0] > 9");
    browser.picture("view-raw");
    assert!(browser.text("flags").contains("Uncalibrated"));
}

fn choose_window(browser: &mut Browser, seconds: u32) {
    browser.value(&format!(
        "(list => {{ list.value = '{seconds}'; list.onchange(); }})(document.getElementById('window'))"
    ));
}

#[test]
fn raw_strips_stand_still_in_a_pause() {
    let (_finger, _server, mut browser, _folder) = raw_page();
    browser.wait_for("document.querySelectorAll('#raw .moved').length >= 16");
    let picture = format!("document.querySelector('{CANVAS}').toDataURL()");
    browser.key("p");
    browser.wait_for("taxel.paused()");
    browser.redrawn(20);
    let still = browser.value(&picture);
    let code = shown(&mut browser);
    browser.value("void (window.from = taxel.times.at(-1))");
    browser.wait_for("taxel.times.at(-1) > from + 1");
    assert_eq!(browser.value(&picture), still, "a paused strip moves");
    // The numbers go on.
    browser.wait_for(&format!(
        "document.querySelector('#raw [data-name=lit_r1c1] b').innerText !== '{code}'"
    ));
    browser.key("p");
    browser.wait_for(&format!("{picture} !== '{}'", still.as_str().unwrap()));
}

#[test]
fn raw_strips_obey_window_pointer_and_zoom() {
    let (_finger, _server, mut browser, _folder) = raw_page();
    browser.wait_for("taxel.times.length > 1300");
    browser.key("p");
    let mut codes = std::collections::BTreeSet::new();
    for (seconds, share) in [(5, 0.5), (5, 0.8), (2, 0.25), (2, 0.6), (10, 0.7)] {
        choose_window(&mut browser, seconds);
        let (x, y) = centre(&mut browser, CANVAS, share);
        browser.mouse("mouseMoved", x, y, false, 0);
        let at = -f64::from(seconds) * (1.0 - share);
        let text =
            "Number(document.getElementById('raw-when').innerText.replace('−', '-').slice(3, -2))";
        let step = f64::from(seconds) / 50.0;
        browser.wait_for(&format!("Math.abs({text} - {at}) < {step}"));
        let code = shown(&mut browser);
        let ends: Vec<f64> = code.split(" … ").map(|end| end.parse().unwrap()).collect();
        let ticks = browser.value(&format!(
            "(({{ times, low, high }}) => {{
                const near = times.map((t, i) => i).filter((i) => Math.abs(times[i] - times.at(-1) - {text}) < {step} + .01);
                return [Math.min(...near.map((i) => low.lit_r1c1[i])), Math.max(...near.map((i) => high.lit_r1c1[i]))];
            }})(taxel.paused())"
        ));
        let [low, high] = [0, 1].map(|i| ticks[i].as_f64().unwrap());
        assert!(ends.iter().all(|end| (low..=high).contains(end)), "{code} of {ticks}");
        codes.insert(code);
    }
    assert!(codes.len() > 2, "the pointer reads always the same: {codes:?}");

    let (from, y) = centre(&mut browser, CANVAS, 0.6);
    let (to, _) = centre(&mut browser, CANVAS, 0.8);
    browser.mouse("mouseMoved", from, y, false, 0);
    browser.mouse("mousePressed", from, y, true, 1);
    browser.mouse("mouseMoved", to, y, true, 0);
    browser.mouse("mouseReleased", to, y, true, 1);
    browser.wait_for("document.getElementById('paused').innerText.startsWith('zoomed to 2.0 s')");
    let (x, y) = centre(&mut browser, CANVAS, 0.5);
    browser.mouse("mouseMoved", x, y, false, 0);
    browser.wait_for("document.getElementById('raw-when').innerText.match(/^at −(2[.]9|3[.]0)/)");
    for clicks in [1, 2] {
        browser.mouse("mousePressed", x, y, true, clicks);
        browser.mouse("mouseReleased", x, y, true, clicks);
    }
    browser.wait_for("document.getElementById('paused').innerText.startsWith('paused')");
}
