//! Fidelity of the contact model: the cheapest rung that is accurate enough for a scene.
//!
//! | rung | the traction | what it acts on |
//! |---|---|---|
//! | `point` | one point load | half-space; with the effect `walls`, the framed layer's table |
//! | `hertz` | twelve point loads a disc | the same |
//! | `converged` | some hundred a disc, finer facets | the same |
//! | `layer` | as `converged` | the framed layer's series; implies `walls` |
//!
//! `auto` measures every rung against the top one of the physics that the scene lists: `converged`
//! or, with `walls`, `layer`. It compares them at moments of every act (module `probes`) and takes
//! the cheapest whose error stays under half of the scene's tolerance. The other half is for
//! moments between the probes. An error is the worst facet's, over the largest displacement that
//! the load makes.

use std::sync::Arc;

use taxel::scan::TAXELS;

use crate::contact::layer::Layer;
use crate::contact::{Facets, HalfSpace, Indenter, Patch, Rule};
use crate::load::{Contacts, Load, MOST_CONTACTS};
use crate::scene::{Fidelity, Scene};

mod probes;

use probes::probes;

/// Rung of the fidelity ladder, in order of cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rung {
    /// A point load.
    Point,
    /// Hertz traction, few points.
    Hertz,
    /// Hertz traction, converged.
    Converged,
    /// Converged, and the layer's series in place of its table.
    Layer,
}

impl Rung {
    /// All rungs in order of cost.
    pub const ALL: [Self; 4] = [Self::Point, Self::Hertz, Self::Converged, Self::Layer];
}

impl From<Rung> for Fidelity {
    fn from(rung: Rung) -> Self {
        match rung {
            Rung::Point => Self::Point,
            Rung::Hertz => Self::Hertz,
            Rung::Converged => Self::Converged,
            Rung::Layer => Self::Layer,
        }
    }
}

impl core::fmt::Display for Rung {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.pad(match self {
            Self::Point => "point",
            Self::Hertz => "hertz",
            Self::Converged => "converged",
            Self::Layer => "layer",
        })
    }
}

/// Result of the choice of a rung.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Rung that computes the frames.
    pub rung: Rung,
    /// Rung that is the reference for errors.
    pub top: Rung,
    /// Worst error of the rung at the probes, over the largest displacement.
    ///
    /// `None` if nothing was measured, because the scene names the rung or nothing touches.
    pub error: Option<f64>,
    /// Largest error that the scene allows.
    pub tolerance: f64,
    /// Evaluations for a disc on this rung.
    ///
    /// On the half-space the count is the number of point loads times the nodes of the facets. On
    /// the framed layer it is the number of table places or of terms of the series.
    pub evaluations: u64,
    /// Evaluations for a disc on the top rung.
    pub top_evaluations: u64,
}

impl core::fmt::Display for Report {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { rung, top, error, tolerance, evaluations, top_evaluations } = *self;
        write!(f, "fidelity {rung}")?;
        if let Some(error) = error {
            let (error, tolerance) = (100.0 * error, 100.0 * tolerance);
            write!(f, ", {error:.3} % off {top} of {tolerance} % allowed")?;
        }
        if top == Rung::Layer {
            write!(f, ", itself within {} %", 100.0 * Layer::ERROR)?;
        }
        match top_evaluations as f64 / evaluations.max(1) as f64 {
            times if times > 1.0 => {
                write!(f, ", computed with {times:.0} times less work than {top}")
            }
            _ => Ok(()),
        }
    }
}

/// Quadrature error allowed in a facet's mean on the rungs `point` and `hertz`.
///
/// The usual facet then needs two points each way.
const COARSE: f64 = 1.2e-3;
/// Quadrature error allowed in a facet's mean on the finer rungs.
///
/// The usual facet then needs four points each way.
const FINE: f64 = 2e-6;

/// Body on which the tractions act.
#[derive(Clone, Debug)]
enum Support {
    HalfSpace { coarse: Facets, fine: Facets },
    Framed(Arc<Layer>),
}

/// Contact with the skin of a scene, on the chosen rung.
#[derive(Clone, Debug)]
pub struct Ladder {
    skin: HalfSpace,
    indenter: Indenter,
    mu: f64,
    support: Support,
    point: Rule,
    few: Rule,
    many: Rule,
    report: Report,
}

impl Ladder {
    /// Creates the ladder of the scene; `auto` tries the path that follows from `seed`.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let skin = HalfSpace::new(scene.material.young_mpa, scene.material.poisson);
        let (depth, facet) = (scene.layer.depth_mm, scene.layer.facet_mm);
        let support = if scene.has_walls() {
            Support::Framed(Arc::new(Layer::new(skin, depth, facet)))
        } else {
            let centres = scene.device.facets();
            let [coarse, fine] = [COARSE, FINE].map(|error| {
                let along = Facets::points_along(depth, facet, error);
                Facets::below(skin, depth, facet, along, &centres)
            });
            Support::HalfSpace { coarse, fine }
        };
        Self::on(scene, seed, skin, support)
    }

    fn on(scene: &Scene, seed: u64, skin: HalfSpace, support: Support) -> Self {
        let top = match support {
            Support::HalfSpace { .. } => Rung::Converged,
            Support::Framed(_) => Rung::Layer,
        };
        let rung = match scene.fidelity() {
            Fidelity::Auto => None,
            Fidelity::Point => Some(Rung::Point),
            Fidelity::Hertz => Some(Rung::Hertz),
            Fidelity::Converged => Some(Rung::Converged),
            Fidelity::Layer => Some(Rung::Layer),
        };
        let indenter = scene.indenter();
        let mut ladder = Self {
            skin,
            indenter,
            mu: scene.friction.mu,
            support,
            point: Rule::point(),
            few: indenter.rule(2, 8),
            many: indenter.rule(8, 16),
            report: Report {
                rung: rung.unwrap_or(top),
                top,
                error: None,
                tolerance: scene.tolerance(),
                evaluations: 0,
                top_evaluations: 0,
            },
        };
        if rung.is_none() {
            let probes = probes(scene, seed);
            // Without a contact nothing is computed, and the cheapest rung is enough.
            (ladder.report.rung, ladder.report.error) = if probes.is_empty() {
                (Rung::Point, None)
            } else {
                let (rung, error) = ladder.choose(&probes, top);
                (rung, Some(error))
            };
        }
        ladder.report.evaluations = ladder.evaluations(ladder.report.rung);
        ladder.report.top_evaluations = ladder.evaluations(top);
        ladder
    }

    /// Result of the choice of a rung.
    #[must_use]
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Displacement of each facet under `contacts`, in mm.
    #[must_use]
    pub fn displacement(&self, contacts: &Contacts) -> [f64; TAXELS] {
        self.on_rung(self.report.rung, contacts)
    }

    /// Displacement of each facet under `contacts` in mm, on a given rung.
    ///
    /// `layer` computes as `converged` where there are no walls.
    #[must_use]
    pub fn on_rung(&self, rung: Rung, contacts: &Contacts) -> [f64; TAXELS] {
        let mut patches = [None; 2 * MOST_CONTACTS];
        for (load, places) in contacts.loads().iter().zip(patches.chunks_exact_mut(2)) {
            places.copy_from_slice(&self.tractions(load));
        }
        let patches = patches.iter().flatten();
        let rule = self.rule(rung);
        match &self.support {
            Support::HalfSpace { coarse, .. } if rung <= Rung::Hertz => {
                coarse.displacement(rule, patches)
            }
            Support::HalfSpace { fine, .. } => fine.displacement(rule, patches),
            Support::Framed(layer) if rung == Rung::Layer => {
                layer.exact_displacement(rule, patches)
            }
            Support::Framed(layer) => layer.displacement(rule, patches),
        }
    }

    fn tractions(&self, load: &Load) -> [Option<Patch>; 2] {
        self.indenter.tractions(&self.skin, load.point, load.force, load.torsion, self.mu)
    }

    fn rule(&self, rung: Rung) -> &Rule {
        match rung {
            Rung::Point => &self.point,
            Rung::Hertz => &self.few,
            Rung::Converged | Rung::Layer => &self.many,
        }
    }

    fn evaluations(&self, rung: Rung) -> u64 {
        let rule = self.rule(rung);
        match &self.support {
            Support::HalfSpace { coarse, .. } if rung <= Rung::Hertz => coarse.evaluations(rule),
            Support::HalfSpace { fine, .. } => fine.evaluations(rule),
            Support::Framed(layer) => layer.evaluations(rule, rung == Rung::Layer),
        }
    }

    /// Chooses the cheapest rung within half the tolerance at every probe, with its worst error.
    fn choose(&self, probes: &[Contacts], top: Rung) -> (Rung, f64) {
        let interpolation = self.interpolation(probes);
        let mut good: Vec<(Rung, f64)> = Rung::ALL
            .into_iter()
            .filter(|rung| *rung < top)
            .map(|rung| (rung, interpolation))
            .collect();
        for contacts in probes {
            let best = self.on_rung(Rung::Converged, contacts);
            for (rung, worst) in &mut good {
                let error = error(&self.on_rung(*rung, contacts), &best);
                *worst = worst.max(error + interpolation);
            }
            good.retain(|(_, worst)| *worst <= 0.5 * self.report.tolerance);
            if good.is_empty() {
                break;
            }
        }
        good.first().copied().unwrap_or((top, 0.0))
    }

    /// Error that the layer's table adds to every rung that reads it.
    ///
    /// The error depends on the position of a load between the places of the table, so that a few
    /// probes are enough. The series takes too long for all of them.
    fn interpolation(&self, probes: &[Contacts]) -> f64 {
        const LOOKS: usize = 8;
        if matches!(self.support, Support::HalfSpace { .. }) {
            return 0.0;
        }
        let looks = probes.iter().step_by(probes.len().div_ceil(LOOKS).max(1));
        let error = |at| error(&self.on_rung(Rung::Converged, at), &self.on_rung(Rung::Layer, at));
        looks.map(error).fold(0.0, f64::max)
    }
}

/// Largest difference over the largest displacement.
#[must_use]
pub fn error(of: &[f64; TAXELS], best: &[f64; TAXELS]) -> f64 {
    let most = best.iter().fold(0.0f64, |m, u| m.max(u.abs()));
    let worst = of.iter().zip(best).fold(0.0f64, |m, (u, b)| m.max((u - b).abs()));
    if most > 0.0 { worst / most } else { 0.0 }
}

#[cfg(test)]
mod tests;
