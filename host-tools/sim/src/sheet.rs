//! Scan of OHKA-MICRO's whole [sheet](taxel_papers::sheet), one feeler after the other.
//!
//! The paper reads each feeler in its own window, cut out of the camera's picture. A scan has
//! sixteen channels and a sheet 120 windows, so that a scan is the window of one
//! [`feeler`](crate::systems::feeler). Scan k looks at feeler k mod 120, row by row from −y, along
//! x in a row. The truth of a scan is its feeler's: position, force, and slip on the board. A
//! hundred and twenty scans are a picture.
//!
//! The load of a feeler comes from the contact's traction on the sheet, normal and tangential.
//! Between feelers the lever rule divides a load over the four around it, which keeps every force
//! and the moments of the normal ones. (The paper divides the force of its flat probe by the nine
//! feelers below it.)

use taxel_papers::feeler::slips;
use taxel_papers::sheet::{PITCH_MM, centre};

use crate::contact::{HalfSpace, Indenter, Rule};
use crate::load::{Contacts, Load};

/// Sheet of one run.
#[derive(Clone, Debug)]
pub struct Sheet {
    indenter: Indenter,
    rubber: HalfSpace,
    mu: f64,
    /// Quadrature rule of the traction: within 1 % of a feeler's share (tested).
    rule: Rule,
}

impl Sheet {
    /// Creates a sheet of `rubber` under `indenter` with the coefficient of friction `mu`.
    #[must_use]
    pub fn new(indenter: Indenter, rubber: HalfSpace, mu: f64) -> Self {
        Self { rule: indenter.rule(12, 32), indenter, rubber, mu }
    }

    /// Force on one feeler in newtons, from the contacts on the sheet.
    #[must_use]
    pub fn carried(&self, feeler: usize, contacts: &Contacts) -> [f64; 3] {
        let [x, y] = centre(feeler);
        let lever = |distance: f64| (1.0 - distance.abs() / PITCH_MM).max(0.0);
        let mut carried = [0.0; 3];
        for load in contacts.loads() {
            let reach = self.indenter.reach(&self.rubber, load.force[2]) + PITCH_MM;
            if (load.point[0] - x).abs().max((load.point[1] - y).abs()) > reach {
                continue;
            }
            let patches = self.indenter.tractions(
                &self.rubber,
                load.point,
                load.force,
                load.torsion,
                self.mu,
            );
            for ([px, py], force) in patches.iter().flatten().flat_map(|p| p.loads(&self.rule)) {
                let share = lever(px - x) * lever(py - y);
                carried.iter_mut().zip(force).for_each(|(sum, part)| *sum += share * part);
            }
        }
        carried
    }

    /// Contacts that a scan of `feeler` sees: the load on that feeler only.
    #[must_use]
    pub fn seen(&self, feeler: usize, contacts: &Contacts) -> Contacts {
        let force = self.carried(feeler, contacts);
        if force[2] <= 0.0 {
            return Contacts::default();
        }
        let slip = slips(force);
        Load { point: centre(feeler), force, torsion: 0.0, slip }.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use proptest::prelude::*;
    use taxel_papers::sheet::FEELERS;

    fn sheet(indenter: &str) -> Sheet {
        let text = format!(
            "[scan]\nrate_hz = 1000\nduration_s = 1\n[device]\nkind = 'ohka-sheet'\n[material]\n\
             young_mpa = 0.476\n[friction]\nmu = 1\n[indenter]\n{indenter}\n"
        );
        Scene::parse("test.toml", &text).unwrap().sheet()
    }

    fn load(point: [f64; 2], force: [f64; 3]) -> Contacts {
        Load { point, force, ..Load::default() }.into()
    }

    #[test]
    fn tip_between_feelers_is_shared() {
        let sheet = sheet("kind = 'point'");
        let carried = |point| -> Vec<(usize, f64)> {
            let contacts = load(point, [0.001, 0.0, 0.008]);
            let of = |k| (k, sheet.carried(k, &contacts)[2]);
            (0..FEELERS).map(of).filter(|(_, normal)| *normal > 1e-12).collect()
        };
        let [alone] = carried(centre(37))[..] else { panic!("one feeler") };
        assert!(alone.0 == 37 && (alone.1 - 0.008).abs() < 1e-12);
        let [x, y] = centre(37);
        let shared = carried([x + 0.5 * PITCH_MM, y + 0.5 * PITCH_MM]);
        assert_eq!(shared.iter().map(|(k, _)| *k).collect::<Vec<_>>(), [37, 38, 47, 48]);
        assert!(shared.iter().all(|(_, normal)| (normal - 0.002).abs() < 1e-12));
    }

    #[test]
    fn feeler_carries_the_pressure_around_it() {
        // Hertz: the share of a small sphere's contact above one feeler, by a fine sum over the
        // disc.
        let sheet = sheet("radius_mm = 20");
        let force = 0.3;
        let a = sheet.rubber.contact_radius(20.0, force);
        for feeler in [54, 55, 45, 33] {
            let [fx, fy] = centre(feeler);
            let (n, mut sum) = (800, 0.0);
            for i in 0..n {
                for j in 0..n {
                    let at = |i: i32| ((f64::from(i) + 0.5) / f64::from(n) * 2.0 - 1.0) * PITCH_MM;
                    let (u, v) = (at(i), at(j));
                    let s = ((fx + u).powi(2) + (fy + v).powi(2)) / (a * a);
                    let lever = (1.0 - u.abs() / PITCH_MM) * (1.0 - v.abs() / PITCH_MM);
                    sum += lever * (1.0 - s).max(0.0).sqrt();
                }
            }
            let cell = (2.0 * PITCH_MM / f64::from(n)).powi(2);
            let fine = 1.5 * force / (std::f64::consts::PI * a * a) * sum * cell;
            let found = sheet.carried(feeler, &load([0.0; 2], [0.0, 0.0, force]))[2];
            assert!((found / fine - 1.0).abs() < 0.01, "{feeler}: {found} {fine}");
        }
    }

    #[test]
    fn sheared_contact_slips_first_at_its_rim() {
        // Cattaneo and Mindlin: the traction reaches μ times the pressure at the rim first, and a
        // feeler holds a quarter of its normal force and 0.56 mN.
        let sheet = sheet("radius_mm = 20");
        let contacts = load([0.0; 2], [0.09, 0.0, 0.3]);
        let slips: Vec<usize> = (0..FEELERS)
            .filter(|k| sheet.seen(*k, &contacts).loads().iter().any(|load| load.slip))
            .collect();
        assert!(slips.len() > 4, "{slips:?}");
        let from_middle = |k: usize| centre(k)[0].hypot(centre(k)[1]);
        assert!(slips.iter().all(|k| from_middle(*k) > 1.0), "{slips:?}");
    }

    proptest! {
        #[test]
        fn feelers_carry_force_and_moment(
            x in -1.0..1.0f64, y in -1.0..1.0f64, fx in -0.1..0.1f64, normal in 0.05..0.2f64,
            indenter in prop::sample::select(vec![
                "radius_mm = 6", "kind = 'punch'\nradius_mm = 1.2", "kind = 'corner'",
                "kind = 'block'\nwidth_mm = 1.8\nlength_mm = 1.8",
            ]),
        ) {
            let sheet = sheet(indenter);
            let contacts = load([x, y], [fx.clamp(-normal, normal), 0.0, normal]);
            let all: Vec<[f64; 3]> = (0..FEELERS).map(|k| sheet.carried(k, &contacts)).collect();
            let sum = |axis: usize| all.iter().map(|force| force[axis]).sum::<f64>();
            prop_assert!((sum(2) - normal).abs() < 1e-12);
            prop_assert!((sum(0) - contacts.loads()[0].force[0]).abs() < 1e-12);
            let moment = |axis: usize| -> f64 {
                all.iter().enumerate().map(|(k, force)| centre(k)[axis] * force[2]).sum()
            };
            prop_assert!((moment(0) - x * normal).abs() < 1e-9);
            prop_assert!((moment(1) - y * normal).abs() < 1e-9);
        }
    }
}
