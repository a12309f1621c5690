//! Frame, plugs and tray with which a skin is cast, from the reference finger.
//!
//! The frame lies on the board and carries the skin; its windows are the facets' room. The plugs
//! fill the windows while the skin is cast, the tray gives its outer surface and thickness.

use scan_plan::finger::REFERENCE;
use taxel::scan::{COLS, PITCH, ROWS};

use super::mesh::{Block, Solid};

/// Width of the skin: the taxels and a rim on which it is glued, in mm.
pub const SKIN_MM: f64 = 16.0;
/// Width of the frame in mm.
pub const FRAME_MM: f64 = 24.0;
/// Distance of the screws from the middle, and width of their holes for M2, in mm.
pub const SCREW_MM: [f64; 2] = [10.2, 2.2];
/// Clearance between two parts in mm.
const CLEARANCE_MM: f64 = 0.1;
/// Thickness of the plugs' plate and of the tray's floor in mm.
const PLATE_MM: f64 = 3.0;
/// Depth to which the tray guides the frame in mm.
const GUIDE_MM: f64 = 1.5;

/// Middles of the taxels along a side in mm.
fn middles(count: usize) -> impl Iterator<Item = f64> + Clone {
    let pitch = f64::from(PITCH.0);
    (0..count).map(move |i| (i as f64 - (count as f64 - 1.0) / 2.0) * pitch)
}

/// Middles of all taxels in mm.
fn taxels() -> impl Iterator<Item = [f64; 2]> {
    middles(ROWS).flat_map(|y| middles(COLS).map(move |x| [x, y]))
}

/// Box around a middle with these widths, between two heights.
#[must_use]
pub fn around([x, y]: [f64; 2], [width, length]: [f64; 2], [low, high]: [f64; 2]) -> Block {
    [[x - width / 2.0, y - length / 2.0, low], [x + width / 2.0, y + length / 2.0, high]]
}

/// Thickness of the frame: from the board to the facets.
#[must_use]
pub fn frame_mm() -> f64 {
    REFERENCE.pair.height_mm + REFERENCE.pair.gap_mm
}

/// Width across a pair's two packages with clearance, and along them with their solder.
#[must_use]
pub fn pocket_mm() -> [f64; 2] {
    let pair = REFERENCE.pair;
    [pair.separation_mm + pair.package_mm[1] + CLEARANCE_MM, pair.pads_mm()]
}

/// Frame on the board: a window for each facet, a wider pocket for its pair below.
#[must_use]
pub fn frame() -> Solid {
    let (height, facet) = (frame_mm(), REFERENCE.skin.facet_mm);
    let pocket = REFERENCE.pair.height_mm + CLEARANCE_MM;
    let mut solid = Solid::default().add(around([0.0; 2], [FRAME_MM; 2], [0.0, height]));
    for taxel in taxels() {
        solid = solid.cut(around(taxel, [facet; 2], [-1.0, height + 1.0])).cut(around(
            taxel,
            pocket_mm(),
            [-1.0, pocket],
        ));
    }
    let [middle, hole] = SCREW_MM;
    for at in [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]] {
        solid = solid.cut(around(at.map(|side| side * middle), [hole; 2], [-1.0, height + 1.0]));
    }
    solid
}

/// Plate with a plug for each window, as high as the frame.
#[must_use]
pub fn plugs() -> Solid {
    let facet = REFERENCE.skin.facet_mm - CLEARANCE_MM;
    let mut solid = Solid::default().add(around([0.0; 2], [FRAME_MM; 2], [0.0, PLATE_MM]));
    for taxel in taxels() {
        solid = solid.add(around(taxel, [facet; 2], [PLATE_MM, PLATE_MM + frame_mm()]));
    }
    solid
}

/// Tray: the skin's room, a ledge on which the frame stops, and grooves for what is too much.
#[must_use]
pub fn tray() -> Solid {
    let depth = REFERENCE.skin.depth_mm;
    let (ledge, top) = (PLATE_MM + depth, PLATE_MM + depth + GUIDE_MM);
    let guide = FRAME_MM + 2.0 * CLEARANCE_MM;
    let outside = FRAME_MM + 6.0;
    let mut solid = Solid::default()
        .add(around([0.0; 2], [outside; 2], [0.0, top]))
        .cut(around([0.0; 2], [SKIN_MM; 2], [PLATE_MM, top + 1.0]))
        .cut(around([0.0; 2], [guide; 2], [ledge, top + 1.0]));
    for side in [-6.0, 6.0] {
        solid = solid
            .cut(around([side, 0.0], [1.5, outside + 2.0], [ledge - 1.0, top + 1.0]))
            .cut(around([0.0, side], [outside + 2.0, 1.5], [ledge - 1.0, top + 1.0]));
    }
    solid
}

/// Names and meshes of all parts.
#[must_use]
pub fn files() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("frame.stl", frame().stl("taxel frame, mm")),
        ("plugs.stl", plugs().stl("taxel plugs, mm")),
        ("tray.stl", tray().stl("taxel tray, mm")),
    ]
}

/// Picture of the parts above each other.
#[must_use]
pub fn picture() -> String {
    super::mesh::picture(&[
        ("tray: outer surface of the skin", tray(), [0.0; 3]),
        ("frame: stays under the skin", frame(), [0.0, 0.0, 50.0]),
        ("plugs: fill the windows", plugs(), [0.0, 0.0, 92.0]),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::mesh::tests::volume;
    use crate::run::root;

    #[test]
    fn meshes_are_closed_and_have_the_fingers_volumes() {
        let of = |name: &str| volume(&std::fs::read(root().join("docs/mould").join(name)).unwrap());
        let (pair, skin) = (REFERENCE.pair, REFERENCE.skin);
        let height = pair.height_mm + pair.gap_mm;
        let [across, along] = pocket_mm();
        let pocket = pair.height_mm + CLEARANCE_MM;
        // A pocket and a window cross in what both of them cut.
        let common = skin.facet_mm.min(across) * skin.facet_mm.min(along);
        let window = skin.facet_mm * skin.facet_mm * height + (across * along - common) * pocket;
        let frame = (FRAME_MM * FRAME_MM - 4.0 * 2.2 * 2.2) * height - 16.0 * window;
        assert!((of("frame.stl") - frame).abs() < 0.2, "{} {frame}", of("frame.stl"));
        let plug = (skin.facet_mm - CLEARANCE_MM).powi(2) * height;
        let plugs = FRAME_MM * FRAME_MM * PLATE_MM + 16.0 * plug;
        assert!((of("plugs.stl") - plugs).abs() < 0.2, "{} {plugs}", of("plugs.stl"));
        // Silicone that the tray holds below the frame, without the grooves.
        let room = SKIN_MM * SKIN_MM * skin.depth_mm;
        let guide = (FRAME_MM + 0.2).powi(2) * GUIDE_MM;
        let whole = (FRAME_MM + 6.0).powi(2) * (PLATE_MM + skin.depth_mm + GUIDE_MM);
        let grooves = whole - room - guide - of("tray.stl");
        assert!((50.0..150.0).contains(&grooves), "{grooves}");
    }

    #[test]
    fn walls_are_those_of_the_page() {
        let (pitch, pair) = (f64::from(PITCH.0), REFERENCE.pair);
        let page = std::fs::read_to_string(root().join("docs/build-a-finger.md")).unwrap();
        let page = page.split_whitespace().collect::<Vec<_>>().join(" ");
        let [across, along] = pocket_mm().map(|pocket| pitch - pocket);
        let carries = pitch - REFERENCE.skin.facet_mm;
        assert!(carries >= 0.6 - 1e-9 && along >= 0.4 - 1e-9, "{carries} {along}");
        // The pitch leaves no more than 0.3 mm between two pairs.
        let most = pitch - pair.separation_mm - pair.package_mm[1];
        assert!(across >= 0.2 - 1e-9 && most < 0.4, "{across} {most}");
        let [length, width] = pair.package_mm;
        for said in [
            format!("{carries:.1} mm under the skin, {along:.1} mm between two rows"),
            format!("{across:.1} mm between two pairs of a row"),
            format!("{most:.1} mm at most"),
            format!("{:.2} mm beside a package", CLEARANCE_MM / 2.0),
            format!("{:.2} mm high", pair.height_mm + CLEARANCE_MM),
            format!("pads end {:.1} mm beyond", pair.toe_mm),
            format!("{length} mm × {width} mm × {} mm", pair.height_mm),
            format!("{:.1} mm are left", pair.separation_mm - width),
        ] {
            assert!(page.contains(&said), "{said}");
        }
        // The skin covers all windows and a rim, inside the screws.
        let windows = 3.0 * pitch + REFERENCE.skin.facet_mm;
        assert!(SKIN_MM >= windows + 6.0 && SCREW_MM[0] - SCREW_MM[1] / 2.0 > SKIN_MM / 2.0);
    }
}
