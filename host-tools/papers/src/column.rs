//! Columns of silicone on 2×2 cones against a lit acrylic board, for combined loads ([Ohka2004]).
//!
//! A cone lights the area S_i on which it touches the board. The areas under a column follow its
//! force: A_z = S1 + S2 + S3 + S4 = F_z/α_v and A_x = S1 − S2 − S3 + S4 = F_x/(α_h0 − α_h A_z). The
//! same holds for F_y and A_y = S1 + S2 − S3 − S4. The sources are eqs (1) to (3) and (18); eq.
//! (11) sums other cones. The fourth combination, S1 − S2 + S3 − S4, belongs to torsion, which the
//! paper does not treat, so it is zero. A cone that lifts off the board is dark, and the paper's
//! law ends there.
//!
//! The 4×4 matrix in blocks of 2×2 makes four such columns. S1 is at (+x, +y) of its column, S2 at
//! (−x, +y), S3 at (−x, −y), S4 at (+x, −y). Several columns in a row measure the surface that they
//! touch.

use taxel::math::{atan2, sqrt};
use taxel::measured::{Measured, NoValue};
use taxel::scan::{COLS, TAXELS};

/// Normal stiffness α_v in N/mm².
pub const VERTICAL: f64 = 0.25;
/// Shear stiffness α_h0 of an unloaded column in N/mm².
pub const HORIZONTAL: f64 = 0.20;
/// Loss of shear stiffness α_h with the contact area, in N/mm⁴.
pub const SHRINKAGE: f64 = 0.081;
/// Spring k_v of a column in N/mm.
pub const SPRING: f64 = 0.96;
/// Largest normal force on a column in newtons for which the laws are used.
///
/// Its 0.5 mm cones are then 0.3 mm shorter. (The paper gives 20 % as 0.1 mm; its steps are up to
/// 0.2 mm.)
pub const MOST_N: f64 = 0.3;

/// Columns of the matrix.
pub const COLUMNS: usize = 4;
/// Distance of neighbouring columns in mm: two pitches of the matrix.
pub const PITCH_MM: f64 = 5.0;
/// Centres of the columns in mm: column (i, j) is the (2j + i)-th.
pub const CENTRES: [[f64; 2]; COLUMNS] = [
    [-0.5 * PITCH_MM, -0.5 * PITCH_MM],
    [0.5 * PITCH_MM, -0.5 * PITCH_MM],
    [-0.5 * PITCH_MM, 0.5 * PITCH_MM],
    [0.5 * PITCH_MM, 0.5 * PITCH_MM],
];
/// Radius of a column's tip in mm.
pub const TIP_MM: f64 = 1.0;

/// Computes S1 … S4 in mm² under a column with `force` in newtons, z towards the board.
#[must_use]
pub fn areas([fx, fy, fz]: [f64; 3]) -> [f64; 4] {
    let sum = fz.max(0.0) / VERTICAL;
    // Positive up to MOST_N.
    let sensitivity = HORIZONTAL - SHRINKAGE * sum;
    let (x, y) = (fx / sensitivity, fy / sensitivity);
    [sum + x + y, sum - x + y, sum - x - y, sum + x - y].map(|s| (0.25 * s).max(0.0))
}

/// Finds the column on whose tip `point` lies; `None` between them.
///
/// The position on the tip does not matter, because the paper's laws know no moment.
#[must_use]
pub fn below([x, y]: [f64; 2]) -> Option<usize> {
    let squared = |[cx, cy]: [f64; 2]| (x - cx) * (x - cx) + (y - cy) * (y - cy);
    CENTRES.into_iter().position(|centre| squared(centre) <= TIP_MM * TIP_MM)
}

/// Coefficients of a column, [Ohka2004] eq. (18), with areas in mm².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// α_v, N/mm².
    pub normal: f32,
    /// α_h0, N/mm².
    pub shear: f32,
    /// α_h, N/mm⁴: the cones flatten and their lever shortens.
    pub flattening: f32,
    /// α_v/k_v of eq. (22), 1/mm: sinking of the column per area.
    pub sinking: f32,
}

/// Force and sinking of a column.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ColumnLoad {
    /// F_x, F_y, F_z in newtons.
    pub force: [f32; 3],
    /// U_z in mm.
    pub sunk: f32,
}

impl Column {
    /// Values of sections 4.2 and 6.2.
    pub const PAPER: Self = Self {
        normal: VERTICAL as f32,
        shear: HORIZONTAL as f32,
        flattening: SHRINKAGE as f32,
        sinking: 0.26,
    };

    /// Computes force and sinking from the areas S_1 … S_4, eqs (1)–(3), (18), (22).
    ///
    /// A_x is S_1 − S_2 − S_3 + S_4 as eq. (1) defines it; eq. (11) sums (S_1 + S_3) and (S_2 +
    /// S_4) instead, which contradicts it.
    #[must_use]
    pub fn load(&self, [s1, s2, s3, s4]: [f32; 4]) -> ColumnLoad {
        let (x, y, z) = (s1 - s2 - s3 + s4, s1 + s2 - s3 - s4, s1 + s2 + s3 + s4);
        let shear = self.shear - self.flattening * z;
        ColumnLoad { force: [shear * x, shear * y, self.normal * z], sunk: self.sinking * z }
    }
}

/// Splits the matrix into four columns; the signals' rise −c_k stands for the area of cone k.
///
/// Quadrants follow eqs (1), (2): S_1 at +x +y, S_2 at −x +y, S_3 at −x −y, S_4 at +x −y. Columns
/// come row by row: −x −y, +x −y, −x +y, +x +y.
#[must_use]
pub fn quadrants(c: &[f32; TAXELS]) -> [[f32; 4]; 4] {
    let at = |row: usize, column: usize| -c.get(row * COLS + column).copied().unwrap_or_default();
    core::array::from_fn(|i| {
        let (row, column) = (2 * (i / 2), 2 * (i % 2));
        [at(row + 1, column + 1), at(row + 1, column), at(row, column), at(row, column + 1)]
    })
}

/// Friction coefficient μ = F_t/F_z of a sliding column (section 5.2).
///
/// # Errors
/// [`NoValue::IllConditioned`] where the normal force is below `least` newtons.
pub fn friction(load: &ColumnLoad, least: f32) -> Measured<f32> {
    let [x, y, z] = load.force;
    let ratio = sqrt(x * x + y * y) / z;
    if z > least.max(f32::MIN_POSITIVE) && ratio < f32::MAX {
        Ok(ratio)
    } else {
        Err(NoValue::IllConditioned)
    }
}

/// Friction coefficients μ = F_t/F_z under all columns, with the forces of eq. (18).
///
/// Section 5.2 and fig. 13 (c): a step or a slope of the sliding surface changes F_z and F_t of a
/// column and keeps its μ. A smoother spot changes μ.
pub fn friction_distribution<const N: usize>(
    loads: &[ColumnLoad; N],
    least: f32,
) -> [Measured<f32>; N] {
    loads.each_ref().map(|load| friction(load, least))
}

/// Inclination Θ = atan(m/d) in degrees of a flat object on columns in a line.
///
/// d is `distance` in mm; m is the mean difference of sinking between neighbours (section 6.2).
///
/// # Errors
/// [`NoValue::IllConditioned`] for fewer than two columns or no distance.
pub fn inclination(sunk: &[f32], distance: f32) -> Measured<f32> {
    let (Some(first), Some(last)) = (sunk.first(), sunk.last()) else {
        return Err(NoValue::IllConditioned);
    };
    // The sum of the neighbours' differences telescopes.
    let (rise, along) = (last - first, sunk.len().saturating_sub(1) as f32 * distance);
    if along > 0.0 && along < f32::MAX && rise.abs() < f32::MAX {
        Ok(atan2(rise, along) * (180.0 / core::f32::consts::PI))
    } else {
        Err(NoValue::IllConditioned)
    }
}

/// Height in mm of a step that changed a column's normal force from `before` to `after` newtons.
///
/// Higher ground presses the column in by ∆F_z/k_v, with k_v = α_v/(α_v/k_v) (section 5.2 and eq.
/// (22)).
///
/// # Errors
/// [`NoValue::IllConditioned`] where the quotient overflows.
pub fn step_height(column: &Column, before: f32, after: f32) -> Measured<f32> {
    let height = (after - before) * column.sinking / column.normal;
    if height.abs() < f32::MAX { Ok(height) } else { Err(NoValue::IllConditioned) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Coefficients as large as a record may hold, or close to zero.
    fn coefficient() -> impl Strategy<Value = f32> {
        prop_oneof![-1e30..1e30f32, -1e-38..1e-38f32, Just(0.0f32), Just(1e30f32), Just(-1e30f32)]
    }

    fn finite(value: Measured<f32>) -> bool {
        value.is_ok_and(f32::is_finite) || value.is_err()
    }

    proptest! {
        #[test]
        fn loads_are_finite_for_any_input(
            c in proptest::array::uniform16(prop_oneof![-2.0..2.0f32, Just(2.0f32), Just(-2.0f32)]),
            coefficients in proptest::array::uniform4(coefficient()),
            (least, distance, before) in (any::<f32>(), any::<f32>(), coefficient()),
        ) {
            let [normal, shear, flattening, sinking] = coefficients;
            let column = Column { normal, shear, flattening, sinking };
            let loads = quadrants(&c).map(|areas| column.load(areas));
            for load in &loads {
                let numbers = load.force.into_iter().chain([load.sunk]);
                prop_assert!(numbers.into_iter().all(f32::is_finite), "{load:?}");
                prop_assert!(finite(friction(load, least)), "{load:?}");
                let step = step_height(&column, before, load.force[2]);
                prop_assert!(finite(step), "{step:?}");
            }
            let sunk = loads.map(|load| load.sunk);
            for columns in 0..=sunk.len() {
                let angle = inclination(&sunk[..columns], distance);
                prop_assert!(finite(angle), "{angle:?}");
            }
        }
    }

    const PAPER: Column = Column::PAPER;

    #[test]
    fn equal_areas_are_normal_unequal_ones_shear() {
        let load = PAPER.load([0.5; 4]);
        assert_eq!(load.force[..2], [0.0, 0.0]);
        assert!((load.force[2] - 0.25 * 2.0).abs() < 1e-6 && (load.sunk - 0.52).abs() < 1e-6);
        // +x is quadrants 1 and 4.
        let load = PAPER.load([0.6, 0.4, 0.4, 0.6]);
        assert!((load.force[0] - (0.20 - 0.081 * 2.0) * 0.4).abs() < 1e-6);
        assert_eq!(load.force[1], 0.0);
    }

    #[test]
    fn eq_11_would_miss_shear_along_x() {
        let [s1, s2, s3, s4] = [0.6f32, 0.4, 0.4, 0.6];
        assert_eq!((s1 + s3) - (s2 + s4), 0.0);
        assert!(PAPER.load([s1, s2, s3, s4]).force[0] > 0.0);
    }

    #[test]
    fn taxel_maps_to_its_column_and_quadrant() {
        let mut c = [0.0; TAXELS];
        // Row 1, column 2: the column at +x −y, in it towards −x +y.
        c[6] = -1.0;
        let mut expected = [[0.0; 4]; 4];
        expected[1][1] = 1.0;
        assert_eq!(quadrants(&c), expected);
    }

    #[test]
    fn inclination_is_slope_of_sinking() {
        let slope = 0.38f32.to_radians().tan();
        let sunk = [0.3, 0.3 + 2.0 * slope, 0.3 + 4.0 * slope];
        assert!((inclination(&sunk, 2.0).unwrap() - 0.38).abs() < 1e-3);
        assert_eq!(inclination(&[0.3], 2.0), Err(NoValue::IllConditioned));
        assert_eq!(inclination(&[], 2.0), Err(NoValue::IllConditioned));
        assert_eq!(inclination(&[0.1, 0.2], 0.0), Err(NoValue::IllConditioned));
    }

    #[test]
    fn step_height_matches_the_paper() {
        // k_v = 0.96 N/mm.
        for step in [0.05f32, 0.1, 0.2] {
            let height = step_height(&PAPER, 0.4, 0.4 + 0.96 * step).unwrap();
            assert!((height / step - 1.0).abs() < 0.002, "{height}");
        }
    }

    #[test]
    fn sliding_column_measures_friction() {
        let load = ColumnLoad { force: [0.3, 0.4, 1.0], sunk: 0.0 };
        assert!((friction(&load, 0.05).unwrap() - 0.5).abs() < 1e-6);
        assert_eq!(friction(&ColumnLoad::default(), 0.05), Err(NoValue::IllConditioned));
    }

    #[test]
    fn friction_shows_smooth_spots_and_no_steps() {
        let rubbed = |normal: f32, mu: f32| {
            // Areas for these forces by eqs (1)–(3) and (18), with all of the shear along x.
            let z = normal / PAPER.normal;
            let x = mu * normal / (PAPER.shear - PAPER.flattening * z);
            PAPER.load([z + x, z - x, z - x, z + x].map(|sum| sum / 4.0))
        };
        // The second column is on a step, the third on a smooth spot; the fourth does not touch.
        let loads = [rubbed(0.2, 0.3), rubbed(0.3, 0.3), rubbed(0.2, 0.1), rubbed(0.0, 0.0)];
        let [even, step, smooth, free] = friction_distribution(&loads, 0.05);
        for (found, mu) in [(even, 0.3), (step, 0.3), (smooth, 0.1)] {
            assert!((found.unwrap() - mu).abs() < 1e-5, "{found:?} {mu}");
        }
        assert_eq!(free, Err(NoValue::IllConditioned));
    }
}
