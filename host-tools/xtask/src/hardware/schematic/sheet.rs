//! Sheet of a schematic in KiCad's format (version 20211123, KiCad 6 and later).
//!
//! Places are in units of 1.27 mm, y downwards.

use std::fmt::Write as _;

use super::library::{Symbol, UNIT_MM, symbols};

/// Point on the sheet.
pub type Point = (i32, i32);

/// Sheet that is drawn on.
pub struct Sheet {
    library: Vec<Symbol>,
    items: String,
    instances: String,
    count: u64,
    supplies: u32,
}

/// Part on the sheet, with the ends of its pins.
pub struct Placed {
    pins: Vec<(String, Point)>,
}

impl Placed {
    /// End of the pin with this number.
    ///
    /// # Panics
    /// The symbol has no such pin.
    #[must_use]
    pub fn pin(&self, number: &str) -> Point {
        let pin = self.pins.iter().find(|(other, _)| other == number);
        pin.unwrap_or_else(|| panic!("no pin {number}")).1
    }
}

/// Part to place.
pub struct Part<'a> {
    /// Name of its symbol.
    pub symbol: &'a str,
    /// Unit of its symbol.
    pub unit: u32,
    /// Reference, such as R1.
    pub reference: &'a str,
    /// Value or order name.
    pub value: &'a str,
    /// Footprint in KiCad's own libraries or the project's; a supply has none.
    pub footprint: &'a str,
}

impl Sheet {
    /// Creates an empty sheet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            library: symbols(),
            items: String::new(),
            instances: String::new(),
            count: 0,
            supplies: 0,
        }
    }

    /// Next identifier; the same drawing has the same ones.
    fn uuid(&mut self) -> String {
        self.count += 1;
        format!("7a0e1000-0000-4000-8000-{:012x}", self.count)
    }

    fn item(&mut self, text: std::fmt::Arguments) {
        let _ = writeln!(self.items, "  {text}");
    }

    /// Places a part turned counter-clockwise by `angle` degrees.
    pub fn place(&mut self, part: &Part, (x, y): Point, angle: u32) -> Placed {
        let Some(symbol) = self.library.iter().find(|symbol| symbol.name == part.symbol).cloned()
        else {
            panic!("no symbol {}", part.symbol)
        };
        let turned = |(px, py): Point| match angle {
            90 => (x - py, y - px),
            180 => (x - px, y + py),
            270 => (x + py, y + px),
            _ => (x + px, y - py),
        };
        let pins: Vec<_> = symbol
            .pins
            .iter()
            .filter(|pin| pin.unit == part.unit)
            .map(|pin| (pin.number.clone(), turned(pin.at)))
            .collect();
        let uuid = self.uuid();
        let (mx, my) = (mm(x), mm(y));
        let upright = angle.is_multiple_of(180);
        // Names stand above a box and above a lying part, and right of an upright one.
        let (name, value, justify) = if symbol.power {
            let down = if part.value == "GND" { 3.0 } else { -3.0 };
            ((mx, my), (mx, my + down * UNIT_MM), "")
        } else if symbol.labelled {
            let body = symbol.body.iter().filter(|(unit, _)| *unit == part.unit);
            let corners: Vec<Point> = body.flat_map(|(_, line)| line.clone()).map(turned).collect();
            let left = corners.iter().map(|at| at.0).min().unwrap_or(x);
            let top = corners.iter().map(|at| at.1).min().unwrap_or(y);
            // Supplies stand above the pins on the top side.
            let above = pins.iter().filter(|(_, at)| at.1 < top).map(|(_, at)| at.0 + 3).max();
            let (left, top) = (mm(above.unwrap_or(left)), mm(top) - 1.0);
            ((left, top - 1.8), (left, top), " (justify left)")
        } else if upright {
            let beside = mx + if symbol.name == "LED" { 4.6 } else { 2.2 };
            ((beside, my - 0.9), (beside, my + 0.9), " (justify left)")
        } else {
            ((mx, my - 4.0), (mx, my - 2.1), "")
        };
        let hidden = if symbol.power { " hide" } else { "" };
        let flag = if part.symbol == "PWR_FLAG" { " hide" } else { "" };
        let in_bom = if symbol.power { "no" } else { "yes" };
        let mut text = format!(
            "(symbol (lib_id \"taxel:{}\") (at {mx:.2} {my:.2} {angle}) (unit {}) (in_bom {in_bom}) (on_board yes) (uuid {uuid})\n",
            part.symbol, part.unit
        );
        let turn = if upright { 0 } else { 90 };
        for (id, key, value, (px, py), effects) in [
            (
                0,
                "Reference",
                part.reference,
                name,
                format!("(font (size 1.1 1.1)){justify}{hidden}"),
            ),
            (1, "Value", part.value, value, format!("(font (size 1.1 1.1)){justify}{flag}")),
            (2, "Footprint", part.footprint, (mx, my), "(font (size 1.27 1.27)) hide".to_owned()),
            (3, "Datasheet", "", (mx, my), "(font (size 1.27 1.27)) hide".to_owned()),
        ] {
            let _ = writeln!(
                text,
                "    (property \"{key}\" \"{value}\" (id {id}) (at {px:.2} {py:.2} {turn}) (effects {effects}))"
            );
        }
        for (number, _) in &pins {
            let id = self.uuid();
            let _ = writeln!(text, "    (pin \"{number}\" (uuid {id}))");
        }
        self.item(format_args!("{text}  )"));
        let _ = writeln!(
            self.instances,
            "    (path \"/{uuid}\" (reference \"{}\") (unit {}) (value \"{}\") (footprint \"{}\"))",
            part.reference, part.unit, part.value, part.footprint
        );
        Placed { pins }
    }

    /// Places a supply's symbol on a wire's end.
    pub fn supply(&mut self, name: &str, at: Point) {
        self.supplies += 1;
        let prefix = if name == "PWR_FLAG" { "#FLG" } else { "#PWR" };
        let reference = format!("{prefix}{:03}", self.supplies);
        let part =
            Part { symbol: name, unit: 1, reference: &reference, value: name, footprint: "" };
        let _ = self.place(&part, at, 0);
    }

    /// Draws wires from point to point.
    pub fn wire(&mut self, points: &[Point]) {
        for ends in points.windows(2) {
            let uuid = self.uuid();
            let [(ax, ay), (bx, by)] = [ends[0], ends[1]].map(|(x, y)| (mm(x), mm(y)));
            self.item(format_args!(
                "(wire (pts (xy {ax:.2} {ay:.2}) (xy {bx:.2} {by:.2})) (stroke (width 0) (type default) (color 0 0 0 0)) (uuid {uuid}))"
            ));
        }
    }

    /// Joins wires that meet in a point.
    pub fn junction(&mut self, (x, y): Point) {
        let uuid = self.uuid();
        self.item(format_args!(
            "(junction (at {:.2} {:.2}) (diameter 0) (color 0 0 0 0) (uuid {uuid}))",
            mm(x),
            mm(y)
        ));
    }

    /// Marks a pin that stays open.
    pub fn no_connect(&mut self, (x, y): Point) {
        let uuid = self.uuid();
        self.item(format_args!("(no_connect (at {:.2} {:.2}) (uuid {uuid}))", mm(x), mm(y)));
    }

    /// Names the net at a wire's end; the text goes left for 180, right for 0.
    pub fn label(&mut self, name: &str, (x, y): Point, angle: u32) {
        let uuid = self.uuid();
        let justify = if angle == 180 { "right" } else { "left" };
        self.item(format_args!(
            "(label \"{name}\" (at {:.2} {:.2} {angle}) (effects (font (size 1.1 1.1)) (justify {justify} bottom)) (uuid {uuid}))",
            mm(x),
            mm(y)
        ));
    }

    /// Draws a frame with a title around a block.
    pub fn block(&mut self, title: &str, (x, y): Point, (width, height): Point) {
        let uuid = self.uuid();
        let corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)];
        let points: Vec<_> = corners.map(|(x, y)| format!("(xy {:.2} {:.2})", mm(x), mm(y))).into();
        self.item(format_args!(
            "(polyline (pts {}) (stroke (width 0.15) (type dash) (color 0 0 0 0)) (uuid {uuid}))",
            points.join(" ")
        ));
        self.text(title, (x + 2, y + 4), 2.5);
    }

    /// Writes a text.
    pub fn text(&mut self, text: &str, (x, y): Point, size: f64) {
        let uuid = self.uuid();
        self.item(format_args!(
            "(text \"{text}\" (at {:.2} {:.2} 0) (effects (font (size {size} {size})) (justify left bottom)) (uuid {uuid}))",
            mm(x),
            mm(y)
        ));
    }

    /// Returns the file of the schematic.
    #[must_use]
    pub fn file(&self, title: &str, comment: &str) -> String {
        let library: String = self.library.iter().map(|symbol| symbol.text("taxel:")).collect();
        format!(
            "(kicad_sch (version 20211123) (generator eeschema)\n  (uuid 7a0e1000-0000-4000-8000-000000000000)\n  \
             (paper \"A2\")\n  (title_block (title \"{title}\") (company \"taxel\") (comment 1 \"{comment}\"))\n  \
             (lib_symbols\n{library}  )\n{}  (sheet_instances (path \"/\" (page \"1\")))\n  (symbol_instances\n{}  )\n)\n",
            self.items, self.instances
        )
    }
}

/// Millimetres of units.
fn mm(units: i32) -> f64 {
    f64::from(units) * UNIT_MM
}
