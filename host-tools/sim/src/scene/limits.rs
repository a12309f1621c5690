//! How far the laws of contact hold for a scene's skin.

use super::read::Problem;
use super::{Act, Kind, Scene};
use crate::contact::HalfSpace;
use crate::skin;

/// The widest facet over its depth that the mean over it is still converged for.
const WIDEST: f64 = 4.0;

/// No act pushes its indenter through the skin, and no facet is wide for its depth.
pub(super) fn check(scene: &Scene) -> Result<(), Problem> {
    let facets = matches!(scene.device.kind, Kind::Taxel4x4 | Kind::Taxel4x1);
    if !facets || scene.device.rows() == 0 || scene.bench.is_some() {
        return Ok(());
    }
    let (depth, facet) = (scene.layer.depth_mm, scene.layer.facet_mm);
    let skin = HalfSpace::new(scene.material.young_mpa, scene.material.poisson);
    // A colder skin is softer, as if the forces were larger.
    let softest = scene.temperature().map_or(1.0, |t| skin::softness(t.start_c.min(t.end_c)));
    for (span, act) in Act::all(scene) {
        if facet > WIDEST * depth {
            let problem = format!(
                "touches facets of `facet_mm` {facet} mm that lie `depth_mm` {depth} mm deep; allowed are \
                 facets up to {WIDEST} times as wide as deep"
            );
            return Err((span, problem));
        }
        let (normal, _) = act.reach();
        // A tip has no size to sink with: what it does where the facets are.
        let indentation = scene
            .indenter()
            .indentation(&skin, softest * normal)
            .unwrap_or_else(|| skin.displacement([0.0, 0.0, softest * normal], [0.0, 0.0, depth]));
        if indentation > depth {
            let problem = format!(
                "pushes the indenter {indentation:.2} mm into a skin of `depth_mm` {depth} mm; push less than \
                 `fz_n` {normal} N, or take a blunter [indenter], a thicker [layer] or a stiffer [material]"
            );
            return Err((span, problem));
        }
    }
    Ok(())
}
