//! Force of one three-axis MEMS sensor: f = S(u − b) ([Ospina2017] eqs (1.19)–(1.21)).

use serde::{Deserialize, Serialize};

/// Full 3×3 sensitivity matrix S in newtons per fraction of full scale, crosstalk included.
///
/// Row i gives component i of the force: f_i = Σ S_ij·(u − b)_j.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sensitivity(pub [[f32; 3]; 3]);

impl Sensitivity {
    /// Returns S·(u − b): newtons in x, y, z.
    #[must_use]
    #[inline]
    pub fn force(&self, signal: [f32; 3]) -> [f32; 3] {
        let [u, v, w] = signal;
        self.0.map(|[x, y, z]| x * u + y * v + z * w)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_force_components_and_columns_are_bridge_outputs() {
        let s = Sensitivity([[1.0, 2.0, 3.0], [0.0, 10.0, 0.0], [0.0, 0.0, 100.0]]);
        assert_eq!(s.force([1.0, 1.0, 1.0]), [6.0, 10.0, 100.0]);
        assert_eq!(s.force([0.0, 0.0, 1.0]), [3.0, 0.0, 100.0]);
    }
}
