//! Symbols of the amplifiers and the controller.

use super::library::{IN, IO, POWER, Pin, Symbol, boxed, pin};

/// Triangle of an amplifier.
fn triangle(unit: u32) -> (u32, Vec<(i32, i32)>) {
    (unit, vec![(-4, 4), (-4, -4), (4, 0), (-4, 4)])
}

/// Quad amplifier: four units and a unit of its supply.
pub(super) fn quad() -> Symbol {
    let units = [["2", "3", "1"], ["6", "5", "7"], ["9", "10", "8"], ["13", "12", "14"]];
    let mut pins = Vec::new();
    let mut body = Vec::new();
    for (unit, [minus, plus, out]) in (1..).zip(units) {
        let of = |number: &str, name: &str, kind, at, angle| Pin {
            unit,
            ..pin(number, name, kind, at, angle)
        };
        pins.push(of(minus, "−", IN, (-6, 2), 0));
        pins.push(of(plus, "+", IN, (-6, -2), 0));
        pins.push(of(out, "~", "output", (6, 0), 180));
        body.push(triangle(unit));
    }
    pins.push(Pin { unit: 5, ..pin("4", "V+", POWER, (0, 6), 270) });
    pins.push(Pin { unit: 5, ..pin("11", "V−", POWER, (0, -6), 90) });
    body.push((5, vec![(-2, 4), (2, 4), (2, -4), (-2, -4), (-2, 4)]));
    Symbol { name: "TLV9064", prefix: "U", pins, body, labelled: true, power: false }
}

pub(super) fn amplifier() -> Symbol {
    let pins = vec![
        pin("3", "+", IN, (-6, 2), 0),
        pin("4", "−", IN, (-6, -2), 0),
        pin("1", "~", "output", (6, 0), 180),
        pin("5", "V+", POWER, (-2, 5), 270),
        pin("2", "V−", POWER, (-2, -5), 90),
    ];
    Symbol {
        name: "MCP6001",
        prefix: "U",
        pins,
        body: vec![triangle(1)],
        labelled: true,
        power: false,
    }
}

/// STM32G431CBT6 in its LQFP48.
pub(super) fn controller() -> Symbol {
    let a = [
        "8", "9", "10", "11", "12", "13", "14", "15", "30", "31", "32", "33", "34", "37", "38",
        "39",
    ];
    let b = [
        "16", "17", "18", "40", "41", "42", "43", "44", "45", "46", "22", "25", "26", "27", "28",
        "29",
    ];
    let others =
        [("7", "NRST"), ("2", "PC13"), ("3", "PC14"), ("4", "PC15"), ("5", "PF0"), ("6", "PF1")];
    let port = |letter: char, numbers: [&'static str; 16]| -> Vec<(String, String)> {
        numbers
            .iter()
            .enumerate()
            .map(|(i, number)| ((*number).to_owned(), format!("P{letter}{i}")))
            .collect()
    };
    let left: Vec<(String, String)> = port('A', a)
        .into_iter()
        .chain([(String::new(), String::new())])
        .chain(others.map(|(number, name)| (number.to_owned(), name.to_owned())))
        .collect();
    let right = port('B', b);
    fn side(pins: &[(String, String)]) -> Vec<(&str, &str, &'static str)> {
        let kind = |name: &str| if name == "NRST" { IN } else { IO };
        pins.iter().map(|(number, name)| (number.as_str(), name.as_str(), kind(name))).collect()
    }
    boxed(
        "STM32G431CBT6",
        "U",
        (14, 25),
        [
            &side(&left),
            &side(&right),
            &[
                ("1", "VBAT", POWER),
                ("24", "VDD", POWER),
                ("36", "VDD", POWER),
                ("48", "VDD", POWER),
                ("21", "VDDA", POWER),
                ("20", "VREF+", POWER),
            ],
            &[
                ("23", "VSS", POWER),
                ("35", "VSS", POWER),
                ("47", "VSS", POWER),
                ("19", "VSSA", POWER),
            ],
        ],
    )
}
