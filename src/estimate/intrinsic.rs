//! Intrinsic contact sensing: contact point and torsion from the wrench.
//!
//! The method applies to a soft finger on a known convex surface (Bicchi, Salisbury and Brock 1993;
//! [Ospina2017], chapter 2).
//!
//! A soft-finger contact at r pushes with F and twists with a moment along the surface normal only:
//! M = r × F + K A²r on the ellipsoid rᵀA²r = 1. Therefore (K A² − \[F\]ₓ) r = M. This solution for
//! r in the surface's equation leaves a quadratic in K²,
//!
//! D K⁴ + (f² − D m²) K² − g² = 0, with D = |A²|, f = |A F|, m = |A⁻¹M|, g = F·M,
//!
//! and with h = g/K = −√(D K² + f² − D m²), negative because the force points into the finger,
//!
//! r = (K D A⁻²M + (A²F) × M + h F) / (D K² + f²), which has no singularity at K = 0.
#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "a NaN must be refused too")]

use serde::{Deserialize, Serialize};

use super::ContactPoint;
use super::wrench::{Wrench, cross, dot};
use crate::math::{at_least, sqrt};
use crate::measured::{Measured, NoValue};
use crate::units::{Millimetres, NewtonMillimetres};

/// Surface of the finger. Frame and origin are the wrench's; the origin lies on the surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Surface {
    /// 0: plane z = 0, a flat skin.
    #[default]
    Plane,
    /// 1: sphere whose top is the origin.
    Sphere {
        /// Radius in mm.
        radius: Millimetres,
    },
    /// 2: ellipsoid with axes along x, y, z whose top is the origin.
    Ellipsoid {
        /// Half axes in mm.
        half_axes: [Millimetres; 3],
    },
}

/// A soft-finger contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Position in mm; its x and y are the contact point.
    pub place: [f32; 3],
    /// Moment about the surface normal that points into the finger.
    pub torsion: NewtonMillimetres,
    /// Force along that normal in newtons.
    pub normal: f32,
}

impl Contact {
    /// Returns the contact point: x and y of the position.
    #[must_use]
    pub fn point(&self) -> ContactPoint {
        let [x, y, _] = self.place;
        ContactPoint { x: Millimetres(x), y: Millimetres(y) }
    }
}

/// Largest half axis of a fingertip and largest coordinate of a contact, in mm.
const FARTHEST: f32 = 1e3;

impl Surface {
    /// Returns whether a fingertip may have this surface.
    #[must_use]
    pub fn fits(&self) -> bool {
        let valid = |axis: &Millimetres| (1e-3..=FARTHEST).contains(&axis.0);
        match self {
            Self::Plane => true,
            Self::Sphere { radius } => valid(radius),
            Self::Ellipsoid { half_axes } => half_axes.iter().all(valid),
        }
    }

    /// Returns the contact that causes `wrench`; its normal force must be at least `least` newtons.
    ///
    /// # Errors
    /// [`NoValue::IllConditioned`] if the normal force is too small or points out of the finger, or
    /// if its line misses the surface.
    pub fn contact(&self, wrench: &Wrench, least: f32) -> Measured<Contact> {
        let contact = match *self {
            Self::Plane => plane(wrench),
            Self::Sphere { radius } => ellipsoid(wrench, [radius.0; 3]),
            Self::Ellipsoid { half_axes } => ellipsoid(wrench, half_axes.map(|axis| axis.0)),
        }?;
        // Comparisons with NaN are false, so that this also rejects overflow.
        let near = contact.place.iter().all(|c| c.abs() < FARTHEST);
        let pressed = (at_least(least, f32::MIN_POSITIVE)..f32::MAX).contains(&contact.normal);
        if near && pressed && contact.torsion.0.abs() < f32::MAX {
            Ok(contact)
        } else {
            Err(NoValue::IllConditioned)
        }
    }
}

fn plane(wrench: &Wrench) -> Measured<Contact> {
    let ([fx, fy, fz], [mx, my, mz]) = (wrench.force, wrench.moment);
    if !(fz > 0.0) {
        return Err(NoValue::IllConditioned);
    }
    let (x, y) = (-my / fz, mx / fz);
    let torsion = NewtonMillimetres(mz - (x * fy - y * fx));
    Ok(Contact { place: [x, y, 0.0], torsion, normal: fz })
}

fn ellipsoid(wrench: &Wrench, half_axes: [f32; 3]) -> Measured<Contact> {
    let force = wrench.force;
    let valid = half_axes.iter().all(|axis| (1e-3..=FARTHEST).contains(axis));
    if !valid || !(force[2] > 0.0) {
        return Err(NoValue::IllConditioned);
    }
    // Moments about the ellipsoid's centre, one half axis below its top.
    let centre = [0.0, 0.0, half_axes[2]];
    let shift = cross(centre, force);
    let mut moment = wrench.moment;
    moment.iter_mut().zip(shift).for_each(|(m, s)| *m -= s);

    let squares = half_axes.map(|axis| axis * axis);
    let a2 = |v: [f32; 3]| [v[0] / squares[0], v[1] / squares[1], v[2] / squares[2]];
    let inverse_a2 = |v: [f32; 3]| [v[0] * squares[0], v[1] * squares[1], v[2] * squares[2]];
    let d = 1.0 / (squares[0] * squares[1] * squares[2]);
    let f2 = dot(force, a2(force));
    let dm2 = d * dot(moment, inverse_a2(moment));
    let g = dot(force, moment);
    let across = f2 - dm2;
    let root = sqrt(across * across + 4.0 * d * g * g);
    // Root of the quadratic that is free of cancellation.
    let k2 = if across > 0.0 { 2.0 * g * g / (across + root) } else { (root - across) / (2.0 * d) };
    let h2 = d * k2 + across;
    // The position of a line that only just touches the surface is noise.
    if !(h2 > 1e-6 * f2) {
        return Err(NoValue::IllConditioned);
    }
    let h = -sqrt(h2);
    let k = g / h;
    let across = cross(a2(force), moment);
    let along = inverse_a2(moment);
    let below = d * k2 + f2;
    let mut place = [0.0; 3];
    for (i, place) in place.iter_mut().enumerate() {
        let term = |v: &[f32; 3]| v.get(i).copied().unwrap_or_default();
        *place = (k * d * term(&along) + term(&across) + h * term(&force)) / below;
    }
    // A²r points out of the finger, and h = F·A²r is negative.
    let outwards = a2(place);
    let size = sqrt(dot(outwards, outwards));
    place[2] += half_axes[2];
    Ok(Contact { place, torsion: NewtonMillimetres(-k * size), normal: -h / size })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PLANE: Surface = Surface::Plane;
    const ROUND: Surface = Surface::Sphere { radius: Millimetres(12.0) };
    const TIP: Surface =
        Surface::Ellipsoid { half_axes: [Millimetres(9.0), Millimetres(12.0), Millimetres(15.0)] };

    /// Returns the position on the surface above (x, y) and its unit normal into the finger.
    fn on(surface: Surface, x: f32, y: f32) -> ([f32; 3], [f32; 3]) {
        let axes = match surface {
            Surface::Plane => return ([x, y, 0.0], [0.0, 0.0, 1.0]),
            Surface::Sphere { radius } => [radius.0; 3],
            Surface::Ellipsoid { half_axes } => half_axes.map(|a| a.0),
        };
        let [a, b, c] = axes;
        let z = -c * (1.0 - (x / a).powi(2) - (y / b).powi(2)).sqrt();
        let out = [x / (a * a), y / (b * b), z / (c * c)];
        let length = dot(out, out).sqrt();
        ([x, y, z + c], out.map(|v| -v / length))
    }

    proptest! {
        #[test]
        fn contact_round_trips_through_its_wrench(
            x in -5.0..5.0f32, y in -5.0..5.0f32, fx in -0.4..0.4f32, fy in -0.4..0.4f32,
            fz in 0.2..2.0f32, torsion in -3.0..3.0f32,
        ) {
            for surface in [PLANE, ROUND, TIP] {
                let (place, normal) = on(surface, x, y);
                let force = [fx * fz, fy * fz, fz];
                // The force must push into the finger at that position; otherwise there is no such
                // contact.
                if dot(force, normal) < 0.2 * fz {
                    continue;
                }
                let mut moment = cross(place, force);
                moment.iter_mut().zip(normal).for_each(|(m, n)| *m += torsion * n);
                let contact = surface.contact(&Wrench { force, moment }, 0.03).unwrap();
                for (found, expected) in contact.place.iter().zip(place) {
                    prop_assert!((found - expected).abs() < 0.02, "{surface:?} {contact:?} {place:?}");
                }
                prop_assert!((contact.torsion.0 - torsion).abs() < 0.02, "{surface:?} {contact:?}");
                let pressed = dot(force, normal);
                prop_assert!((contact.normal - pressed).abs() < 0.005, "{contact:?} {pressed}");
            }
        }

        #[test]
        fn contact_is_finite_for_any_wrench_and_surface(
            force in any::<[f32; 3]>(), moment in any::<[f32; 3]>(), axes in any::<[f32; 3]>(),
            least in any::<f32>(),
        ) {
            let wrench = Wrench { force, moment };
            let half_axes = axes.map(Millimetres);
            for surface in
                [PLANE, ROUND, Surface::Sphere { radius: half_axes[0] }, Surface::Ellipsoid { half_axes }]
            {
                if let Ok(contact) = surface.contact(&wrench, least) {
                    prop_assert!(contact.torsion.0.is_finite());
                    prop_assert!(contact.normal > 0.0 && contact.normal.is_finite());
                    prop_assert!(!(contact.normal < least));
                    prop_assert!(contact.place.iter().all(|c| c.is_finite()));
                }
            }
        }
    }

    #[test]
    fn tangential_force_has_no_contact() {
        // At the sphere's side the normal is level: all but 0.02 N of 1 N pull along the surface.
        let (place, normal) = on(ROUND, 11.9, 0.0);
        let along = [normal[2], 0.0, -normal[0]];
        let force = [0, 1, 2].map(|i| 0.02 * normal[i] + along[i]);
        let wrench = Wrench { force, moment: cross(place, force) };
        assert!(force[2] > 0.9, "{force:?}");
        assert!(ROUND.contact(&wrench, 0.01).is_ok());
        assert_eq!(ROUND.contact(&wrench, 0.05), Err(NoValue::IllConditioned));
    }

    #[test]
    fn pulling_or_missing_force_has_no_contact() {
        for surface in [PLANE, ROUND, TIP] {
            let pulling = Wrench { force: [0.0, 0.0, -1.0], moment: [0.0; 3] };
            assert_eq!(surface.contact(&pulling, 0.05), Err(NoValue::IllConditioned));
        }
        let beside = Wrench { force: [0.0, 0.0, 1.0], moment: [20.0, 0.0, 0.0] };
        assert_eq!(ROUND.contact(&beside, 0.05), Err(NoValue::IllConditioned));
    }
}
