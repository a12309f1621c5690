//! TAXEL-4x1 (002, figs 5 and 8): four taxels in one row, no force sensors.
//!
//! The paper prints no dimensions. It says how the contact was varied (0.2 N, p from −3 to 3 mm, angles
//! from 30° to 150°) and that s and t, eqs (3) and (4), of the displacements then correlate with −0.68. A
//! pitch of 7.5 mm, which leaves walls between LEDs in cans of 5.5 mm, under 4 mm of silicone with facets of
//! 4 mm give −0.69; so do other threes, and a half-space has no walls. The finger's own pitch of 2.5 mm gives
//! +0.95, and s and t then hardly tell p from the angle.
//!
//! The scan is the finger's: rows 1 to 3 have no LEDs and read the dark.

use taxel::scan::COLS;

/// Distance of the taxels in mm.
pub const PITCH_MM: f64 = 7.5;

/// Centres of the facets in mm, those of row 0 from left to right.
pub const CENTRES: [[f64; 2]; COLS] =
    [[-1.5 * PITCH_MM, 0.0], [-0.5 * PITCH_MM, 0.0], [0.5 * PITCH_MM, 0.0], [1.5 * PITCH_MM, 0.0]];
