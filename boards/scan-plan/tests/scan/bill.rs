//! Tests of the bills of materials and times on the pages against the reference finger.

use scan_plan::finger::{Column, Finger, REFERENCE, time_constant_s};
use scan_plan::settle;

use crate::pages::page;

/// Number as a page writes it: whole ohms below 1 kΩ, kilo-ohms above.
fn ohms(ohm: f64) -> String {
    if ohm < 1_000.0 { format!("{ohm} Ω") } else { format!("{} kΩ", ohm / 1_000.0) }
}

/// Rows and sentences of the board's page that follow from a finger.
fn rows(finger: &Finger) -> Vec<String> {
    let Finger { pair, column, supply, .. } = *finger;
    let feedback = format!(
        "{} 0.1 % 25 ppm, {:.0} pF C0G",
        ohms(column.feedback_ohm),
        1e12 * column.feedback_f
    );
    let divider = 1.0 / column.reference_ratio();
    let [high, low] = column.divider_ohm.map(ohms);
    let settles = f64::from(finger.settles_ns()) / 1000.0;
    let tau = 1e6 * finger.time_constant_s();
    let (range, led) = (finger.converter.range_v, ohms(pair.led_ohm));
    let current = 1e3 * (range - pair.led_v) / pair.led_ohm;
    // Supply and resistor at the ends of their tolerance, the least forward voltage; rounded up.
    let most = (1e5 * (1.02 * range - 1.15) / (0.99 * pair.led_ohm)).ceil() / 100.0;
    vec![
        format!("| LED, 850 nm | {} | 16 |", pair.led),
        format!("| phototransistor | {} | 16 |", pair.phototransistor),
        format!("| LED resistors | {led} 1 % | 16 |"),
        format!(
            "| LED | ({range} V − {} V) / {led} | {current:.2} mA; with 2 % and 1 % and 1.15 V: \
             **{most:.2} mA** | one row: {:.1} mA |",
            pair.led_v,
            4.0 * most
        ),
        format!("takes at most {most:.2} mA (an {} bears", pair.led),
        format!("| {} |", supply.regulator),
        format!("| ferrite bead, VDDA | {} (", supply.bead),
        format!("| column amplifier, quad | {} (", column.amplifier),
        format!("| column feedback | {feedback} | 4 + 4 |"),
        format!("| column reference; column pins | {high}, {low} 0.1 %; {}", ohms(column.pin_ohm)),
        format!("from {high} and {low} with 100 nF"),
        format!("The other input is at VDDA/{divider}"),
        format!("with {} and {:.0} pF", ohms(column.feedback_ohm), 1e12 * column.feedback_f),
        format!("each with its own {led} from VDDA"),
        format!("time constant is {tau:.2} µs at rest"),
        format!("take {settles:.1} µs"),
        format!("--settle {settles:.2}` sets it"),
    ]
}

/// Text of a page with one space between words.
fn flowing(board: &str) -> String {
    page(board).split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn other_feedback_resistor_changes_all_that_follows() {
    let column = Column { feedback_ohm: 2.0 * REFERENCE.column.feedback_ohm, ..REFERENCE.column };
    let other = Finger { column, ..REFERENCE };
    let rest_a = REFERENCE.pair.rest_a();
    let signal = |finger: &Finger| finger.share(rest_a) - finger.share(0.0);
    assert!((signal(&other) / signal(&REFERENCE) - 2.0).abs() < 1e-12);
    assert!(other.settles_ns() > settle::ON_LOAD_NS + 1_000);
    // The page's rows of resistor, settle time and time constant are no longer there.
    let text = flowing("stm32g431");
    let missing = rows(&other).iter().filter(|row| !text.contains(*row)).count();
    assert_eq!(missing, 5);
}

#[test]
fn bill_of_materials_is_the_reference_fingers() {
    let column = REFERENCE.column;
    let text = flowing("stm32g431");
    let missing: Vec<_> = rows(&REFERENCE).into_iter().filter(|row| !text.contains(row)).collect();
    assert!(missing.is_empty(), "not on the page of stm32g431: {missing:#?}");
    // No other load is left anywhere.
    for board in ["stm32g431", "stm32f411", "weact-stm32g431"] {
        assert!(!page(board).contains("680 Ω"), "{board}");
    }
    for board in ["stm32g431", "stm32f411"] {
        let drawn =
            std::fs::read_to_string(crate::pages::docs().join(format!("{board}.svg"))).unwrap();
        let label = format!("{}, {:.0} pF", ohms(column.feedback_ohm), 1e12 * column.feedback_f);
        assert!(drawn.contains(&label) && !drawn.contains("680 Ω"), "{board}.svg");
    }
}

#[test]
fn time_constant_meets_the_data_sheet() {
    // 7 µs from 10 to 90 % on 1 kΩ at 1 mA.
    assert!((1e6 * time_constant_s(1_000.0, 1e-3) - 7.0 / 9f64.ln()).abs() < 1e-9);
    let exact = 1e9 * REFERENCE.time_constant_s() * 4096f64.ln();
    assert!((f64::from(settle::ON_LOAD_NS) - exact).abs() < 2.0, "{exact}");
}

#[test]
fn brightest_pair_under_2_n_stays_in_range() {
    // Three spreads of gain (8 %) and of gap (0.06 mm), four neighbours with 3 % of its light, room
    // light of 4 µA; 2 N on the framed skin displace a facet by less than 0.35 mm.
    let pair = REFERENCE.pair;
    let pressed = pair.photocurrent_a(pair.gap_mm - 0.35);
    let spread = 1.0 + 3.0 * f64::hypot(0.08, 0.06 * 0.86);
    let most = REFERENCE.share(pressed * (spread + 4.0 * 0.03) + 4e-6);
    assert!((0.9..1.0).contains(&most), "{most}");
}
