//! Footprint of LED and phototransistor, because none of KiCad's libraries fits the pitch.
//!
//! Pads of KiCad's `LED_SMD:LED_0603_1608Metric` reach over 2.45 mm and leave 0.05 mm between two
//! rows of 2.5 mm. These end where the frame's pocket does.

use scan_plan::finger::REFERENCE;

/// Name of the footprint, with its library in the project.
pub const NAME: &str = "taxel:SmartLED_0603";
/// Length of a pad in mm.
const PAD_MM: f64 = 0.7;

/// Returns the footprint's file. Pad 1 is the LED's cathode or the phototransistor's collector.
#[must_use]
pub fn file() -> String {
    let pair = REFERENCE.pair;
    let [length, width] = pair.package_mm;
    let middle = (pair.pads_mm() - PAD_MM) / 2.0;
    let (x, y) = (length / 2.0, width / 2.0);
    let outline = |layer: &str, x: f64, y: f64, line: f64| {
        format!(
            "  (fp_rect (start {:.3} {:.3}) (end {x:.3} {y:.3}) (layer \"{layer}\") (width {line}) (fill none))\n",
            -x, -y
        )
    };
    let pads = [("1", -middle), ("2", middle)].map(|(number, at)| {
        format!(
            "  (pad \"{number}\" smd rect (at {at:.3} 0) (size {PAD_MM} {width}) (layers \"F.Cu\" \"F.Paste\" \"F.Mask\"))\n"
        )
    });
    let text = |kind: &str, what: &str, y: f64, layer: &str| {
        format!(
            "  (fp_text {kind} \"{what}\" (at 0 {y}) (layer \"{layer}\") (effects (font (size 0.5 0.5) (thickness 0.08))))\n"
        )
    };
    let name = NAME.split_once(':').map_or(NAME, |(_, name)| name);
    format!(
        "(footprint \"{name}\" (version 20211014) (generator pcbnew) (layer \"F.Cu\")\n  (attr smd)\n{}{}{}{}{})\n",
        text("reference", "REF**", -1.2, "F.Fab"),
        text("value", name, 1.2, "F.Fab"),
        outline("F.Fab", x, y, 0.1),
        outline("F.CrtYd", pair.pads_mm() / 2.0 + 0.15, y + 0.1, 0.05),
        pads.concat(),
    )
}
