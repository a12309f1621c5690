//! One conical silicone feeler against an acrylic board that is lit from its edge ([Ohka2005]).
//!
//! The contact area lights up in proportion to the normal force, F_z = C·G (eq. (3)). Shear moves
//! the bright spot: F_x = βu until the feeler slips on the board at αF_z + γ. From there on F_x =
//! Ku + (1 − K/β)(αF_z + γ), eqs (10) to (12); eqs (13) and (14) print αF_x + γ.

/// Spring K of the rubber sheet once the feeler slips, in N/mm.
pub const SLIDING: f64 = 0.067;
/// Spring β of a feeler that sticks, in N/mm.
pub const STICKING: f64 = 1.7;
/// Growth α of the slip threshold per normal force.
pub const ALPHA: f64 = 0.25;
/// Slip threshold γ of an unloaded feeler in newtons.
pub const GAMMA_N: f64 = 0.56e-3;
/// Largest normal force in newtons to which the brightness is proportional (fig. 8).
pub const LINEAR_N: f64 = 0.012;

/// Shear in newtons at which a feeler under `normal` newtons slips.
#[must_use]
pub fn threshold(normal: f64) -> f64 {
    ALPHA * normal + GAMMA_N
}

/// Returns whether a feeler with `force` in newtons slips on its board.
#[must_use]
pub fn slips([fx, fy, fz]: [f64; 3]) -> bool {
    fz > 0.0 && fx.abs().max(fy.abs()) > threshold(fz)
}

/// Computes the shift u of the bright spot in mm, eqs (10) and (11).
///
/// The feeler slips beyond `threshold`.
#[must_use]
pub fn shift(shear: f64, threshold: f64) -> f64 {
    let stuck = shear.clamp(-threshold, threshold);
    stuck / STICKING + (shear - stuck) / SLIDING
}

/// Coefficients of one axis of shear, [Ohka2005] eqs (10)–(12).
///
/// The feeler sticks until the shear reaches αF_z + γ and then moves much farther per newton.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shear {
    /// β, stiffness of a sticking feeler, mN/µm.
    pub stuck: f32,
    /// K, stiffness of the sheet alone, mN/µm.
    pub sheet: f32,
    /// α, growth of the threshold with the normal force.
    pub friction: f32,
    /// γ, the threshold without normal force, mN.
    pub adhesion: f32,
}

impl Shear {
    /// Values of section V.3: β = 1.7 mN/µm, K = 0.067 mN/µm, α = 0.25, γ = 0.56 mN.
    pub const PAPER: Self = Self { stuck: 1.7, sheet: 0.067, friction: 0.25, adhesion: 0.56 };

    /// Computes the force in mN for a shift in µm under `normal` mN.
    ///
    /// Eqs (10) and (11) with eq. (12) put in.
    ///
    /// Eqs (13), (14) print αF_x + γ in the bracket; eq. (12) in eq. (11) gives αF_z + γ, which
    /// this function uses. The force is odd in the shift and continuous at the threshold.
    #[must_use]
    pub fn force(&self, shift: f32, normal: f32) -> f32 {
        let threshold = (self.friction * normal.max(0.0) + self.adhesion).max(0.0);
        let stuck = self.stuck * shift;
        if stuck.abs() <= threshold {
            return stuck;
        }
        let beyond = self.sheet * (shift.abs() - threshold / self.stuck);
        (threshold + beyond).copysign(shift)
    }
}

/// Coefficients of the sensor: force per integral of grey values, and two axes of shear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrightSpot {
    /// C of eq. (3): millinewtons per unit of the integral.
    pub normal: f32,
    /// Shear along x.
    pub x: Shear,
    /// Shear along y.
    pub y: Shear,
}

/// Integral G and centroid of the grey values in a window around a feeler.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// Integral G of the grey values.
    pub integral: f32,
    /// Centroid X_G, Y_G from the window's corner, in units of `pixel`; zero for a dark window.
    pub centroid: [f32; 2],
}

/// Smallest integral with a centroid: a fifteenth of a 16-bit step.
///
/// Noise makes negative grey values, which may nearly cancel the others. The centroid of the rest
/// is arbitrary.
const DARK: f32 = 1e-6;

impl Spot {
    /// Measures an image given row by row, `width` pixels per row, each `pixel` wide; eqs (3)–(5).
    #[must_use]
    pub fn measure(grey: &[f32], width: usize, pixel: f32) -> Self {
        let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
        for (j, row) in grey.chunks(width.max(1)).enumerate() {
            let mut of_row = 0.0;
            for (i, g) in row.iter().enumerate() {
                of_row += g;
                x += g * (i as f32 + 0.5);
            }
            sum += of_row;
            y += of_row * (j as f32 + 0.5);
        }
        let lit = sum > DARK;
        let centre = |moment: f32| if lit { moment / sum * pixel } else { 0.0 };
        Self { integral: sum * pixel * pixel, centroid: [centre(x), centre(y)] }
    }
}

impl BrightSpot {
    /// Force in millinewtons from the integral G and the centroid's shift in µm.
    ///
    /// The shift counts from the feeler without shear.
    #[must_use]
    pub fn force(&self, integral: f32, [ux, uy]: [f32; 2]) -> [f32; 3] {
        let normal = self.normal * integral;
        [self.x.force(ux, normal), self.y.force(uy, normal), normal]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_shear() -> impl Strategy<Value = Shear> {
        let any = || prop_oneof![-1e30..1e30f32, -1e-38..1e-38f32, Just(0.0f32), Just(1e30f32)];
        (any(), any(), any(), any()).prop_map(|(stuck, sheet, friction, adhesion)| Shear {
            stuck,
            sheet,
            friction,
            adhesion,
        })
    }

    proptest! {
        /// Coefficients as large as a record may hold, with grey values in the range of signals.
        ///
        /// Noise makes some of them negative, so that their sum may nearly cancel.
        #[test]
        fn forces_are_finite_for_any_image(
            mut grey in proptest::collection::vec(
                prop_oneof![-2.0..2.0f32, -1e-37..1e-37f32, Just(0.0f32)], 0..10,
            ),
            (cancels, left) in (any::<bool>(), -1e-37..1e-37f32),
            (width, pixel) in (0..6usize, 0.0..1e3f32),
            normal in prop_oneof![-1e30..1e30f32, Just(1e30f32), Just(0.0f32)],
            (x, y) in (any_shear(), any_shear()),
        ) {
            if cancels {
                grey.extend(grey.clone().iter().rev().map(|grey| -grey));
                grey.push(left);
            }
            let spot = Spot::measure(&grey, width, pixel);
            let [ux, uy] = spot.centroid;
            prop_assert!([spot.integral, ux, uy].into_iter().all(f32::is_finite), "{spot:?}");
            let sensor = BrightSpot { normal, x, y };
            let force = sensor.force(spot.integral, spot.centroid);
            prop_assert!(force.into_iter().all(f32::is_finite), "{force:?} of {spot:?}");
        }
    }

    const SENSOR: BrightSpot = BrightSpot { normal: 2.0, x: Shear::PAPER, y: Shear::PAPER };

    #[test]
    fn shear_law_is_continuous_at_its_threshold() {
        for normal in [2.2f32, 4.4, 6.5, 8.7, 10.9] {
            let threshold = 0.25 * normal + 0.56;
            let at = threshold / 1.7;
            let (below, above) =
                (Shear::PAPER.force(0.999 * at, normal), Shear::PAPER.force(1.001 * at, normal));
            assert!((below - threshold).abs() < 0.01 && (above - threshold).abs() < 0.01);
            let slope = (Shear::PAPER.force(at + 20.0, normal) - threshold) / 20.0;
            assert!((slope - 0.067).abs() < 1e-4, "{slope}");
        }
    }

    #[test]
    fn printed_bracket_differs_from_eqs_11_and_12() {
        // The right form: K u + (1 − K/β)(α F_z + γ).
        let (u, normal) = (30.0f32, 6.5f32);
        let right = 0.067 * u + (1.0 - 0.067 / 1.7) * (0.25 * normal + 0.56);
        assert!((Shear::PAPER.force(u, normal) - right).abs() < 1e-5);
        // The printed form is implicit in F_x and differs by half.
        let printed = (0.067 * u + (1.0 - 0.067 / 1.7) * 0.56) / (1.0 - (1.0 - 0.067 / 1.7) * 0.25);
        assert!((printed / right - 1.0).abs() > 0.1, "{printed} {right}");
    }

    #[test]
    fn shear_is_odd_and_axes_do_not_mix() {
        let [x, y, z] = SENSOR.force(3.0, [25.0, -25.0]);
        assert_eq!((x, z), (-y, 6.0));
        assert_eq!(SENSOR.force(3.0, [0.0, 4.0])[0], 0.0);
    }

    #[test]
    fn moved_spot_moves_centroid_and_keeps_integral() {
        let spot = |at: usize| {
            let mut grey = [0.0; 64];
            for (place, g) in [(at, 2.0), (at + 1, 1.0), (at + 8, 1.0)] {
                grey[place] = g;
            }
            Spot::measure(&grey, 8, 10.0)
        };
        let (a, b) = (spot(18), spot(19));
        assert_eq!(a.integral, b.integral);
        assert!((b.centroid[0] - a.centroid[0] - 10.0).abs() < 1e-4);
        assert!((b.centroid[1] - a.centroid[1]).abs() < 1e-4);
        assert_eq!(Spot::measure(&[0.0; 64], 8, 10.0).centroid, [0.0, 0.0]);
    }
}
