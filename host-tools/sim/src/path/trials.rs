//! Motion and force of the papers' experiments.

use taxel_papers::column::{CENTRES, COLUMNS, SPRING, TIP_MM};

use super::Grip;
use super::motion::pulse;
use crate::load::{Contacts, Load};
use crate::scene::{Grid, Plate};

impl Grid {
    /// Load of the press at `since`: angles change fastest, then x.
    pub(super) fn at(&self, since: f64, grip: &Grip) -> Option<Load> {
        let press = (since / self.each_s) as u64;
        if press >= self.presses() {
            return None;
        }
        let step = |[first, last]: [f64; 2], index: u64, of: u32| {
            first + (last - first) * index as f64 / f64::from(of.max(2) - 1)
        };
        let [angles, columns] = [self.angles, self.columns].map(|n| u64::from(n.get()));
        let angle = step(self.angle_deg, press % angles, self.angles.get()).to_radians();
        let x = step(self.x_mm, press / angles % columns, self.columns.get());
        let y = step(self.y_mm, press / angles / columns, self.rows.get());
        // The press rests for a tenth at both ends, with a rise, a hold and a fall between.
        let force = self.force_n * pulse(since / self.each_s - press as f64 - 0.1, 0.2, 0.4, 0.2);
        grip.hold([x, y], [force * angle.cos(), 0.0], 0.0, force * angle.sin())
    }
}

/// Distance in mm from the middle at which the edge of a step begins and ends.
///
/// Both ends lie beyond the columns.
const EDGE_MM: f64 = 6.0;

impl Plate {
    /// Loads of the columns: the plate's depth shortens each, and none is pulled.
    pub(super) fn at(&self, since: f64, grip: &Grip) -> Contacts {
        let share = pulse(since, self.rise_s, self.travel_s, self.fall_s);
        let way = ((since - self.rise_s) / self.travel_s).clamp(0.0, 1.0);
        let edge = EDGE_MM * (1.0 - 2.0 * way);
        let rubs = if self.rubs { pulse(way, 0.05, 0.9, 0.05) } else { 0.0 };
        let slope = self.incline_deg.to_radians().tan();
        let mut contacts = Contacts::default();
        for [x, y] in CENTRES {
            // The edge moves over a column within the width of its tip.
            let raised = (0.5 + (x - edge) / (2.0 * TIP_MM)).clamp(0.0, 1.0);
            let flat = self.fz_n / (SPRING * COLUMNS as f64);
            let normal = share * SPRING * (flat + slope * x + raised * self.step_mm).max(0.0);
            let shear = [-grip.mu * rubs * normal, 0.0];
            if let Some(load) = grip.hold([x, y], shear, 0.0, normal) {
                contacts.push(Load { slip: rubs >= 1.0, ..load });
            }
        }
        contacts
    }
}
