//! Tests of patterns, pins and settle time on both boards.

use scan_plan::pins::{
    F411, F411_ROWS, F411_SELECT, G431, G431_ROWS, G431_SELECT, Mode, Pin, moder,
};
use scan_plan::{pattern, settle};

#[test]
fn each_step_lights_its_row_alone_and_selects_its_sensor() {
    for (rows, select) in [(G431_ROWS, G431_SELECT), (F411_ROWS, F411_SELECT)] {
        // Any earlier state of the port.
        for before in [0u32, 0xFFFF, 0x5A5A] {
            for (step, word) in pattern::words(rows, select).into_iter().enumerate() {
                let (set, reset) = (word & 0xFFFF, word >> 16);
                assert_eq!(set & reset, 0);
                let port = before & !reset | set;
                let lit: Vec<_> = (0..4).filter(|row| port >> rows[*row] & 1 == 1).collect();
                assert_eq!(lit, step.checked_sub(1).into_iter().collect::<Vec<_>>());
                let sensor = (port >> select[0] & 1) + 2 * (port >> select[1] & 1);
                assert_eq!(sensor as usize, step.saturating_sub(1));
                // Nothing else on the port is touched.
                let ours = rows.iter().chain(&select).fold(0u32, |mask, pin| mask | 1 << pin);
                assert_eq!(set | reset, ours);
            }
        }
    }
}

#[test]
fn held_row_is_lit_alone_in_each_step() {
    for (rows, select) in [(G431_ROWS, G431_SELECT), (F411_ROWS, F411_SELECT)] {
        let scanned = pattern::words(rows, select);
        for held in 0..4u8 {
            let words = pattern::holding(rows, select, Some(held));
            for (word, scanned) in words.into_iter().zip(scanned) {
                for (row, pin) in (0..).zip(rows) {
                    let switched = word & (1 << pin | 1 << (pin + 16));
                    assert_eq!(switched, 1 << (pin + if row == held { 0 } else { 16 }));
                }
                // The multiplexer turns as in a scan.
                let [a, b] = select.map(|line| 1 << line | 1u32 << (line + 16));
                assert_eq!(word & (a | b), scanned & (a | b));
            }
        }
        assert_eq!(pattern::holding(rows, select, None), scanned);
    }
}

#[test]
fn pins_are_unique_and_rows_are_outputs() {
    for (pins, rows, select) in
        [(&G431[..], G431_ROWS, G431_SELECT), (&F411[..], F411_ROWS, F411_SELECT)]
    {
        let mut places: Vec<_> = pins.iter().map(|pin| (pin.port, pin.number)).collect();
        places.sort_unstable();
        assert!(places.windows(2).all(|pair| pair[0] != pair[1]));
        for number in rows.into_iter().chain(select) {
            let pin = pins.iter().find(|pin| (pin.port, pin.number) == (1, number)).unwrap();
            assert_eq!(pin.mode, Mode::Output, "{}", pin.role);
        }
    }
}

#[test]
fn moder_changes_only_listed_pins() {
    let pin = |number, mode| Pin { port: 1, number, mode, function: "", role: "" };
    let pins = [pin(0, Mode::Analogue), pin(1, Mode::Output), pin(3, Mode::Other)];
    assert_eq!(moder(&pins, 1, 0b1010_1100), 0b1010_0111);
    assert_eq!(moder(&pins, 0, 0b1010_1100), 0b1010_1100);
    // Reset value of port A: SWD on 13 and 14, the rest analogue (RM0440 §9.4.1).
    assert_eq!(moder(&G431, 0, 0xABFF_FFFF), 0xABFD_FFFF);
}

#[test]
fn sfh3010_settles_to_12_bits_in_26500_ns() {
    // τ = t_r / ln 9, and e^(−t/τ) = 2^−12.
    let exact = 7_000.0 / 9f64.ln() * 4096f64.ln();
    assert!((f64::from(settle::DEFAULT_NS) - exact).abs() < 2.0, "{exact}");
    assert!(f64::from(settle::DEFAULT_NS) >= exact);
    assert_eq!(settle::DEFAULT_NS, 26_500);
}
