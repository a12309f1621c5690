//! Tests of the spectrum: its peak is named on the plot, its axis is fixed, the pointer reads it.

use serde_json::Value;

use super::instrument::{centre, page};

/// Sticking and slipping of the scene `chatter`, in hertz. It sticks while the stage stretches the
/// spring by 2(μ − μ_k)P/k, and slips for little more than half a swing of the mass.
fn chatter_hz() -> f64 {
    let (stiffness, mass_g, speed): (f64, f64, f64) = (100.0, 4.0, 6.0 / 17.0);
    let stuck = 2.0 * (0.8 - 0.5) * 1.0 / stiffness / speed;
    1.0 / (stuck + std::f64::consts::PI / (1e6 * stiffness / mass_g).sqrt())
}

#[test]
fn vibrating_finger_has_a_named_peak() {
    let (_finger, _server, mut browser, _folder) = page("chatter");
    browser.wait_for("'fx_n' in taxel.at");
    browser.value(
        "(list => { list.value = 'fx_n'; list.onchange(); })(document.getElementById('channel'))",
    );
    let label = "document.querySelector('#spectrum .peak')";
    browser.wait_for(&format!("/^5[0-9][.][0-9] Hz · 0[.][0-9]+ N$/.test({label}?.innerText)"));
    browser.wait_for("taxel.times.at(-1) - taxel.times[0] > 6");
    browser.picture("view-vibration");
    browser.key("p");
    browser.redrawn(2);
    let text = browser.value(&format!("{label}.innerText"));
    let text = text.as_str().unwrap();
    let hz: f64 = text.split(' ').next().unwrap().parse().unwrap();
    assert!((hz / chatter_hz() - 1.0).abs() < 0.03, "{text}, where {:.1} Hz sticks", chatter_hz());

    // The label stands beside the circle, within the plot.
    let far = browser.value(&format!(
        "(({{ plot, peak }}) => {{
            const [label, over] = [{label}, plot.over].map((one) => one.getBoundingClientRect());
            const x = over.left + plot.valToPos(peak.hz, 'x'), y = over.top + plot.valToPos(peak.db, 'y');
            const within = label.left >= over.left && label.right <= over.right && label.top >= over.top;
            return [within, Math.min(Math.abs(label.left - x), Math.abs(label.right - x)), Math.abs((label.top + label.bottom) / 2 - y)];
        }})(taxel.spectrumChart)"
    ));
    assert!(
        far[0] == true && far[1].as_f64() < Some(14.0) && far[2].as_f64() < Some(14.0),
        "{far}"
    );

    // The pointer reads frequency and level of a line. The page is higher than the window.
    browser.resize(1280, 1300);
    browser.redrawn(10);
    let share = browser.value(
        "(({ plot, peak }) => plot.valToPos(peak.hz, 'x') / plot.over.clientWidth)(taxel.spectrumChart)",
    );
    let (x, y) = centre(&mut browser, "#spectrum .u-over", share.as_f64().unwrap());
    browser.mouse("mouseMoved", x, y, false, 0);
    let db = browser.value("taxel.spectrumChart.peak.db").as_f64().unwrap();
    browser.wait_for(&format!(
        "document.getElementById('peak').innerText === '{hz:.1} Hz: {db:.0} dB re 1 mN'"
    ));
}

/// The axis is the same at rest and in a vibration, so that they can be compared by eye.
#[test]
fn spectrum_axis_is_fixed_and_noise_lies_low() {
    let (_finger, _server, mut browser, _folder) = page("idle");
    let scale = "[taxel.spectrumChart.plot.scales.y.min, taxel.spectrumChart.plot.scales.y.max]";
    let highest = "Math.max(...taxel.spectrumChart.plot.data[1])";
    browser.wait_for("'c_r0c0' in taxel.at");
    for (channel, axis) in [("fz_n", [-40, 60]), ("c_r0c0", [-100, 0])] {
        browser.value(&format!("(list => {{ list.value = '{channel}'; list.onchange(); }})(document.getElementById('channel'))"));
        browser.wait_for(&format!(
            "taxel.spectrumShown?.channel === '{channel}' && taxel.spectrumShown.lines
                && taxel.spectrumChart.plot.data[0].length"
        ));
        assert_eq!(browser.value(scale), serde_json::json!(axis), "{channel}");
        let highest = browser.value(highest).as_f64().unwrap();
        let middle = f64::from(axis[0] + axis[1]) / 2.0;
        assert!(highest < middle, "noise of {channel} up to {highest} dB of {axis:?}");
        assert_eq!(browser.text("peak"), "no peak stands out");
    }
}

#[test]
fn spectrum_names_a_vibration_and_no_noise() {
    let (_finger, _server, mut browser, _folder) = page("idle");
    let found = browser.value(
        "import('/spectrum.js').then(({ peak }) => {
            const step = .5, noise = () => .001 * Math.hypot(...[0, 0].map(() => Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random())));
            const slope = Array.from({ length: 1024 }, (_, i) => .5 / (1 + i * i) + noise());
            const sine = slope.map((line, i) => line + (.05 * { 249: .5, 250: 1, 251: .5 }[i] || 0));
            return [peak(step, sine), Array.from({ length: 200 }, () => peak(step, slope.map((line) => line * 0 + noise()))).filter(Boolean).length, peak(step, slope)]; })",
    );
    assert_eq!(found[0]["hz"], 125.0);
    assert!((found[0]["amplitude"].as_f64().unwrap() - 0.05).abs() < 0.01);
    assert_eq!(found[1], 0, "peaks in noise alone");
    assert_eq!(found[2], Value::Null, "the slope of a load is no peak");
}
