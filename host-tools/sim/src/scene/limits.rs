//! Limits within which the laws of contact hold for a scene's skin.

use super::read::Problem;
use super::{Act, Kind, Scene, softness};
use crate::contact::HalfSpace;
use crate::ranges::PAD_MM;

/// Largest ratio of facet side to depth at which the mean over the facet still converges.
const WIDEST: f64 = 4.0;
/// Largest contact of a sphere or cylinder over its radius.
///
/// Hertz takes both for paraboloids, which holds for a ≪ R (Johnson §4.1). At this limit a sphere's
/// contact is 7.4 % too wide (against Sneddon 1965, tested).
const WIDEST_OF_RADIUS: f64 = 0.7;
/// Largest indentation over the skin's thickness.
///
/// The skin between surface and facets is then a fifth shorter (tested). The comparison of its
/// Mooney–Rivlin law ([DeMaria2011]) with the linear law reaches no further.
const DEEPEST: f64 = 0.7;
/// Largest distance in mm by which a contact area may reach beyond the rim of the pad.
///
/// The value is the reach of 2 N, the working range of [DeMaria2011], on a sphere of 6 mm at the
/// rim. There the model's skin goes on and a real one ends. A layer with walls repeats, with at
/// least 10 mm between.
const OVERHANG_MM: f64 = 3.0;

/// Checks that acts and facets stay within the contact model.
///
/// An act must not push its indenter through the skin, wrap the skin around a round indenter, or
/// reach off the pad. A facet must not be too wide for its depth.
pub(super) fn check(scene: &Scene) -> Result<(), Problem> {
    let kind = scene.device.kind;
    let facets = matches!(kind, Kind::Taxel4x4 | Kind::Taxel4x1);
    if scene.bench.is_some() || scene.device.rows() == 0 || !(facets || kind == Kind::OhkaSheet) {
        return Ok(());
    }
    let skin = HalfSpace::new(scene.material.young_mpa, scene.material.poisson);
    // A colder skin is softer, which is the same as larger forces.
    let softest = scene.temperature().map_or(1.0, |t| softness(t.start_c.min(t.end_c)));
    for (span, act) in Act::all(scene) {
        let pressed = Pressed { scene, skin, softest, act };
        let skin = || pressed.narrow().and_then(|()| pressed.deep());
        let outcome = if facets { skin().and_then(|()| pressed.on_pad()) } else { Ok(()) };
        outcome.and_then(|()| pressed.blunt()).map_err(|problem| (span, problem))?;
    }
    Ok(())
}

/// Act on the skin at its softest.
struct Pressed<'a> {
    scene: &'a Scene,
    skin: HalfSpace,
    softest: f64,
    act: Act,
}

impl Pressed<'_> {
    fn narrow(&self) -> Result<(), String> {
        let (depth, facet) = (self.scene.layer.depth_mm, self.scene.layer.facet_mm);
        if facet <= WIDEST * depth {
            return Ok(());
        }
        Err(format!(
            "touches facets of `facet_mm` {facet} mm that lie `depth_mm` {depth} mm deep; allowed are \
             facets up to {WIDEST} times as wide as deep"
        ))
    }

    fn blunt(&self) -> Result<(), String> {
        let Some(radius) = self.scene.indenter().radius() else { return Ok(()) };
        let half = |normal| self.half_extents(normal)[1];
        let (found, most) = (half(self.act.reach().0), WIDEST_OF_RADIUS * radius);
        if found <= most {
            return Ok(());
        }
        Err(format!(
            "touches {found:.2} mm to each side with a `radius_mm` of {radius}; the law of contact holds up to \
             {WIDEST_OF_RADIUS} of it, {most:.2} mm: press with {}, or take a larger `radius_mm` or a \
             stiffer [material]",
            self.largest(|normal| half(normal) <= most)
        ))
    }

    fn deep(&self) -> Result<(), String> {
        let depth = self.scene.layer.depth_mm;
        // A tip has no size, so that its displacement at the depth of the facets counts.
        let indentation = |normal: f64| {
            let normal = self.softest * normal;
            let tip = || self.skin.displacement([0.0, 0.0, normal], [0.0, 0.0, depth]);
            self.scene.indenter().indentation(&self.skin, normal).unwrap_or_else(tip)
        };
        let (found, most) = (indentation(self.act.reach().0), DEEPEST * depth);
        if found <= most {
            return Ok(());
        }
        Err(format!(
            "pushes the indenter {found:.2} mm into a skin of `depth_mm` {depth} mm; the law of contact holds up \
             to {DEEPEST} of it, {most:.2} mm: press with {}, or take a blunter [indenter], a thicker \
             [layer] or a stiffer [material]",
            self.largest(|normal| indentation(normal) <= most)
        ))
    }

    fn on_pad(&self) -> Result<(), String> {
        let (normal, way) = self.act.reach();
        let sides = self.scene.indenter().sides(&self.skin, self.softest * normal);
        for point in way {
            for ((axis, at), side) in ["x", "y"].into_iter().zip(point).zip(sides) {
                let (found, most) = (at.abs() + side, 0.5 * PAD_MM + OVERHANG_MM);
                if found > most {
                    return Err(format!(
                        "touches the skin out to {found:.2} mm along {axis}; the pad ends at {} mm and areas of \
                         contact may reach {most} mm: move it inwards, press less or take a smaller [indenter]",
                        0.5 * PAD_MM
                    ));
                }
            }
        }
        Ok(())
    }

    fn half_extents(&self, normal: f64) -> [f64; 2] {
        self.scene.indenter().half_extents(&self.skin, self.softest * normal)
    }

    /// Describes the largest force that is `allowed` together with every smaller one.
    ///
    /// The description is the key and its range. The force is in whole millinewtons, up to the
    /// act's.
    fn largest(&self, allowed: impl Fn(f64) -> bool) -> String {
        let (mut low, mut high) = (0.0, self.act.reach().0);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if allowed(middle) { low = middle } else { high = middle }
        }
        let key = if matches!(self.act, Act::Grid(_)) { "force_n" } else { "fz_n" };
        format!("a `{key}` of {} at most", (low * 1000.0).floor() / 1000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::Indenter;
    use crate::contact::sphere::Hertz;

    #[test]
    fn paraboloid_at_limit_matches_sphere() {
        // Sneddon 1965 for a true sphere, over E*R²: P = ½(1 + t²) ln((1 + t)/(1 − t)) − t, t =
        // a/R. Its approach over R is ½t ln((1 + t)/(1 − t)). Hertz: P = 4t³/3 and t².
        let hertz = WIDEST_OF_RADIUS;
        let log = |t: f64| ((1.0 + t) / (1.0 - t)).ln();
        let force = |t: f64| 0.5 * (1.0 + t * t) * log(t) - t;
        let (mut low, mut high) = (0.0, hertz);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if force(middle) < 4.0 / 3.0 * hertz.powi(3) { low = middle } else { high = middle }
        }
        let (wide, deep) = (hertz / low, hertz * hertz / (0.5 * low * log(low)));
        assert!((wide - 1.074).abs() < 0.001, "{wide}");
        assert!((deep - 0.966).abs() < 0.001, "{deep}");
    }

    #[test]
    fn deepest_press_shortens_skin_by_a_fifth() {
        let (skin, depth) = (HalfSpace::new(0.236, 0.5), 2.5);
        let (ball, sunk) = (Indenter::Sphere { radius: 6.0 }, DEEPEST * depth);
        // δ grows as the 2/3 power of the force.
        let normal = (sunk / ball.indentation(&skin, 1.0).unwrap()).powf(1.5);
        let radius = skin.contact_radius(6.0, normal);
        let below = Hertz { radius, normal }.displacement(&skin, 0.0, depth);
        let strain = (sunk - below) / depth;
        assert!((strain - 0.19).abs() < 0.005, "{strain}");
    }
}
