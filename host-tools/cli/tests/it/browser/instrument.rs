//! Tests of the page as an instrument: stale numbers, pause, zoom, values, raw codes, status.

use taxel_cli::VirtualFinger;

use super::*;

/// Opens the page of a scene's finger.
pub fn page(scene: &str) -> (VirtualFinger, Server, Browser, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let finger = finger(scene);
    let server = show(finger.port(), folder.path());
    let browser = Browser::open(&server.url(), 1280, 900);
    (finger, server, browser, folder)
}

/// Centre of an element, in pixels.
pub fn centre(browser: &mut Browser, selector: &str, share: f64) -> (f64, f64) {
    let place = browser.value(&format!(
        "(box => [box.left + {share} * box.width, box.top + box.height / 2])
            (document.querySelector('{selector}').getBoundingClientRect())"
    ));
    (place[0].as_f64().unwrap(), place[1].as_f64().unwrap())
}

#[test]
fn lost_finger_greys_numbers_and_tells_age() {
    let (finger, _server, mut browser, _folder) = page("press");
    browser.wait_for(
        "taxel.times.length > 300 && document.getElementById('rate').innerText.includes('Hz')",
    );
    assert_eq!(browser.value("document.body.classList.contains('stale')"), false);
    drop(finger);
    browser.wait_for("document.body.classList.contains('stale')");
    browser.wait_for("/^as of [2-9] s ago/.test(document.getElementById('as-of').innerText)");
    let verdict = browser.text("verdict");
    assert!(
        verdict.contains("No word from the finger") && !verdict.contains("touches"),
        "{verdict}"
    );
    for vital in ["rate", "echo", "clock"] {
        assert_eq!(browser.text(vital), "–", "{vital}");
    }
    assert_eq!(browser.text("flags"), "Unknown");
    let grey = "getComputedStyle(document.getElementById('big-normal')).filter";
    assert_eq!(browser.value(grey), "grayscale(1)");
    browser.wait_for("taxel.strips[0].end === 'last'");
    for button in ["bias", "clear-bias", "self-test", "record"] {
        let state = browser.value(&format!(
            "(button => [button.disabled, button.title])(document.getElementById('{button}'))"
        ));
        assert_eq!(state[0], true, "{button} can be pressed without a finger");
        let why = state[1].as_str().unwrap();
        assert!(why.starts_with("The finger does not answer: tcp:"), "{button}: {why}");
    }
    browser.key("r");
    assert_eq!(browser.text("said"), "", "a key reaches the finger that is gone");
    // The age grows also when the whole program has ended.
    drop(_server);
    browser.wait_for("/^as of [4-9] s ago/.test(document.getElementById('as-of').innerText)");
    browser.picture("view-gone");
}

#[test]
fn paused_charts_stand_still_while_numbers_go_on() {
    let (_finger, _server, mut browser, _folder) = page("press");
    browser.wait_for("taxel.times.length > 300");
    let picture = "document.querySelector('#strips canvas').toDataURL()";
    let seq = "Number(document.getElementById('values').dataset.seq)";
    let moving = browser.value(picture);
    browser.value(&format!("void (window.from = {seq})"));
    browser.wait_for(&format!("{seq} > from + 500"));
    assert_ne!(browser.value(picture), moving, "the charts do not move");
    browser.key("p");
    browser.wait_for("taxel.strips[0].end === 'paused'");
    let still = browser.value(picture);
    browser.value(&format!("void (window.from = {seq})"));
    browser.wait_for(&format!("{seq} > from + 500"));
    assert_eq!(browser.value(picture), still, "paused charts move");
    browser.key("p");
    browser.wait_for(&format!("taxel.strips[0].end === 'now' && {seq} > from + 1000"));
    assert_ne!(browser.value(picture), still, "the charts do not go on");
}

#[test]
fn pointer_reads_values_and_dragging_zooms() {
    let (_finger, _server, mut browser, _folder) = page("press");
    browser.wait_for("taxel.times.length > 1500");
    browser.key("p");
    browser.wait_for("taxel.strips[0].end === 'paused'");
    let over = "#strips .u-over";
    let mut pressed = 0;
    for share in [0.97, 0.9, 0.83, 0.76, 0.69] {
        let (x, y) = centre(&mut browser, over, share);
        browser.mouse("mouseMoved", x, y, false, 0);
        browser.wait_for("document.querySelector('.when').innerText.startsWith('at −')");
        let shown = browser.value(
            "(heading => ({ when: heading.querySelector('.when').innerText,
                force: heading.querySelectorAll('.key b')[3].innerText }))
                (document.querySelector('.chart h3'))",
        );
        let text = |name: &str| shown[name].as_str().unwrap().replace('−', "-");
        let when: f64 =
            text("when").trim_matches(|c: char| c.is_alphabetic() || c == ' ').parse().unwrap();
        let force = text("force");
        let ends: Vec<f64> = force.split(" … ").map(|end| end.parse().unwrap()).collect();
        // Ticks of this pixel, from what the page has of the finger.
        let ticks = browser.value(&format!(
            "(() => {{ const p = taxel.strips[0].plot, step = 20 / p.bbox.width, {{ times, low, high }} = taxel.paused();
                const end = times.at(-1), its = (t) => Math.floor(t / step);
                const near = times.map((t, i) => i).filter((i) => Math.abs(times[i] - end - {when}) < step + .01);
                return [Math.min(...near.map((i) => low.fz_n[i])), Math.max(...near.map((i) => high.fz_n[i]))]; }})()"
        ));
        let [low, high] = [0, 1].map(|i| ticks[i].as_f64().unwrap());
        assert!(
            ends.iter().all(|end| (low - 1e-3..=high + 1e-3).contains(end)),
            "{force} at {when} s, where the finger gave {low} to {high} N"
        );
        pressed += usize::from(high > 0.5);
    }
    assert!(pressed > 0, "the pointer was never over a press");
    assert!(
        browser.value("document.querySelectorAll('.chart .when')[1].innerText") != "",
        "one chart only"
    );

    let (from, y) = centre(&mut browser, over, 0.8);
    let (to, _) = centre(&mut browser, over, 0.9);
    browser.mouse("mouseMoved", from, y, false, 0);
    browser.mouse("mousePressed", from, y, true, 1);
    browser.mouse("mouseMoved", (from + to) / 2.0, y, true, 0);
    browser.mouse("mouseMoved", to, y, true, 0);
    browser.mouse("mouseReleased", to, y, true, 1);
    let range = |i: usize| format!("(x => [x.min, x.max])(taxel.strips[{i}].plot.scales.x)");
    browser.wait_for("taxel.strips[0].plot.scales.x.max < -1");
    for chart in [0, 1] {
        let zoomed = browser.value(&range(chart));
        let ends = [0, 1].map(|i| zoomed[i].as_f64().unwrap());
        assert!((ends[0] + 4.0).abs() < 0.1 && (ends[1] + 2.0).abs() < 0.1, "{ends:?}");
    }
    let (x, y) = centre(&mut browser, over, 0.5);
    browser.mouse("mouseMoved", x, y, false, 0);
    browser.picture("view-paused");
    for clicks in [1, 2] {
        browser.mouse("mousePressed", x, y, true, clicks);
        browser.mouse("mouseReleased", x, y, true, clicks);
    }
    browser.wait_for("taxel.strips[0].plot.scales.x.max === 0");
    assert_eq!(browser.value(&range(0)), serde_json::json!([-20, 0]));
}

#[test]
fn charts_show_the_chosen_window() {
    let (_finger, _server, mut browser, _folder) = page("press");
    browser.wait_for("taxel.times.length > 600");
    for seconds in [2, 120] {
        browser.value(&format!(
            "(list => {{ list.value = '{seconds}'; list.onchange(); }})(document.getElementById('window'))"
        ));
        browser.wait_for(&format!("taxel.strips[0].plot.scales.x.min === -{seconds}"));
        let drawn = browser.value("taxel.strips[0].plot.data[0]");
        let first = drawn[0].as_f64().unwrap();
        // All of a short window is drawn; of a long one what has come so far.
        assert!(if seconds == 2 { (first + 2.0).abs() < 0.05 } else { first < -2.5 }, "{first}");
    }
    browser.key("+");
    browser.wait_for("taxel.strips[0].plot.scales.x.min === -60");
}

#[test]
fn status_never_contradicts_itself() {
    let (_finger, _server, mut browser, _folder) = page("tour");
    browser.wait_for("taxel.times.length > 60");
    browser.value(
        "void (() => { window.said = []; const note = () => said.push(['verdict', 'flags'].map((id) => document.getElementById(id).innerText));
            new MutationObserver(note).observe(document.getElementById('readout'), { subtree: true, childList: true, characterData: true });
            new MutationObserver(note).observe(document.getElementById('flags'), { subtree: true, childList: true, characterData: true }); })()",
    );
    // One round of the tour has presses, slips and releases.
    browser.wait_for("said.some(([verdict]) => verdict.includes('It slides')) && said.some(([verdict, flags]) => verdict.includes('Nothing touches') && flags.includes('It slid'))");
    let said = browser.value("said");
    let mut seen = std::collections::BTreeSet::new();
    for one in said.as_array().unwrap() {
        let [verdict, flags] = [0, 1].map(|i| one[i].as_str().unwrap());
        seen.insert(verdict.lines().next().unwrap_or_default().to_owned());
        if verdict.contains("Nothing touches") {
            for present in ["About to slip", "It slides", "Grip harder", "Not a single contact"] {
                assert!(
                    !flags.contains(present) && !verdict.contains(present),
                    "{verdict} / {flags}"
                );
            }
        }
    }
    assert!(seen.contains("Something touches the finger"), "{seen:?}");
}

#[test]
fn self_test_is_a_picture_with_the_dead_taxel() {
    let (_finger, _server, mut browser, _folder) = page("faulty");
    // The faults begin at 3 s.
    browser.wait_for("document.getElementById('flags').querySelectorAll('.bad').length === 2");
    browser.key("t");
    browser.wait_for("!document.getElementById('self-test-panel').hidden");
    let kinds = browser.value(
        "Object.fromEntries([...document.querySelectorAll('.channel')].map((cell) => [cell.dataset.name, cell.className]))",
    );
    let kinds = kinds.as_object().unwrap();
    let faulty: Vec<_> = kinds.iter().filter(|(_, kind)| *kind == "channel faulty").collect();
    let names: Vec<_> = faulty.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["bridge_s1_a", "lit_r1c2"]);
    let taxels = "document.querySelector('.channels').children.length";
    assert_eq!(browser.value(taxels), 16);
    let said = browser.text("said");
    assert!(said.starts_with("self-test:") && said.len() < 160, "{said}");
    assert!(browser.text("self-test-panel").contains("lit_r1c2 is hardly brighter"));
    browser.picture("view-self-test");
    browser.value("document.getElementById('self-test-close').click()");
    assert_eq!(browser.value("document.getElementById('self-test-panel').hidden"), true);
}

#[test]
fn force_at_rest_tells_its_deviation_or_why_none() {
    let (_finger, _server, mut browser, _folder) = page("idle");
    browser.wait_for("document.getElementById('verdict').innerText.includes('Nothing touches')");
    let sigma = "document.querySelector('#big-normal .sigma').innerText";
    browser.wait_for(&format!("{sigma} === 'no contact, so 0 without ±'"));
    // A finger that sends a deviation at rest.
    let told = browser.value(
        "import('/readout.js').then(({ large }) => {
            for (const axis of 'xyz') taxel.latest[taxel.at[`f${axis}_sigma_n`]] = .004;
            large([0, 0, 0], ['no contact', 'no contact']);
            return document.querySelector('#big-normal .sigma').innerText; })",
    );
    assert_eq!(told, "± 0.004 N");
}

#[test]
fn length_of_force_is_drawn_and_fits_a_phone() {
    let (_finger, _server, mut browser, _folder) = page("shear");
    browser.wait_for("taxel.latest[taxel.at.fx_n] > .3");
    browser.redrawn(10);
    let drawn = browser.value(
        "(({ names, plot }) => ['f_n', 'fx_n', 'fy_n', 'fz_n']
            .map((name) => plot.data[names.indexOf(name) + 1].at(-1)))(taxel.strips[0])",
    );
    let [all, x, y, z] = [0, 1, 2, 3].map(|i| drawn[i].as_f64().unwrap());
    assert!(x > 0.25 && (all - x.hypot(y).hypot(z)).abs() < 0.02, "{drawn}");
    browser.resize(390, 844);
    browser.redrawn(10);
    browser.wait_for("/^[0-9.]+$/.test(document.querySelector('#big-force output').innerText)");
    // Everything of the heading and of the numbers lies within the page, and above the chart.
    let outside = browser.value(
        "[...document.querySelectorAll('.big output, .big .unit, .chart .key')].filter((one) => {
            const box = one.getBoundingClientRect(), holder = one.closest('h3')?.getBoundingClientRect();
            return !box.width || box.right > innerWidth || holder && box.bottom > holder.bottom + 1;
        }).map((one) => one.textContent)",
    );
    assert_eq!(outside, serde_json::json!([]));
    assert!(browser.text("strips").contains("|F|"));
}

/// Draws a fall of force: its line must not be double.
#[test]
fn edge_is_drawn_as_one_line() {
    let (_finger, _server, mut browser, _folder) = page("idle");
    let drawn = browser.value(
        "import('/charts.js').then(({ thinned }) => thinned([0, 1, 2, 3, 9], [[1, 0, 0, 0, 0]], [[1, 1, 0, 0, 0]], 1, [0, 10], 2))",
    );
    // The line goes from the old value to the new one, once; after a gap it begins again.
    assert_eq!(drawn[1], serde_json::json!([1, 1, 1, 0, 0, 0, 0, 0, null, 0, 0]));
}
