//! Symbols of the schematic, drawn here so that the file opens without any library.
//!
//! Lengths are in half grid units of 1.27 mm, y upwards as in KiCad's libraries.

use std::fmt::Write as _;

use super::chips::{amplifier, controller, quad};

/// Millimetres of a length unit.
pub const UNIT_MM: f64 = 1.27;

/// Pin of a symbol.
#[derive(Clone, Debug)]
pub struct Pin {
    /// Number on the part.
    pub number: String,
    /// Name on the symbol; `~` for none.
    pub name: String,
    /// KiCad's electrical type, which its electrical rule check reads.
    pub kind: &'static str,
    /// End of the pin, where a wire begins.
    pub at: (i32, i32),
    /// Direction from the end to the body: 0 right, 90 up, 180 left, 270 down.
    pub angle: u32,
    /// Unit of the part, from 1.
    pub unit: u32,
}

/// Symbol of a part.
#[derive(Clone, Debug)]
pub struct Symbol {
    /// Name in the library.
    pub name: &'static str,
    /// Letters of its references.
    pub prefix: &'static str,
    /// Pins of all units.
    pub pins: Vec<Pin>,
    /// Lines of each unit's body, closed where the first point is the last.
    pub body: Vec<(u32, Vec<(i32, i32)>)>,
    /// Whether names and numbers of the pins are shown.
    pub labelled: bool,
    /// Whether the symbol names a supply.
    pub power: bool,
}

/// Length of every pin.
const PIN: i32 = 2;

pub(super) fn pin(number: &str, name: &str, kind: &'static str, at: (i32, i32), angle: u32) -> Pin {
    Pin { number: number.to_owned(), name: name.to_owned(), kind, at, angle, unit: 1 }
}

fn simple(
    name: &'static str,
    prefix: &'static str,
    pins: Vec<Pin>,
    lines: &[&[(i32, i32)]],
) -> Symbol {
    let body = lines.iter().map(|line| (1, line.to_vec())).collect();
    Symbol { name, prefix, pins, body, labelled: false, power: false }
}

/// Two-pole part with its pins above and below.
fn two_pole(
    name: &'static str,
    prefix: &'static str,
    pins: [&str; 2],
    lines: &[&[(i32, i32)]],
) -> Symbol {
    let [top, bottom] = pins;
    let pins =
        vec![pin("1", top, "passive", (0, 3), 270), pin("2", bottom, "passive", (0, -3), 90)];
    simple(name, prefix, pins, lines)
}

/// Box with named pins on its four sides: number, name, kind.
pub(super) fn boxed(
    name: &'static str,
    prefix: &'static str,
    half: (i32, i32),
    sides: [&[(&str, &str, &'static str)]; 4],
) -> Symbol {
    let (w, h) = half;
    let [left, right, top, bottom] = sides;
    let mut pins = Vec::new();
    let down = |i: usize| h - 2 - 2 * i as i32;
    let across = |i: usize| 4 - w + 4 * i as i32;
    for (i, (number, name, kind)) in left.iter().enumerate().filter(|(_, p)| !p.0.is_empty()) {
        pins.push(pin(number, name, kind, (-w - PIN, down(i)), 0));
    }
    for (i, (number, name, kind)) in right.iter().enumerate().filter(|(_, p)| !p.0.is_empty()) {
        pins.push(pin(number, name, kind, (w + PIN, down(i)), 180));
    }
    for (i, (number, name, kind)) in top.iter().enumerate() {
        pins.push(pin(number, name, kind, (across(i), h + PIN), 270));
    }
    for (i, (number, name, kind)) in bottom.iter().enumerate() {
        pins.push(pin(number, name, kind, (across(i), -h - PIN), 90));
    }
    let outline = vec![(-w, h), (w, h), (w, -h), (-w, -h), (-w, h)];
    Symbol { name, prefix, pins, body: vec![(1, outline)], labelled: true, power: false }
}

/// Symbol that puts its pin on a supply's net.
fn supply(name: &'static str) -> Symbol {
    let pins = vec![pin("1", name, "power_in", (0, 0), if name == "GND" { 270 } else { 90 })];
    let lines: &[&[(i32, i32)]] = if name == "GND" {
        &[&[(0, 0), (0, -1), (1, -1), (0, -2), (-1, -1), (0, -1)]]
    } else {
        &[&[(0, 0), (0, 2)], &[(-1, 1), (0, 2), (1, 1)]]
    };
    Symbol { power: true, ..simple(name, "#PWR", pins, lines) }
}

pub(super) const IO: &str = "bidirectional";
pub(super) const IN: &str = "input";
const PASSIVE: &str = "passive";
pub(super) const POWER: &str = "power_in";

/// All symbols.
#[must_use]
pub fn symbols() -> Vec<Symbol> {
    let led: &[&[(i32, i32)]] = &[
        &[(-1, 1), (1, 1), (0, -1), (-1, 1)],
        &[(-1, -1), (1, -1)],
        &[(0, 1), (0, 3)],
        &[(2, 1), (3, 0)],
        &[(2, 0), (3, -1)],
    ];
    let transistor = |light: bool| {
        let mut lines: Vec<&[(i32, i32)]> = vec![
            &[(-1, 2), (-1, -2)],
            &[(-1, 1), (0, 2), (0, 4)],
            &[(-1, -1), (0, -2), (0, -4)],
            &[(0, -2), (-1, -2)],
        ];
        if light {
            lines.extend([&[(-4, 2), (-2, 1)][..], &[(-4, 1), (-2, 0)][..]]);
        }
        lines
    };
    let collector = |number| pin(number, "C", PASSIVE, (0, 4), 270);
    let emitter = |number| pin(number, "E", PASSIVE, (0, -4), 90);
    let mosfet: &[&[(i32, i32)]] = &[
        &[(-4, 0), (-2, 0)],
        &[(-2, 2), (-2, -2)],
        &[(-1, 2), (-1, -2)],
        &[(-1, 2), (0, 2), (0, 4)],
        &[(-1, -2), (0, -2), (0, -4)],
        &[(-1, 0), (0, 0), (0, -2)],
    ];
    vec![
        two_pole(
            "R",
            "R",
            ["~", "~"],
            &[
                &[(-1, 2), (1, 2), (1, -2), (-1, -2), (-1, 2)],
                &[(0, 2), (0, 3)],
                &[(0, -2), (0, -3)],
            ],
        ),
        two_pole(
            "C",
            "C",
            ["~", "~"],
            &[&[(-1, 0), (1, 0)], &[(-1, -1), (1, -1)], &[(0, 0), (0, 3)], &[(0, -1), (0, -3)]],
        ),
        two_pole(
            "Ferrite",
            "FB",
            ["~", "~"],
            &[
                &[(-1, 1), (0, 2), (1, 1), (1, -1), (0, -2), (-1, -1), (-1, 1)],
                &[(0, 2), (0, 3)],
                &[(0, -2), (0, -3)],
            ],
        ),
        // Numbered as the pads of KiCad's LEDs are.
        simple(
            "LED",
            "D",
            vec![pin("2", "A", PASSIVE, (0, 3), 270), pin("1", "K", PASSIVE, (0, -3), 90)],
            &[led, &[&[(0, -1), (0, -3)]]].concat(),
        ),
        two_pole("Button", "SW", ["~", "~"], &[&[(0, 3), (0, 1), (2, -1)], &[(0, -1), (0, -3)]]),
        simple("Phototransistor", "Q", vec![collector("1"), emitter("2")], &transistor(true)),
        simple(
            "NMOS",
            "Q",
            vec![
                pin("1", "G", IN, (-4, 0), 0),
                pin("3", "D", PASSIVE, (0, 4), 270),
                pin("2", "S", PASSIVE, (0, -4), 90),
            ],
            mosfet,
        ),
        quad(),
        amplifier(),
        boxed(
            "74HC4052",
            "U",
            (6, 11),
            [
                &[
                    ("12", "1Y0", PASSIVE),
                    ("14", "1Y1", PASSIVE),
                    ("15", "1Y2", PASSIVE),
                    ("11", "1Y3", PASSIVE),
                    ("", "", ""),
                    ("1", "2Y0", PASSIVE),
                    ("5", "2Y1", PASSIVE),
                    ("2", "2Y2", PASSIVE),
                    ("4", "2Y3", PASSIVE),
                ],
                &[
                    ("13", "1Z", PASSIVE),
                    ("", "", ""),
                    ("3", "2Z", PASSIVE),
                    ("", "", ""),
                    ("10", "S0", IN),
                    ("9", "S1", IN),
                    ("6", "E", IN),
                ],
                &[("16", "VCC", POWER)],
                &[("8", "GND", POWER), ("7", "VEE", POWER)],
            ],
        ),
        boxed(
            "ForceSensor",
            "J",
            (6, 7),
            [
                &[("1", "VDDA", PASSIVE), ("2", "GND", PASSIVE)],
                &[
                    ("3", "A", PASSIVE),
                    ("4", "B", PASSIVE),
                    ("5", "C", PASSIVE),
                    ("6", "D", PASSIVE),
                ],
                &[],
                &[],
            ],
        ),
        controller(),
        boxed(
            "MCP1700",
            "U",
            (5, 4),
            [&[("3", "VI", POWER)], &[("2", "VO", "power_out")], &[], &[("1", "GND", POWER)]],
        ),
        boxed(
            "USBLC6",
            "U",
            (5, 5),
            [
                &[("1", "IO1", PASSIVE), ("3", "IO2", PASSIVE)],
                &[("6", "IO1", PASSIVE), ("4", "IO2", PASSIVE)],
                &[("5", "VBUS", PASSIVE)],
                &[("2", "GND", PASSIVE)],
            ],
        ),
        boxed(
            "USB4105",
            "J",
            (7, 19),
            [
                &[],
                &[
                    ("A4", "VBUS", PASSIVE),
                    ("A9", "VBUS", PASSIVE),
                    ("B4", "VBUS", PASSIVE),
                    ("B9", "VBUS", PASSIVE),
                    ("A5", "CC1", PASSIVE),
                    ("B5", "CC2", PASSIVE),
                    ("A6", "D+", PASSIVE),
                    ("B6", "D+", PASSIVE),
                    ("A7", "D−", PASSIVE),
                    ("B7", "D−", PASSIVE),
                    ("A8", "SBU1", PASSIVE),
                    ("B8", "SBU2", PASSIVE),
                    ("A1", "GND", PASSIVE),
                    ("A12", "GND", PASSIVE),
                    ("B1", "GND", PASSIVE),
                    ("B12", "GND", PASSIVE),
                    ("S1", "SHIELD", PASSIVE),
                ],
                &[],
                &[],
            ],
        ),
        boxed(
            "TC2030",
            "J",
            (6, 7),
            [
                &[],
                &[
                    ("1", "VCC", PASSIVE),
                    ("2", "SWDIO", PASSIVE),
                    ("3", "NRST", PASSIVE),
                    ("4", "SWCLK", PASSIVE),
                    ("5", "GND", PASSIVE),
                    ("6", "SWO", PASSIVE),
                ],
                &[],
                &[],
            ],
        ),
        supply("GND"),
        supply("VDD"),
        supply("VDDA"),
        supply("VBUS"),
        Symbol {
            power: true,
            ..simple(
                "PWR_FLAG",
                "#FLG",
                vec![pin("1", "pwr", "power_out", (0, 0), 90)],
                &[&[(0, 0), (0, 1), (-1, 2), (0, 3), (1, 2), (0, 1)]],
            )
        },
    ]
}

impl Symbol {
    /// Symbol as KiCad writes it, with `library` before its name.
    #[must_use]
    pub fn text(&self, library: &str) -> String {
        let mm = |units: i32| f64::from(units) * UNIT_MM;
        let mut out = format!("    (symbol \"{library}{}\"", self.name);
        if self.power {
            out += " (power)";
        }
        if self.labelled {
            out += " (pin_names (offset 0.6))";
        } else {
            out += " (pin_numbers hide) (pin_names (offset 0) hide)";
        }
        let in_bom = if self.power { "no" } else { "yes" };
        let _ = writeln!(out, " (in_bom {in_bom}) (on_board yes)");
        for (id, (key, value)) in
            [("Reference", self.prefix), ("Value", self.name), ("Footprint", ""), ("Datasheet", "")]
                .into_iter()
                .enumerate()
        {
            let _ = writeln!(
                out,
                "      (property \"{key}\" \"{value}\" (id {id}) (at 0 0 0) (effects (font (size 1.27 1.27)) hide))"
            );
        }
        let units = self.pins.iter().map(|pin| pin.unit).max().unwrap_or(1);
        for unit in 1..=units {
            let _ = writeln!(out, "      (symbol \"{}_{unit}_1\"", self.name);
            for (_, line) in self.body.iter().filter(|(of, _)| *of == unit) {
                let points: Vec<String> =
                    line.iter().map(|(x, y)| format!("(xy {:.2} {:.2})", mm(*x), mm(*y))).collect();
                let fill = if self.labelled { "background" } else { "none" };
                let _ = writeln!(
                    out,
                    "        (polyline (pts {}) (stroke (width 0.2) (type default) (color 0 0 0 0)) (fill (type {fill})))",
                    points.join(" ")
                );
            }
            for pin in self.pins.iter().filter(|pin| pin.unit == unit) {
                // The lines of simple symbols reach to the pins' ends.
                let length = if self.labelled { mm(PIN) } else { 0.0 };
                let hide = if self.power { " hide" } else { "" };
                let font = "(effects (font (size 1 1)))";
                let _ = writeln!(
                    out,
                    "        (pin {} line (at {:.2} {:.2} {}) (length {length:.2}){hide} (name \"{}\" {font}) (number \"{}\" {font}))",
                    pin.kind,
                    mm(pin.at.0),
                    mm(pin.at.1),
                    pin.angle,
                    pin.name,
                    pin.number
                );
            }
            out += "      )\n";
        }
        out + "    )\n"
    }
}
