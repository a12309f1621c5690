//! Schematic of the STM32G431 board, drawn from the reference finger and the firmware's pin table.

use scan_plan::finger::REFERENCE;
use scan_plan::pins::Pin;
use taxel::scan::{COLS, ROWS};

use super::footprint;
use super::sheet::{Part, Placed, Point, Sheet};

/// Name of the net on a pin: its role, or its function where the chip gives it.
#[must_use]
pub fn net(pin: &Pin) -> String {
    let ours = ["ADC", "OPAMP", "GPIO"].iter().any(|begin| pin.function.starts_with(begin));
    if ours { pin.role.to_uppercase().replace(' ', "_") } else { pin.function.to_owned() }
}

/// Name of a pin on the chip.
#[must_use]
pub fn port(pin: &Pin) -> String {
    format!("P{}{}", char::from(b'A' + pin.port), pin.number)
}

const R0402: &str = "Resistor_SMD:R_0402_1005Metric";
const C0402: &str = "Capacitor_SMD:C_0402_1005Metric";
const C0603: &str = "Capacitor_SMD:C_0603_1608Metric";
/// Socket of a force sensor's cable: supply, ground and four midpoints.
const SENSOR_SOCKET: &str = "BM06B-SRSS-TB";
const JST_SH: &str = "Connector_JST:JST_SH_BM06B-SRSS-TB_1x06-1MP_P1.00mm_Vertical";

/// Board that is being drawn, with the numbers of its parts.
pub(super) struct Board {
    pub(super) sheet: Sheet,
    resistors: u32,
    capacitors: u32,
}

/// Ohms as the bill of materials writes them.
#[must_use]
pub fn ohms(ohm: f64) -> String {
    if ohm < 1_000.0 { format!("{ohm} Ω") } else { format!("{} kΩ", ohm / 1_000.0) }
}

/// Returns the schematic's file.
#[must_use]
pub fn file() -> String {
    let mut board = Board { sheet: Sheet::new(), resistors: 0, capacitors: 0 };
    for row in 0..ROWS {
        board.row(row, (30 + 54 * row as i32, 18));
    }
    for column in 0..COLS {
        let at = (24 + 110 * (column % 2) as i32, 69 + 38 * (column / 2) as i32);
        board.column(column, at);
    }
    board.reference((24, 148));
    board.sensors((24, 192));
    board.controller((310, 150));
    board.supply((252, 16));
    board.usb((366, 16));
    board.debug((400, 98));
    board.sheet.text(
        "Drawn by `cargo xtask hardware` from the reference finger and the firmware's pins; not measured on hardware.",
        (24, 286),
        2.0,
    );
    board.sheet.file("taxel finger, STM32G431", "docs/boards/stm32g431.md")
}

impl Board {
    pub(super) fn resistor(&mut self, value: &str, at: Point, angle: u32) -> Placed {
        self.resistors += 1;
        let reference = format!("R{}", self.resistors);
        let part = Part { symbol: "R", unit: 1, reference: &reference, value, footprint: R0402 };
        self.sheet.place(&part, at, angle)
    }

    pub(super) fn capacitor(&mut self, value: &str, at: Point, angle: u32) -> Placed {
        self.capacitors += 1;
        let reference = format!("C{}", self.capacitors);
        let footprint = if value.contains('µ') { C0603 } else { C0402 };
        let part = Part { symbol: "C", unit: 1, reference: &reference, value, footprint };
        self.sheet.place(&part, at, angle)
    }

    pub(super) fn part(
        &mut self,
        symbol: &str,
        reference: &str,
        value: &str,
        footprint: &str,
        at: Point,
    ) -> Placed {
        self.sheet.place(&Part { symbol, unit: 1, reference, value, footprint }, at, 0)
    }

    /// Draws a capacitor between two supplies.
    pub(super) fn decouple(&mut self, value: &str, supply: &str, at: Point) {
        let capacitor = self.capacitor(value, at, 0);
        self.sheet.supply(supply, capacitor.pin("1"));
        self.sheet.supply("GND", capacitor.pin("2"));
    }

    /// Draws a row: four LEDs, each with its resistor, and their switch.
    fn row(&mut self, row: usize, (x, y): Point) {
        let pair = REFERENCE.pair;
        self.sheet.block(&format!("LED row {row}"), (x - 10, y - 6), (52, 52));
        let bus = y + 22;
        let mut ends = Vec::new();
        for column in 0..COLS {
            let at = x + 11 * column as i32;
            let resistor = self.resistor(&format!("{} 1 %", ohms(pair.led_ohm)), (at, y + 9), 0);
            self.sheet.supply("VDDA", resistor.pin("1"));
            let reference = format!("D{}", row * COLS + column + 1);
            let led = self.part("LED", &reference, pair.led, footprint::NAME, (at, y + 17));
            self.sheet.wire(&[resistor.pin("2"), led.pin("2")]);
            self.sheet.wire(&[led.pin("1"), (at, bus)]);
            ends.push((at, bus));
        }
        let reference = format!("Q{}", row + 1);
        let switch =
            self.part("NMOS", &reference, "BSS138", "Package_TO_SOT_SMD:SOT-23", (x + 22, bus + 7));
        self.sheet.wire(&ends);
        [ends[1], ends[2]].into_iter().for_each(|end| self.sheet.junction(end));
        self.sheet.wire(&[ends[2], switch.pin("3")]);
        self.sheet.supply("GND", switch.pin("2"));
        let gate = switch.pin("1");
        let line = self.resistor("100 Ω", (x + 4, gate.1), 90);
        let down = self.resistor("100 kΩ", (x + 12, gate.1 + 5), 0);
        let node = (x + 12, gate.1);
        self.sheet.wire(&[line.pin("2"), node, gate]);
        self.sheet.wire(&[node, down.pin("1")]);
        self.sheet.junction(node);
        self.sheet.supply("GND", down.pin("2"));
        self.sheet.wire(&[(x - 1, gate.1), line.pin("1")]);
        self.sheet.label(&format!("LED_ROW_{row}"), (x - 1, gate.1), 180);
    }

    /// Draws a column: four phototransistors on an amplifier.
    fn column(&mut self, column: usize, (x, y): Point) {
        let parts = REFERENCE.column;
        self.sheet.block(
            &format!("Column {column}: transimpedance amplifier"),
            (x - 4, y - 3),
            (108, 36),
        );
        let bus = y + 14;
        let mut ends = Vec::new();
        for row in 0..ROWS {
            let at = x + 5 + 11 * row as i32;
            let reference = format!("Q{}", 5 + row * COLS + column);
            let receiver = self.part(
                "Phototransistor",
                &reference,
                REFERENCE.pair.phototransistor,
                footprint::NAME,
                (at, bus + 7),
            );
            self.sheet.wire(&[receiver.pin("1"), (at, bus)]);
            self.sheet.supply("GND", receiver.pin("2"));
            ends.push((at, bus));
        }
        let (middle, node) = (x + 64, (x + 52, bus));
        let footprint = "Package_SO:TSSOP-14_4.4x5mm_P0.65mm";
        let unit = column as u32 + 1;
        let part =
            Part { symbol: "TLV9064", unit, reference: "U1", value: parts.amplifier, footprint };
        let amplifier = self.sheet.place(&part, (middle, bus + 2), 0);
        let [minus, plus, out] =
            [["2", "3", "1"], ["6", "5", "7"], ["9", "10", "8"], ["13", "12", "14"]][column];
        ends.extend([node, amplifier.pin(minus)]);
        self.sheet.wire(&ends);
        ends[1..=4].iter().for_each(|end| self.sheet.junction(*end));
        let resistor = self.resistor(
            &format!("{} 0.1 % 25 ppm", ohms(parts.feedback_ohm)),
            (middle, y + 7),
            90,
        );
        let farad = format!("{:.0} pF C0G", 1e12 * parts.feedback_f);
        let capacitor = self.capacitor(&farad, (middle, y + 2), 90);
        let (left, right) = (node.0, middle + 10);
        self.sheet.wire(&[node, (left, y + 7), (left, y + 2), capacitor.pin("1")]);
        self.sheet.wire(&[(left, y + 7), resistor.pin("1")]);
        self.sheet.junction((left, y + 7));
        let output = (right, bus + 2);
        self.sheet.wire(&[capacitor.pin("2"), (right, y + 2), (right, y + 7), output]);
        self.sheet.wire(&[resistor.pin("2"), (right, y + 7)]);
        self.sheet.junction((right, y + 7));
        let line = self.resistor(&ohms(parts.pin_ohm), (right + 7, bus + 2), 90);
        self.sheet.wire(&[amplifier.pin(out), output, line.pin("1")]);
        self.sheet.junction(output);
        let end = (right + 14, bus + 2);
        self.sheet.wire(&[line.pin("2"), end]);
        self.sheet.label(&format!("COLUMN_{column}"), end, 0);
        let reference = (middle - 8, bus + 4);
        self.sheet.wire(&[amplifier.pin(plus), reference, (reference.0, bus + 8)]);
        self.sheet.label("COLUMN_REFERENCE", (reference.0, bus + 8), 0);
    }

    /// Draws the columns' reference, the bridges' bias and the amplifiers' supply.
    fn reference(&mut self, (x, y): Point) {
        let parts = REFERENCE.column;
        self.sheet.block("Columns' reference and supply", (x - 4, y - 4), (76, 38));
        let [high, low] = parts.divider_ohm.map(|ohm| format!("{} 0.1 %", ohms(ohm)));
        let top = self.resistor(&high, (x + 6, y + 10), 0);
        let bottom = self.resistor(&low, (x + 6, y + 20), 0);
        let filter = self.capacitor("100 nF X7R", (x + 20, y + 20), 0);
        let node = (x + 6, y + 15);
        self.sheet.supply("VDDA", top.pin("1"));
        self.sheet.wire(&[top.pin("2"), node, bottom.pin("1")]);
        self.sheet.wire(&[node, (x + 20, y + 15), filter.pin("1")]);
        self.sheet.wire(&[(x + 20, y + 15), (x + 24, y + 15)]);
        self.sheet.junction(node);
        self.sheet.junction((x + 20, y + 15));
        self.sheet.label("COLUMN_REFERENCE", (x + 24, y + 15), 0);
        self.sheet.supply("GND", bottom.pin("2"));
        self.sheet.supply("GND", filter.pin("2"));
        let part = Part {
            symbol: "TLV9064",
            unit: 5,
            reference: "U1",
            value: parts.amplifier,
            footprint: "Package_SO:TSSOP-14_4.4x5mm_P0.65mm",
        };
        let supply = self.sheet.place(&part, (x + 46, y + 18), 0);
        self.sheet.supply("VDDA", supply.pin("4"));
        self.sheet.supply("GND", supply.pin("11"));
        self.decouple("100 nF X7R", "VDDA", (x + 62, y + 18));

        let x = x + 80;
        self.sheet.block("Bridges' bias: VDDA/2", (x - 4, y - 4), (92, 38));
        let top = self.resistor("10 kΩ 0.1 %", (x + 6, y + 10), 0);
        let bottom = self.resistor("10 kΩ 0.1 %", (x + 6, y + 22), 0);
        let node = (x + 6, y + 16);
        self.sheet.supply("VDDA", top.pin("1"));
        self.sheet.supply("GND", bottom.pin("2"));
        self.sheet.wire(&[top.pin("2"), node, bottom.pin("1")]);
        self.sheet.junction(node);
        let buffer = self.part(
            "MCP6001",
            "U2",
            "MCP6001T-I/OT",
            "Package_TO_SOT_SMD:SOT-23-5",
            (x + 36, y + 18),
        );
        self.sheet.wire(&[node, buffer.pin("3")]);
        self.sheet.supply("VDDA", buffer.pin("5"));
        self.sheet.supply("GND", buffer.pin("2"));
        let out = buffer.pin("1");
        let corner = (out.0 + 4, out.1);
        self.sheet.wire(&[out, corner, (corner.0 + 4, out.1)]);
        self.sheet.junction(corner);
        let minus = buffer.pin("4");
        self.sheet.wire(&[
            corner,
            (corner.0, y + 28),
            (minus.0 - 2, y + 28),
            (minus.0 - 2, minus.1),
            minus,
        ]);
        self.sheet.label("BRIDGE_BIAS", (corner.0 + 4, out.1), 0);
        self.decouple("100 nF X7R", "VDDA", (x + 72, y + 18));
    }

    /// Draws the force sensors and their multiplexers.
    fn sensors(&mut self, (x, y): Point) {
        self.sheet.block("Force sensors, up to four", (x - 4, y - 6), (72, 88));
        for sensor in 0..4 {
            let reference = format!("J{}", sensor + 1);
            let at = (x + 20, y + 12 + 20 * sensor);
            let part = self.part("ForceSensor", &reference, SENSOR_SOCKET, JST_SH, at);
            let (high, low) = (part.pin("1"), part.pin("2"));
            self.sheet.wire(&[high, (high.0 - 6, high.1), (high.0 - 6, high.1 - 2)]);
            self.sheet.supply("VDDA", (high.0 - 6, high.1 - 2));
            self.sheet.wire(&[low, (low.0 - 6, low.1), (low.0 - 6, low.1 + 2)]);
            self.sheet.supply("GND", (low.0 - 6, low.1 + 2));
            for (number, letter) in (3..).zip("ABCD".chars()) {
                let pin = part.pin(&number.to_string());
                self.sheet.wire(&[pin, (pin.0 + 3, pin.1)]);
                self.sheet.label(&format!("SENSOR_{sensor}_{letter}"), (pin.0 + 3, pin.1), 0);
            }
        }
        let x = x + 76;
        self.sheet.block("Multiplexers", (x - 4, y - 6), (88, 88));
        for (chip, letters) in [["A", "B"], ["C", "D"]].into_iter().enumerate() {
            let at = (x + 30, y + 18 + 42 * chip as i32);
            let reference = format!("U{}", 3 + chip);
            let footprint = "Package_SO:TSSOP-16_4.4x5mm_P0.65mm";
            let part = self.part("74HC4052", &reference, "74HC4052PW", footprint, at);
            let inputs = [["12", "14", "15", "11"], ["1", "5", "2", "4"]];
            for ((numbers, letter), common) in inputs.into_iter().zip(letters).zip(["13", "3"]) {
                for (sensor, number) in numbers.into_iter().enumerate() {
                    let pin = part.pin(number);
                    self.sheet.wire(&[pin, (pin.0 - 3, pin.1)]);
                    self.sheet.label(&format!("SENSOR_{sensor}_{letter}"), (pin.0 - 3, pin.1), 180);
                }
                let pin = part.pin(common);
                self.sheet.wire(&[pin, (pin.0 + 3, pin.1)]);
                self.sheet.label(&format!("MIDPOINT_{letter}"), (pin.0 + 3, pin.1), 0);
            }
            for (number, line) in ["10", "9"].into_iter().zip(0..) {
                let pin = part.pin(number);
                self.sheet.wire(&[pin, (pin.0 + 3, pin.1)]);
                self.sheet.label(&format!("MULTIPLEXER_ADDRESS_{line}"), (pin.0 + 3, pin.1), 0);
            }
            let enable = part.pin("6");
            self.sheet.wire(&[enable, (enable.0 + 3, enable.1), (enable.0 + 3, enable.1 + 2)]);
            self.sheet.supply("GND", (enable.0 + 3, enable.1 + 2));
            self.sheet.supply("VDDA", part.pin("16"));
            self.sheet.supply("GND", part.pin("8"));
            self.sheet.supply("GND", part.pin("7"));
            self.decouple("100 nF X7R", "VDDA", (x + 68, at.1));
        }
    }
}
