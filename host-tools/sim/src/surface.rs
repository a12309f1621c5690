//! Surface of the fingertip on the plate of an array: its position and its normal.

use serde::Deserialize;

use crate::plate::HEIGHT_MM;
use crate::ranges;

/// `surface` of `[device]`, for `kind = "mems-array"`.
///
/// Curved surfaces have their top in the middle, at the height of the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Surface {
    /// Flat, parallel to the plane of the sensors.
    #[default]
    Plane,
    /// Sphere of this radius in mm.
    Sphere(#[serde(deserialize_with = "ranges::fingertip")] f64),
    /// Ellipsoid with these semi-axes along x, y and z in mm.
    Ellipsoid(#[serde(deserialize_with = "ranges::fingertip_axes")] [f64; 3]),
}

impl Surface {
    /// Point of the surface at (x, y) and its unit normal into the finger.
    ///
    /// z is down from the sensors. The pad ends before any fingertip does ([`ranges::fingertip`]).
    #[must_use]
    pub fn at(&self, [x, y]: [f64; 2]) -> ([f64; 3], [f64; 3]) {
        let [a, b, c] = match *self {
            Self::Plane => return ([x, y, -HEIGHT_MM], [0.0, 0.0, 1.0]),
            Self::Sphere(radius) => [radius; 3],
            Self::Ellipsoid(axes) => axes,
        };
        // Height over the middle of the ellipsoid, as a share of c.
        let up = (1.0 - (x / a).powi(2) - (y / b).powi(2)).max(0.0).sqrt();
        let inward = [-x / (a * a), -y / (b * b), up / c];
        let length = inward.iter().map(|n| n * n).sum::<f64>().sqrt();
        ([x, y, c * (1.0 - up) - HEIGHT_MM], inward.map(|n| n / length))
    }

    /// Rotates a force along and across the normal into the finger's frame.
    ///
    /// The rotation is the shortest that takes z to `normal`.
    #[must_use]
    pub fn turned(normal: [f64; 3], [p, q, n]: [f64; 3]) -> [f64; 3] {
        let [nx, ny, nz] = normal;
        // Rodrigues' rotation about z × n; the normal never points back, so 1 + n_z is not zero.
        let across = (p * nx + q * ny) / (1.0 + nz);
        [p - nx * across + n * nx, q - ny * across + n * ny, n * nz - p * nx - q * ny]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_surface_has_its_top_at_the_plane() {
        let plane = Surface::Plane.at([0.0; 2]);
        assert_eq!(Surface::Sphere(12.0).at([0.0; 2]), plane);
        assert_eq!(Surface::Ellipsoid([14.0, 10.0, 8.0]).at([0.0; 2]), plane);
    }

    proptest! {
        #[test]
        fn surface_normal_and_rotation_are_exact(
            x in -4.9..4.9f64, y in -4.9..4.9f64,
            a in 8.0..30.0f64, b in 8.0..30.0f64, c in 8.0..30.0f64,
            p in -1.0..1.0f64, q in -1.0..1.0f64, n in 0.0..2.0f64,
        ) {
            let surface = Surface::Ellipsoid([a, b, c]);
            let (_, normal) = surface.at([x, y]);
            let dot = |u: [f64; 3], v: [f64; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
            let step = 1e-5;
            for (dx, dy) in [(step, 0.0), (0.0, step)] {
                let (there, back) = (surface.at([x + dx, y + dy]).0, surface.at([x - dx, y - dy]).0);
                let along: [f64; 3] = std::array::from_fn(|i| (there[i] - back[i]) / (2.0 * step));
                prop_assert!(dot(along, normal).abs() < 1e-6);
            }
            prop_assert!(normal[2] > 0.0);
            let turned = Surface::turned(normal, [p, q, n]);
            prop_assert!((dot(turned, normal) - n).abs() < 1e-12);
            prop_assert!((dot(turned, turned) - dot([p, q, n], [p, q, n])).abs() < 1e-12);
        }
    }
}
