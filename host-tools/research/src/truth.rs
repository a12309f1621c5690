//! Truth of a scene beyond its trace: slip margin and the positions of two contacts.

use taxel_files::trace::Sample;
use taxel_sim::Scene;
use taxel_sim::contact::{HalfSpace, Indenter};
use taxel_sim::load::Load;
use taxel_sim::path::Path;

/// Smallest load in newtons that is judged.
pub(crate) const LEAST_N: f64 = 0.05;

/// Contacts of a scene.
pub(crate) struct Touches {
    path: Path,
    mu: f64,
    indenter: Indenter,
    skin: HalfSpace,
}

impl Touches {
    /// Returns the contacts of a run of `scene` with this seed.
    pub(crate) fn new(scene: &Scene, seed: u64) -> Self {
        Self {
            path: Path::new(scene, seed),
            mu: scene.friction.mu,
            indenter: scene.indenter(),
            skin: HalfSpace::new(scene.material.young_mpa, scene.material.poisson),
        }
    }

    /// Returns the truth of the scan of `sample` beyond the sample's own.
    pub(crate) fn at(&mut self, sample: &Sample) -> Beyond {
        let contacts = self.path.at(sample.scan.time.0 as f64 * 1e-6);
        match contacts.loads() {
            [one] => Beyond { margin: self.margin(one), places: None },
            [one, other] if one.force[2].min(other.force[2]) >= LEAST_N => {
                Beyond { margin: None, places: Some([one.point, other.point]) }
            }
            _ => Beyond::default(),
        }
    }

    /// Returns the unused share of a contact's friction.
    ///
    /// The limit is the ellipse of shear and torsion of the simulator's path.
    fn margin(&self, load: &Load) -> Option<f64> {
        let [fx, fy, normal] = load.force;
        if load.slip {
            return Some(0.0);
        }
        let shear = fx.hypot(fy) / (self.mu * normal);
        let turning = if load.torsion == 0.0 {
            0.0
        } else {
            load.torsion / self.indenter.torsion_held(&self.skin, normal, self.mu)
        };
        let margin = 1.0 - shear.hypot(turning);
        margin.is_finite().then(|| margin.clamp(0.0, 1.0))
    }
}

/// Truth at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Beyond {
    /// Slip margin of a single contact: 1 unloaded, 0 at gross slip.
    pub margin: Option<f64>,
    /// Positions of two contacts in mm, if both are heavy enough to be judged.
    pub places: Option<[[f64; 2]; 2]>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use taxel_sim::Simulator;

    /// Sample and truth at `at` seconds after the start.
    fn holds(acts: &str, at: f64) -> (Sample, Beyond) {
        let text = format!(
            "effects = []\n[scan]\nrate_hz = 100\nduration_s = 2\n[device]\nseed = 1\nbits = 16\n\
             [indenter]\nradius_mm = 6\n[friction]\nmu = 0.5\n{acts}"
        );
        let scene = Scene::parse("truth.toml", &text).unwrap();
        let mut touches = Touches::new(&scene, 1);
        let sample = Simulator::new(&scene, 1).nth((100.0 * at) as usize).unwrap();
        (sample, touches.at(&sample))
    }

    fn press(x_mm: f64, more: &str) -> String {
        format!(
            "[[press]]\nat_s = 0.1\nx_mm = {x_mm}\ny_mm = 0\nfz_n = 1\n{more}\nrise_s = 0.1\n\
             hold_s = 1\nfall_s = 0.1\n"
        )
    }

    #[test]
    fn shear_uses_friction_and_gross_slip_all_of_it() {
        for (shear, left) in [(0.0, 1.0), (0.2, 0.6), (0.45, 0.1), (0.6, 0.0)] {
            let (sample, beyond) = holds(&press(0.0, &format!("fx_n = {shear}")), 0.6);
            assert_eq!(sample.truth.slip, Some(shear > 0.5));
            assert!((beyond.margin.unwrap() - left).abs() < 1e-9, "{shear}: {beyond:?}");
        }
        assert_eq!(holds(&press(0.0, ""), 0.05).1, Beyond::default(), "nothing touches");
    }

    #[test]
    fn torsion_uses_friction_too() {
        let left = |torsion: f64| {
            holds(&press(0.0, &format!("torsion_nmm = {torsion}")), 0.6).1.margin.unwrap()
        };
        assert!(left(0.2) < 0.9 && left(0.4) < left(0.2) && left(9.0) == 0.0);
    }

    #[test]
    fn two_contacts_have_positions_and_no_margin() {
        let (_, beyond) = holds(&(press(-2.0, "") + &press(3.0, "")), 0.6);
        assert_eq!(beyond, Beyond { margin: None, places: Some([[-2.0, 0.0], [3.0, 0.0]]) });
    }
}
