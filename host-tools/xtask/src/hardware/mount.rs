//! Mount that carries a finger on a robot's flange, from the mould's frame.
//!
//! A plate on the flange of ISO 9409-1-50-4-M6 and four posts. The screws of the frame go through
//! the board into the posts, so that board and frame are held by the same four screws.

use std::fmt::Write as _;

use super::mesh::{Solid, picture};
use super::mould::{FRAME_MM, SCREW_MM, around, frame, frame_mm};

/// Diameter of the circle of the flange's screws in mm (ISO 9409-1-50-4-M6).
const FLANGE_MM: f64 = 50.0;
/// Width of the holes for the flange's screws, M6, in mm.
const FLANGE_HOLE_MM: f64 = 6.6;
/// Diameter of the head of an M6 socket screw in mm (ISO 4762).
const HEAD_MM: f64 = 10.0;
/// Width and thickness of the plate in mm.
const PLATE_MM: [f64; 2] = [50.0, 6.0];
/// Width of a post, and its height: room for parts and cable below the board, in mm.
const POST_MM: [f64; 2] = [5.0, 6.0];
/// Width of the hole that an M2 screw cuts its thread into, and its depth, in mm.
const PILOT_MM: [f64; 2] = [1.6, 5.0];
/// Thickness of the board in mm.
const BOARD_MM: f64 = 1.6;
/// Length of the frame's screws in mm: M2 × 8.
const SCREW_LENGTH_MM: f64 = 8.0;

/// Middles of four parts at this distance from both axes.
fn corners(distance: f64) -> [[f64; 2]; 4] {
    [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]].map(|at| at.map(|side| side * distance))
}

/// Distance of the flange's screws from both axes in mm.
fn flange_at() -> f64 {
    FLANGE_MM / 2.0 / std::f64::consts::SQRT_2
}

/// Plate with four holes for the flange and four posts for the frame's screws.
#[must_use]
pub fn mount() -> Solid {
    let [width, thickness] = PLATE_MM;
    let [post, room] = POST_MM;
    let [pilot, depth] = PILOT_MM;
    let top = thickness + room;
    let mut solid = Solid::default().add(around([0.0; 2], [width; 2], [0.0, thickness]));
    for at in corners(flange_at()) {
        solid = solid.cut(around(at, [FLANGE_HOLE_MM; 2], [-1.0, thickness + 1.0]));
    }
    for at in corners(SCREW_MM[0]) {
        solid = solid.add(around(at, [post; 2], [thickness, top])).cut(around(
            at,
            [pilot; 2],
            [top - depth, top + 1.0],
        ));
    }
    solid
}

/// Mount as a binary STL file.
#[must_use]
pub fn stl() -> Vec<u8> {
    mount().stl("taxel mount, mm")
}

/// Millimetres from the flange to the finger's surface.
#[must_use]
pub fn reach() -> f64 {
    let skin = scan_plan::finger::REFERENCE.skin.depth_mm;
    PLATE_MM[1] + POST_MM[1] + BOARD_MM + frame_mm() + skin
}

/// Dimensioned drawing, with the frame above the mount in a picture.
#[must_use]
pub fn drawing() -> String {
    let seen = picture(&[
        ("mount", mount(), [0.0; 3]),
        ("board", board(), [0.0, 0.0, 36.0]),
        ("frame, without its skin", frame(), [0.0, 0.0, 52.0]),
    ]);
    // The picture stands beside the plan, whose middle is the origin.
    let inner =
        seen.replacen("<svg ", "<svg x=\"-440\" y=\"-330\" width=\"560\" height=\"640\" ", 1);
    let mut out = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-450 -340 1330 660\" \
                   font-family=\"Helvetica, Arial, sans-serif\" font-size=\"16\">\n\
                   <rect x=\"-450\" y=\"-340\" width=\"1330\" height=\"660\" fill=\"white\"/>\n"
        .to_owned();
    out += &inner;
    out += "<g transform=\"translate(330 -90)\" fill=\"none\" stroke=\"#30363d\">\n";
    plan(&mut out);
    out += "</g>\n<g transform=\"translate(330 270)\" fill=\"none\" stroke=\"#30363d\">\n";
    side(&mut out);
    out + "</g>\n</svg>\n"
}

/// Board without its parts, as wide as the frame; it has no layout yet.
fn board() -> Solid {
    Solid::default().add(around([0.0; 2], [FRAME_MM; 2], [0.0, BOARD_MM]))
}

/// Pixels of a millimetre in the drawing.
const SCALE: f64 = 8.0;

/// Draws a rectangle around a middle.
fn rectangle(out: &mut String, [x, y]: [f64; 2], [width, height]: [f64; 2], more: &str) {
    let [x, y, width, height] =
        [x - width / 2.0, y - height / 2.0, width, height].map(|mm| SCALE * mm);
    let _ = writeln!(
        out,
        "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\"{more}/>"
    );
}

/// Draws words at a place.
fn words(out: &mut String, [x, y]: [f64; 2], text: &str) {
    let _ = writeln!(
        out,
        "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"#1f2328\" stroke=\"none\">{text}</text>",
        SCALE * x,
        SCALE * y
    );
}

/// Draws the mount from above.
fn plan(out: &mut String) {
    let [width, _] = PLATE_MM;
    rectangle(out, [0.0; 2], [width; 2], " fill=\"#e6eaf0\"");
    rectangle(out, [0.0; 2], [FRAME_MM; 2], " stroke-dasharray=\"6 5\"");
    let _ = writeln!(
        out,
        "<circle r=\"{:.1}\" stroke=\"#8090a4\" stroke-dasharray=\"2 4\"/>",
        SCALE * FLANGE_MM / 2.0
    );
    for at in corners(flange_at()) {
        let [x, y] = at.map(|mm| SCALE * mm);
        let radius = SCALE * HEAD_MM / 2.0;
        let _ = writeln!(
            out,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" stroke-dasharray=\"6 5\"/>"
        );
        rectangle(out, at, [FLANGE_HOLE_MM; 2], " fill=\"white\"");
    }
    for at in corners(SCREW_MM[0]) {
        rectangle(out, at, [POST_MM[0]; 2], " fill=\"#b9c2cf\"");
        rectangle(out, at, [PILOT_MM[0]; 2], " fill=\"white\"");
    }
    let right = width / 2.0 + 1.5;
    words(out, [right, -22.0], &format!("plate {width} × {width} mm"));
    words(out, [right, -16.5], &format!("4 holes {FLANGE_HOLE_MM} mm for M6"));
    words(out, [right, -14.0], &format!("on a circle of {FLANGE_MM} mm,"));
    words(out, [right, -11.5], &format!("{:.2} mm from both axes", flange_at()));
    words(out, [right, -6.0], &format!("4 posts {0} × {0} mm", POST_MM[0]));
    words(out, [right, -3.5], &format!("{} mm from both axes,", SCREW_MM[0]));
    words(out, [right, -1.0], &format!("hole {} mm, {} deep", PILOT_MM[0], PILOT_MM[1]));
    words(out, [right, 1.5], &format!("for M2 × {SCREW_LENGTH_MM} through frame and board"));
    words(out, [right, 6.5], &format!("dashed: frame {FRAME_MM} mm, heads of M6"));
}

/// Draws the mount from the side, with board, frame and skin.
fn side(out: &mut String) {
    let [width, thickness] = PLATE_MM;
    let [post, room] = POST_MM;
    let skin = scan_plan::finger::REFERENCE.skin.depth_mm;
    rectangle(out, [0.0, -thickness / 2.0], [width, thickness], " fill=\"#e6eaf0\"");
    for x in [-SCREW_MM[0], SCREW_MM[0]] {
        rectangle(out, [x, -thickness - room / 2.0], [post, room], " fill=\"#b9c2cf\"");
    }
    let mut from = thickness + room;
    for (height, width, fill) in [
        (BOARD_MM, FRAME_MM, "#7fa68a"),
        (frame_mm(), FRAME_MM, "#c9d0da"),
        (skin, super::mould::SKIN_MM, "#4a4f57"),
    ] {
        rectangle(out, [0.0, -from - height / 2.0], [width, height], &format!(" fill=\"{fill}\""));
        from += height;
    }
    let right = width / 2.0 + 1.5;
    words(out, [right, -reach() + 1.5], &format!("flange to surface {:.2} mm", reach()));
    words(out, [right, -thickness - room / 2.0], &format!("room {room} mm"));
    words(out, [right, -thickness / 2.0 + 0.5], &format!("plate {thickness} mm"));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::mesh::tests::volume;
    use crate::run::root;

    #[test]
    fn mount_is_closed_and_has_its_volume() {
        let file = std::fs::read(root().join("docs/mould/mount.stl")).unwrap();
        let [width, thickness] = PLATE_MM;
        let plate = (width * width - 4.0 * FLANGE_HOLE_MM * FLANGE_HOLE_MM) * thickness;
        let post = POST_MM[0] * POST_MM[0] * POST_MM[1] - PILOT_MM[0] * PILOT_MM[0] * PILOT_MM[1];
        let expected = plate + 4.0 * post;
        assert!((volume(&file) - expected).abs() < 2.0, "{} {expected}", volume(&file));
    }

    #[test]
    fn screws_of_flange_and_frame_have_room() {
        // A head beside a post, and material around every hole.
        let post_corner = SCREW_MM[0] + POST_MM[0] / 2.0;
        let apart = (flange_at() - post_corner) * std::f64::consts::SQRT_2;
        assert!(apart > HEAD_MM / 2.0 + 1.0, "{apart}");
        assert!(PLATE_MM[0] / 2.0 - flange_at() - FLANGE_HOLE_MM / 2.0 >= 3.0);
        const { assert!((POST_MM[0] - PILOT_MM[0]) / 2.0 >= 1.5) };
        // A screw of 8 mm holds in more than its diameter and does not reach the hole's end.
        let held = SCREW_LENGTH_MM - BOARD_MM - frame_mm();
        assert!(held > 2.0 && held < PILOT_MM[1], "{held}");
    }

    #[test]
    fn drawing_has_the_mounts_dimensions() {
        let drawn = std::fs::read_to_string(root().join("docs/images/mount.svg")).unwrap();
        let reach = format!("flange to surface {:.2} mm", reach());
        assert!(drawn.contains(&reach) && drawn.contains("on a circle of 50 mm"), "{reach}");
    }
}
