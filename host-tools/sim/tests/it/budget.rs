//! Signal chain of the reference finger, from the LED's current to millinewtons.
//!
//! The table of docs/front-end.md is recomputed here from the definition and from a press that the
//! simulator makes; `TAXEL_DRAW=1 cargo test -p taxel-sim budget` writes it again.

use std::path::Path;

use scan_plan::finger::REFERENCE;
use scan_plan::g431;
use taxel_files::trace::Sample;
use taxel_sim::electronics::LightNoise;
use taxel_sim::scene::{Changes, REAL};
use taxel_sim::{Scene, Simulator};

use crate::force;

/// Taxel under the presses, in the middle of a window.
const ROW: usize = 2;
const COLUMN: usize = 1;
/// Forces of the presses in newtons.
const LIGHT_N: f64 = 0.1;
const FULL_N: f64 = 2.0;
/// Effects that belong to the chain; the others are spread and disturbance.
const CHAIN: [&str; 2] = ["walls", "diffuse-facet"];

/// Scene of two presses on the reference finger without spread.
fn scene() -> Scene {
    let press = |at: f64, force: f64| {
        format!(
            "[[press]]\nat_s = {at}\nx_mm = -1.25\ny_mm = 1.25\nfz_n = {force}\nrise_s = 0.1\nhold_s = 0.2\nfall_s = 0.1\n"
        )
    };
    let text = format!(
        "effects = []\n[scan]\nrate_hz = 500\nduration_s = 1.2\n[device]\nbits = 16\n[indenter]\nradius_mm = 6\n{}{}",
        press(0.1, LIGHT_N),
        press(0.7, FULL_N)
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("chain.toml");
    std::fs::write(&path, text).unwrap();
    let off = REAL.iter().filter(|effect| !CHAIN.contains(*effect));
    let set = off.map(|effect| format!("effects.{effect}=false")).collect();
    Scene::load_changed(path.to_str().unwrap(), &Changes { reference: true, set }).unwrap()
}

/// Reading of the pressed taxel above darkness in steps of 12 bits, and its facet's place in mm.
fn pressed(samples: &[(Sample, f64)], force_n: f64) -> (f64, f64) {
    let (sample, mm) = samples.iter().find(|(s, _)| (force(s)[2] - force_n).abs() < 1e-6).unwrap();
    let codes = sample.scan.codes.taxels.unwrap();
    let code = f64::from(codes.lit[ROW][COLUMN].0) - f64::from(codes.dark[COLUMN].0);
    (code * 4096.0 / 65536.0, *mm)
}

/// Rows of the table.
fn rows() -> Vec<String> {
    let finger = REFERENCE;
    let (pair, column, converter) = (finger.pair, finger.column, finger.converter);
    let steps = f64::from(1u32 << converter.bits);
    let scene = scene();
    let mut simulator = Simulator::new(&scene, 1);
    let mut samples = Vec::new();
    while let Some(sample) = simulator.next() {
        let mm = simulator.displacement().map_or(0.0, |facets| facets[4 * ROW + COLUMN]);
        samples.push((sample, mm));
    }
    let (rest, _) = pressed(&samples, 0.0);
    let (light, light_mm) = pressed(&samples, LIGHT_N);
    let (full, full_mm) = pressed(&samples, FULL_N);

    let led = (converter.range_v - pair.led_v) / pair.led_ohm;
    let rest_a = pair.rest_a();
    let volts = rest_a * column.feedback_ohm;
    let calculated = volts / converter.range_v * steps;
    // The simulator's pair of a mean device is the definition's.
    assert!((rest - calculated).abs() < 2.0, "{rest} {calculated}");
    let per_um = (light - rest) / (1e3 * light_mm);
    let per_mn = (light - rest) / (1e3 * LIGHT_N);
    let share = (full - rest) / steps;
    let reading = finger.share(rest_a);
    let samples = f64::from(converter.oversampling);
    let converted = (converter.noise_steps.powi(2) + 1.0 / 12.0) / samples;
    let top = f64::from(g431::plan(converter.settings()).unwrap().full_scale);
    let noise = (LightNoise::of(&scene).of_reading(reading) * steps * steps + converted).sqrt();
    let row = |what: &str, from: String, value: String| format!("| {what} | {from} | {value} |");
    vec![
        row(
            "LED",
            format!("({} V − {} V) / {} Ω", converter.range_v, pair.led_v, pair.led_ohm),
            format!("{:.2} mA", 1e3 * led),
        ),
        row(
            "photocurrent at rest",
            format!("{:.0} µA at the peak × light curve at {} mm", 1e6 * pair.peak_a, pair.gap_mm),
            format!("{:.1} µA", 1e6 * rest_a),
        ),
        row(
            "voltage above darkness",
            format!("× {} kΩ", column.feedback_ohm / 1e3),
            format!("{volts:.3} V"),
        ),
        row(
            "steps of 12 bits",
            format!("× {steps} / {} V", converter.range_v),
            format!("{calculated:.0}"),
        ),
        row(
            "codes of the product",
            format!("{samples} samples: × {top} / {steps}"),
            format!("{:.0}", volts / converter.range_v * top),
        ),
        row(
            "a micrometre of the facet",
            "slope of a diffuse facet's light".to_owned(),
            format!("{per_um:.2} steps"),
        ),
        row(
            "facet under 0.1 N",
            "sphere of 6 mm above its middle, framed skin".to_owned(),
            format!("{:.1} µm", 1e3 * light_mm),
        ),
        row("a millinewton there", "both".to_owned(), format!("{per_mn:.3} steps")),
        row(
            "facet under 2 N",
            "the same".to_owned(),
            format!(
                "{:.0} µm, {:.0} steps, {:.0} % of the range",
                1e3 * full_mm,
                full - rest,
                100.0 * share
            ),
        ),
        row(
            "noise of a reading at rest",
            format!("{samples} samples; light, converter"),
            format!("{noise:.2} steps"),
        ),
        row(
            "that as displacement",
            "÷ steps for a micrometre".to_owned(),
            format!("{:.0} nm", 1e3 * noise / per_um),
        ),
        row(
            "that as a force there",
            "÷ steps for a millinewton".to_owned(),
            format!("{:.1} mN", noise / per_mn),
        ),
    ]
}

#[test]
fn signal_chain_budget_is_the_pages() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/front-end.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (begin, end) = ("<!-- budget -->\n", "<!-- budget: end -->");
    let (before, rest) = text.split_once(begin).unwrap();
    let (there, after) = rest.split_once(end).unwrap();
    let head = "| step | from | value |\n|---|---|---|\n";
    let table = rows().into_iter().fold(head.to_owned(), |table, row| table + &row + "\n");
    if std::env::var_os("TAXEL_DRAW").is_some() {
        std::fs::write(&path, format!("{before}{begin}{table}{end}{after}")).unwrap();
        return;
    }
    assert_eq!(there, table);
}
