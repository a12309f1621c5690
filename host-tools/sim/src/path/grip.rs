//! Friction limit of a contact.

use crate::contact::{HalfSpace, Indenter};
use crate::load::Load;
use crate::scene::Scene;

/// Grip of the indenter on the skin.
#[derive(Clone, Copy, Debug)]
pub struct Grip {
    /// Coulomb's coefficient of static friction.
    pub mu: f64,
    /// Coulomb's coefficient of kinetic friction.
    pub mu_kinetic: f64,
    indenter: Indenter,
    skin: HalfSpace,
}

impl Grip {
    /// Creates the grip in `scene`.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        Self {
            mu: scene.friction.mu,
            mu_kinetic: scene.friction.mu_kinetic(),
            indenter: scene.indenter(),
            skin: HalfSpace::new(scene.material.young_mpa, scene.material.poisson),
        }
    }

    /// Load within the friction limit, from the requested forces; `None` without a normal force.
    ///
    /// The limit is Coulomb's |Q| ≤ μP, for shear and torsion together the ellipse (Q/μP)² +
    /// (M/M₀)² ≤ 1 with M₀ = μ∫p r dA ([Ospina2017] §2.3). Beyond it the contact slips, and the
    /// load is the kinetic friction.
    #[must_use]
    pub fn hold(
        &self,
        point: [f64; 2],
        shear: [f64; 2],
        torsion: f64,
        normal: f64,
    ) -> Option<Load> {
        if normal <= 0.0 {
            return None;
        }
        let [x, y] = shear;
        let (asked, held) = (x.hypot(y), self.mu * normal);
        if torsion == 0.0 {
            let slip = asked > held;
            let share = if slip { self.mu_kinetic * normal / asked } else { 1.0 };
            return Some(Load { point, force: [x * share, y * share, normal], torsion, slip });
        }
        let torsion_held = self.indenter.torsion_held(&self.skin, normal, self.mu);
        // Without a lever or without friction no load is held.
        let used = (asked / held).hypot(torsion / torsion_held);
        let slip = used > 1.0;
        let slipping = if used.is_finite() { self.mu_kinetic / self.mu / used } else { 0.0 };
        let share = if slip { slipping } else { 1.0 };
        let [x, y, torsion] = [x, y, torsion].map(|asked| asked * share);
        Some(Load { point, force: [x, y, normal], torsion, slip })
    }
}
