//! Matrix of OHKA-COLUMN above four [columns](taxel_papers::column) ([Ohka2004]).
//!
//! Phototransistors 2i, 2i+1 of rows 2j, 2j+1 look at the cones of column (i, j), each at one, and
//! gather its light. S1 is at (+x, +y) of its column, S2 at (−x, +y), S3 at (−x, −y), S4 at (+x,
//! −y). In a lit step the edge light is on and one row is read; in a dark step the light is off.

use rand_distr::{Distribution as _, StandardNormal};
use taxel::scan::{COLS, TAXELS};
use taxel_papers::column::{COLUMNS, areas, below};

use super::feeler::BACKGROUND;
use crate::load::Load;
use crate::scene::{Effect, Scene};
use crate::seeds::{Purpose, stream};

/// Light of a cone, in full scales per mm² of contact.
///
/// The largest area in range, half of A_z at 0.3 N, gives three quarters of full scale.
pub const LIGHT_PER_MM2: f64 = 1.25;
/// Relative spread of gain between phototransistors of one die, one standard deviation.
const GAIN_SPREAD: f64 = 0.01;

/// The four columns of a device.
#[derive(Clone, Debug)]
pub struct Columns {
    gains: [f64; TAXELS],
}

impl Columns {
    /// Creates the columns of the scene's device.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        let mut gains = [1.0; TAXELS];
        if scene.has(Effect::GainSpread) {
            let mut rng = stream(scene.device.seed, Purpose::GainSpread);
            for gain in &mut gains {
                let unit: f64 = StandardNormal.sample(&mut rng);
                *gain += GAIN_SPREAD * unit.clamp(-3.0, 3.0);
            }
        }
        Self { gains }
    }

    /// Light on each phototransistor above the dark, in full scales.
    ///
    /// `loads` are on the tips of columns.
    #[must_use]
    pub fn light(&self, loads: &[Load]) -> [f64; TAXELS] {
        let mut forces = [[0.0; 3]; COLUMNS];
        for load in loads {
            if let Some(force) = below(load.point).and_then(|column| forces.get_mut(column)) {
                force.iter_mut().zip(load.force).for_each(|(sum, part)| *sum += part);
            }
        }
        let mut light = self.gains.map(|gain| gain * BACKGROUND);
        for (k, (light, gain)) in light.iter_mut().zip(&self.gains).enumerate() {
            let (row, column) = (k / COLS, k % COLS);
            let [s1, s2, s3, s4] =
                forces.get(2 * (row / 2) + column / 2).map_or([0.0; 4], |force| areas(*force));
            let area = [[s3, s4], [s2, s1]].as_flattened().get(2 * (row % 2) + column % 2).copied();
            *light += gain * LIGHT_PER_MM2 * area.unwrap_or(0.0);
        }
        light
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use taxel_papers::column::{CENTRES, HORIZONTAL, MOST_N, SHRINKAGE, VERTICAL};

    /// Force from the four areas: eqs (1) to (3) and (18).
    fn force([s1, s2, s3, s4]: [f64; 4]) -> [f64; 3] {
        let (x, y, z) = (s1 - s2 - s3 + s4, s1 + s2 - s3 - s4, s1 + s2 + s3 + s4);
        let sensitivity = HORIZONTAL - SHRINKAGE * z;
        [sensitivity * x, sensitivity * y, VERTICAL * z]
    }

    proptest! {
        #[test]
        fn column_equations_invert_the_force(
            x in -0.35..0.35f64, y in -0.35..0.35f64, fz in 0.001..MOST_N,
        ) {
            let sensitivity = HORIZONTAL - SHRINKAGE * fz / VERTICAL;
            // Limit of shear at which a cone would lift, F_x + F_y = sensitivity A_z.
            let limit = sensitivity * fz / VERTICAL;
            let asked = [x * limit, y * limit, fz];
            for (found, asked) in force(areas(asked)).into_iter().zip(asked) {
                prop_assert!((found - asked).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn lifted_cone_gives_no_light() {
        let [s1, s2, s3, s4] = areas([0.2, 0.0, 0.1]);
        assert!(s1 > 0.0 && s4 > 0.0);
        assert_eq!([s2, s3], [0.0; 2]);
    }

    #[test]
    fn each_column_lights_its_own_four_taxels() {
        let scene = Scene::parse("test.toml", "[scan]\nrate_hz = 1000\nduration_s = 1\n").unwrap();
        let columns = Columns::new(&scene);
        let rest = columns.light(&[]);
        for (column, point) in CENTRES.into_iter().enumerate() {
            assert_eq!(below(point), Some(column));
            let load = Load { point, force: [0.02, 0.01, 0.1], ..Load::default() };
            let light = columns.light(&[load]);
            let lit: Vec<usize> = (0..TAXELS).filter(|k| light[*k] != rest[*k]).collect();
            let first = 8 * (column / 2) + 2 * (column % 2);
            assert_eq!(lit, [first, first + 1, first + 4, first + 5]);
            let [s3, s4, s2, s1] = [0, 1, 4, 5].map(|k| light[first + k] - rest[first]);
            assert!(s4 > s3 && s1 > s2 && s2 > s3 && s1 > s4);
            let areas = [s1, s2, s3, s4].map(|light| light / LIGHT_PER_MM2);
            let found = force(areas);
            assert!(found.iter().zip(load.force).all(|(f, asked)| (f - asked).abs() < 1e-12));
        }
    }

    #[test]
    fn largest_load_stays_in_converter_range() {
        let scene = Scene::parse("test.toml", "[scan]\nrate_hz = 1000\nduration_s = 1\n").unwrap();
        let limit = (HORIZONTAL - SHRINKAGE * MOST_N / VERTICAL) * MOST_N / VERTICAL;
        let load = Load {
            point: CENTRES[0],
            force: [0.5 * limit, 0.5 * limit, MOST_N],
            ..Load::default()
        };
        let most = Columns::new(&scene).light(&[load]).into_iter().fold(0.0f64, f64::max);
        assert!(most < 0.8, "{most}");
    }
}
