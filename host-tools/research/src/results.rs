//! Results of judging: error and cost of each quantity, method and scene.

use crate::costs::Cost;
use crate::device::Moment;
use crate::methods::{Group, Said};

/// Quantity on which a method is judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Normal force f_z.
    Normal,
    /// Shear force per component, f_x and f_y.
    Shear,
    /// Distance of the contact point from the true one.
    Point,
    /// Position of the contact along a line.
    Place,
    /// Angle of the force to the skin.
    Angle,
    /// Torsion about the normal.
    Torsion,
    /// Slip margin, the unused share of the friction.
    Margin,
    /// Gross slip; the squared error is the share of wrong frames.
    Slide,
}

impl Quantity {
    /// Returns its name in the tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal force",
            Self::Shear => "shear force",
            Self::Point | Self::Place => "contact point",
            Self::Angle => "angle",
            Self::Torsion => "torsion",
            Self::Margin => "slip margin",
            Self::Slide => "slide",
        }
    }

    /// Returns the unit of its error.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Normal | Self::Shear => "N",
            Self::Point | Self::Place => "mm",
            Self::Angle => "°",
            Self::Torsion => "N·mm",
            Self::Margin | Self::Slide => "1",
        }
    }

    /// Returns the error's unit in the pictures and how many of it make one of [`Self::unit`].
    pub(crate) fn shown(self) -> (&'static str, f64) {
        match self {
            Self::Normal | Self::Shear => ("mN", 1e3),
            Self::Point | Self::Place => ("µm", 1e3),
            Self::Angle => ("°", 1.0),
            Self::Torsion => ("N·µm", 1e3),
            Self::Margin | Self::Slide => ("%", 1e2),
        }
    }

    /// Returns the squared error if both the value and the truth exist.
    pub(crate) fn squared(self, said: &Said, moment: &Moment) -> Option<f64> {
        let truth = &moment.sample.truth;
        let off = |axis: usize| Some((said.force[axis]? - truth.force[axis]?).powi(2));
        match self {
            Self::Normal => off(2),
            Self::Shear => Some(0.5 * (off(0)? + off(1)?)),
            Self::Point => {
                let ([x, y], [tx, ty]) = (said.point?, truth.point);
                Some((x - tx?).powi(2) + (y - ty?).powi(2))
            }
            Self::Place => Some((said.point?[0] - truth.point[0]?).powi(2)),
            Self::Angle => {
                let asked = truth.force[2]?.atan2(truth.force[0]?).to_degrees();
                Some((said.angle? - asked).powi(2))
            }
            Self::Torsion => Some((said.torsion? - truth.torsion?).powi(2)),
            Self::Margin => Some((said.margin? - moment.beyond.margin?).powi(2)),
            Self::Slide => Some(f64::from(u8::from(said.slides? != truth.slip?))),
        }
    }
}

/// Error and cost of a method on a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the method.
    pub name: String,
    /// Kind of the method.
    pub group: Group,
    /// Name of the scene.
    pub scene: &'static str,
    /// Judged quantity.
    pub quantity: Quantity,
    /// RMS error, the mean over the devices.
    pub rmse: f64,
    /// Cost of an estimate.
    pub cost: Cost,
}

/// Scene and quantity of a chart's panel.
pub(crate) type Title<'t> = (&'t str, Quantity);

/// Returns the Pareto front of one panel, the cheapest row first.
///
/// Rows that need force sensors are left out, because no choice of method puts sensors into a
/// finger.
#[must_use]
pub fn front<'r>(rows: &[&'r Row]) -> Vec<&'r Row> {
    let of_matrix = |row: &&&Row| !matches!(row.group, Group::Sensors | Group::Finger);
    let mut sorted: Vec<&Row> = rows.iter().filter(of_matrix).copied().collect();
    sorted.sort_by(|a, b| {
        a.cost.cycles().total_cmp(&b.cost.cycles()).then(a.rmse.total_cmp(&b.rmse))
    });
    let mut front: Vec<&Row> = Vec::new();
    for row in sorted {
        if front.last().is_none_or(|best| row.rmse < best.rmse) {
            front.push(row);
        }
    }
    front
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(cycles: u64, rmse: f64) -> Row {
        Row {
            name: String::new(),
            group: Group::Net,
            scene: "press",
            quantity: Quantity::Normal,
            rmse,
            cost: Cost { instructions: 0, cycles_low: cycles, cycles_high: cycles },
        }
    }

    #[test]
    fn front_holds_rows_unbeaten_in_cost_and_error() {
        let sensors = Row { group: Group::Sensors, ..row(10, 0.1) };
        let rows =
            [row(100, 3.0), row(200, 1.0), row(150, 4.0), row(100, 2.0), row(300, 1.0), sensors];
        let front = front(&rows.each_ref());
        assert_eq!(front, [&rows[3], &rows[1]]);
    }
}
