//! Controller, supply, USB and debug of the schematic.

use scan_plan::finger::REFERENCE;
use scan_plan::pins::G431;

use super::board::{Board, net, port};
use super::sheet::{Part, Point};

impl Board {
    /// Draws the controller with a label on each pin that the firmware uses.
    pub(super) fn controller(&mut self, (x, y): Point) {
        self.sheet.block("Controller", (x - 62, y - 70), (128, 108));
        let footprint = "Package_QFP:LQFP-48_7x7mm_P0.5mm";
        let part = self.part("STM32G431CBT6", "U5", "STM32G431CBT6", footprint, (x, y));
        let symbols = super::library::symbols();
        let pins =
            symbols.iter().find(|symbol| symbol.name == "STM32G431CBT6").map(|symbol| &symbol.pins);
        for pin in pins.into_iter().flatten() {
            let at = part.pin(&pin.number);
            let end = |by: i32| (at.0 + if pin.angle == 0 { -by } else { by }, at.1);
            let name = match (pin.name.as_str(), G431.iter().find(|used| port(used) == pin.name)) {
                ("VBAT" | "VDD", _) => {
                    self.sheet.supply("VDD", at);
                    continue;
                }
                ("VDDA" | "VREF+", _) => {
                    self.sheet.supply("VDDA", at);
                    continue;
                }
                ("VSS" | "VSSA", _) => {
                    self.sheet.supply("GND", at);
                    continue;
                }
                ("NRST", _) => "NRST".to_owned(),
                (_, Some(used)) => net(used),
                (_, None) => {
                    self.sheet.no_connect(at);
                    continue;
                }
            };
            self.sheet.wire(&[at, end(3)]);
            self.sheet.label(&name, end(3), if pin.angle == 0 { 180 } else { 0 });
        }
        for (i, (value, supply)) in [
            ("100 nF X7R", "VDD"),
            ("100 nF X7R", "VDD"),
            ("100 nF X7R", "VDD"),
            ("100 nF X7R", "VDD"),
            ("4.7 µF X5R", "VDD"),
            ("100 nF X7R", "VDDA"),
            ("1 µF X7R", "VDDA"),
            ("100 nF X7R", "VDDA"),
            ("1 µF X7R", "VDDA"),
        ]
        .into_iter()
        .enumerate()
        {
            self.decouple(value, supply, (x - 54 + 13 * i as i32, y - 52));
        }
    }

    /// Draws the regulator and the filter of the analogue supply.
    pub(super) fn supply(&mut self, (x, y): Point) {
        let supply = REFERENCE.supply;
        self.sheet.block("Supply", (x - 4, y - 4), (110, 38));
        let middle = y + 14;
        let part = self.part(
            "MCP1700",
            "U6",
            supply.regulator,
            "Package_TO_SOT_SMD:SOT-23",
            (x + 34, middle),
        );
        let (input, output) = (part.pin("3"), part.pin("2"));
        self.sheet.supply("GND", part.pin("1"));
        let before = self.capacitor("1 µF X7R", (x + 14, input.1 + 5), 0);
        let after = self.capacitor("1 µF X7R", (x + 52, output.1 + 5), 0);
        let start = (x + 6, input.1);
        self.sheet.wire(&[start, (x + 14, input.1), (x + 20, input.1), input]);
        self.sheet.wire(&[(x + 14, input.1), before.pin("1")]);
        self.sheet.junction((x + 14, input.1));
        self.sheet.supply("VBUS", start);
        let flag = (x + 20, input.1);
        self.sheet.supply("PWR_FLAG", flag);
        self.sheet.supply("GND", before.pin("2"));
        self.sheet.supply("GND", after.pin("2"));
        let bead_at = x + 74;
        let end = (x + 92, output.1);
        let bead = self.sheet.place(
            &Part {
                symbol: "Ferrite",
                unit: 1,
                reference: "FB1",
                value: supply.bead,
                footprint: "Inductor_SMD:L_0603_1608Metric",
            },
            (bead_at, output.1),
            90,
        );
        let node = (x + 52, output.1);
        self.sheet.wire(&[output, node, (x + 62, output.1), bead.pin("1")]);
        self.sheet.wire(&[node, after.pin("1")]);
        self.sheet.junction(node);
        self.sheet.wire(&[(x + 62, output.1), (x + 62, output.1 - 3)]);
        self.sheet.junction((x + 62, output.1));
        self.sheet.supply("VDD", (x + 62, output.1 - 3));
        self.sheet.wire(&[bead.pin("2"), (x + 84, output.1), end]);
        self.sheet.supply("VDDA", end);
        self.sheet.supply("PWR_FLAG", (x + 84, output.1));
        let ground = (x + 92, y + 24);
        self.sheet.wire(&[ground, (x + 84, y + 24)]);
        self.sheet.supply("GND", ground);
        self.sheet.supply("PWR_FLAG", (x + 84, y + 24));
    }

    /// Draws the USB socket and its protection.
    pub(super) fn usb(&mut self, (x, y): Point) {
        self.sheet.block("USB", (x - 4, y - 4), (94, 62));
        let socket = self.part(
            "USB4105",
            "J5",
            "USB4105-GF-A",
            "Connector_USB:USB_C_Receptacle_GCT_USB4105-xx-A_16P_TopMnt_Horizontal",
            (x + 12, y + 26),
        );
        let right = socket.pin("A4").0 + 3;
        // Pins of one net meet on an upright wire.
        for (numbers, supply) in [
            (&["A4", "A9", "B4", "B9"][..], "VBUS"),
            (&["A1", "A12", "B1", "B12", "S1"][..], "GND"),
        ] {
            let ends: Vec<Point> =
                numbers.iter().map(|number| (right, socket.pin(number).1)).collect();
            for (number, end) in numbers.iter().zip(&ends) {
                self.sheet.wire(&[socket.pin(number), *end]);
            }
            self.sheet.wire(&ends);
            ends[1..ends.len() - 1].iter().for_each(|end| self.sheet.junction(*end));
            self.sheet.supply(supply, if supply == "GND" { ends[ends.len() - 1] } else { ends[0] });
        }
        for (numbers, name) in [(["A6", "B6"], "USB_DP"), (["A7", "B7"], "USB_DM")] {
            let ends = numbers.map(|number| (right, socket.pin(number).1));
            for (number, end) in numbers.iter().zip(ends) {
                self.sheet.wire(&[socket.pin(number), end]);
            }
            self.sheet.wire(&ends);
            self.sheet.wire(&[ends[0], (right + 2, ends[0].1)]);
            self.sheet.junction(ends[0]);
            self.sheet.label(name, (right + 2, ends[0].1), 0);
        }
        for number in ["A8", "B8"] {
            self.sheet.no_connect(socket.pin(number));
        }
        for (number, at) in [("A5", x + 50), ("B5", x + 62)] {
            let pin = socket.pin(number);
            let resistor = self.resistor("5.1 kΩ", (at, y + 27), 0);
            self.sheet.wire(&[pin, (at, pin.1), resistor.pin("1")]);
            self.sheet.supply("GND", resistor.pin("2"));
        }
        let array = self.part(
            "USBLC6",
            "U7",
            "USBLC6-2SC6",
            "Package_TO_SOT_SMD:SOT-23-6",
            (x + 62, y + 47),
        );
        self.sheet.supply("VBUS", array.pin("5"));
        self.sheet.supply("GND", array.pin("2"));
        for (numbers, name) in [(["1", "6"], "USB_DM"), (["3", "4"], "USB_DP")] {
            for (number, by) in numbers.into_iter().zip([-3, 3]) {
                let pin = array.pin(number);
                self.sheet.wire(&[pin, (pin.0 + by, pin.1)]);
                self.sheet.label(name, (pin.0 + by, pin.1), if by < 0 { 180 } else { 0 });
            }
        }
    }

    /// Draws probe, reset, boot button and status LED.
    pub(super) fn debug(&mut self, (x, y): Point) {
        self.sheet.block("Debug, boot, status", (x - 14, y - 16), (70, 78));
        let probe = self.part(
            "TC2030",
            "J6",
            "TC2030-NL",
            "Connector:Tag-Connect_TC2030-IDC-NL_2x03_P1.27mm_Vertical",
            (x, y),
        );
        for (number, name) in [("2", "SWDIO"), ("3", "NRST"), ("4", "SWCLK")] {
            let pin = probe.pin(number);
            self.sheet.wire(&[pin, (pin.0 + 3, pin.1)]);
            self.sheet.label(name, (pin.0 + 3, pin.1), 0);
        }
        let (supply, ground) = (probe.pin("1"), probe.pin("5"));
        self.sheet.wire(&[supply, (supply.0 + 3, supply.1), (supply.0 + 3, supply.1 - 2)]);
        self.sheet.supply("VDD", (supply.0 + 3, supply.1 - 2));
        self.sheet.wire(&[ground, (ground.0 + 14, ground.1), (ground.0 + 14, ground.1 + 2)]);
        self.sheet.supply("GND", (ground.0 + 14, ground.1 + 2));
        self.sheet.no_connect(probe.pin("6"));
        let reset = self.capacitor("100 nF X7R", (x + 36, y), 0);
        let end = (x + 36, y - 5);
        self.sheet.wire(&[reset.pin("1"), end]);
        self.sheet.label("NRST", end, 0);
        self.sheet.supply("GND", reset.pin("2"));

        let (x, y) = (x + 2, y + 26);
        let button =
            self.part("Button", "SW1", "B3U-1000P", "Button_Switch_SMD:SW_SPST_B3U-1000P", (x, y));
        let down = self.resistor("10 kΩ", (x, y + 12), 0);
        let node = (x, y + 6);
        self.sheet.supply("VDD", button.pin("1"));
        self.sheet.wire(&[button.pin("2"), node, down.pin("1")]);
        self.sheet.wire(&[node, (x + 8, node.1)]);
        self.sheet.junction(node);
        self.sheet.label("BOOT0", (x + 8, node.1), 0);
        self.sheet.supply("GND", down.pin("2"));
        let line = self.resistor("1 kΩ", (x + 34, y + 2), 0);
        let footprint = "LED_SMD:LED_0603_1608Metric";
        let light = self.part("LED", "D17", "LTST-C191KGKT", footprint, (x + 34, y + 12));
        self.sheet.wire(&[line.pin("2"), light.pin("2")]);
        self.sheet.supply("GND", light.pin("1"));
        let end = (x + 34, y - 3);
        self.sheet.wire(&[line.pin("1"), end]);
        self.sheet.label("STATUS_LED", end, 0);
    }
}
