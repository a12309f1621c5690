//! The skin as a layer bonded to a rigid frame, with a window open under each facet.
//!
//! By Betti's theorem one solution per facet (module `windows`) serves every contact. The mean
//! displacement of facet q under a load on the skin equals the skin's displacement at the load,
//! along the load. For the latter, one newton pushes facet q from below. The solution is kept as a
//! Fourier series and as a table of that series, read by cubic interpolation.

use core::f64::consts::TAU;

use taxel::scan::TAXELS;

use super::{HalfSpace, Patch, Rule};

mod bonded;
mod spectrum;
mod windows;

pub use bonded::Bonded;
use windows::{Resolution, Windows};

/// Values at one place of the skin: three directions for each of the facets.
const EACH: usize = 3 * TAXELS;
type Response = [f64; EACH];

/// Grid points of the table per thickness.
const PER_THICKNESS: f64 = 12.0;

/// Layer on its frame.
#[derive(Clone, Debug)]
pub struct Layer {
    series: Series,
    table: Table,
}

impl Layer {
    /// Range of thicknesses in mm for which [`Self::ERROR`] holds.
    ///
    /// Tested at the corners of the three ranges.
    pub const THICKNESS_MM: [f64; 2] = [2.5, 4.0];
    /// Range of facet sides in mm for which [`Self::ERROR`] holds.
    pub const FACET_MM: [f64; 2] = [1.6, 1.9];
    /// Range of Poisson's ratios for which [`Self::ERROR`] holds.
    pub const POISSON: [f64; 2] = [0.4, 0.5];
    /// Largest error of a facet over the largest facet's displacement, against a finer solution
    /// whose frequencies reach 400.
    pub const ERROR: f64 = 0.01;

    /// Creates a layer of `thickness_mm` of the material of `skin`, with windows of `facet_mm`.
    #[must_use]
    pub fn new(skin: HalfSpace, thickness_mm: f64, facet_mm: f64) -> Self {
        let series = Series::new(skin, thickness_mm, facet_mm, &Resolution::USUAL);
        let table = Table::new(&series, thickness_mm);
        Self { series, table }
    }

    /// Number of table places, or of series terms if `exact`, that a disc reads.
    ///
    /// `rule` spreads the disc into point loads.
    #[must_use]
    pub fn evaluations(&self, rule: &Rule, exact: bool) -> u64 {
        let each = if exact { self.series.coefficients.len() } else { 16 };
        (rule.points().len() * each) as u64
    }

    /// Mean displacement of each facet in mm, positive down, from the table.
    #[must_use]
    pub fn displacement<'a>(
        &self,
        rule: &Rule,
        patches: impl IntoIterator<Item = &'a Patch>,
    ) -> [f64; TAXELS] {
        let mut facets = [0.0; TAXELS];
        for patch in patches {
            self.table.add(&mut facets, rule, patch);
        }
        facets
    }

    /// Mean displacement of each facet in mm, positive down, from the series.
    ///
    /// The series is slower than the table, without the error of interpolation.
    #[must_use]
    pub fn exact_displacement<'a>(
        &self,
        rule: &Rule,
        patches: impl IntoIterator<Item = &'a Patch>,
    ) -> [f64; TAXELS] {
        gather(rule, patches, |at| self.series.at(at))
    }
}

fn gather<'a>(
    rule: &Rule,
    patches: impl IntoIterator<Item = &'a Patch>,
    response: impl Fn([f64; 2]) -> Response,
) -> [f64; TAXELS] {
    let mut facets = [0.0; TAXELS];
    for patch in patches {
        for (at, force) in patch.loads(rule) {
            let response = response(at);
            for (facet, each) in facets.iter_mut().zip(response.chunks_exact(3)) {
                *facet += each.iter().zip(force).map(|(u, f)| u * f).sum::<f64>();
            }
        }
    }
    facets
}

/// Displacement of the upper face as Σ_k u_k e^{ik·x}, one for each pushed facet.
///
/// Only k_x ≥ 0 is kept, because the other half is conjugate.
#[derive(Clone, Debug)]
struct Series {
    step: f64,
    reach: usize,
    /// Real and imaginary parts at (i·(2·reach + 1) + j + reach) for k = step·(i, j).
    coefficients: Vec<[Response; 2]>,
}

impl Series {
    fn new(skin: HalfSpace, thickness: f64, facet: f64, resolution: &Resolution) -> Self {
        let windows = Windows::new(thickness, facet, skin.poisson(), resolution);
        let period = resolution.period(thickness);
        let step = TAU / period;
        let reach = (resolution.shortest / thickness / step).ceil() as usize;
        let scale = 1.0 / (period * period * skin.shear_modulus());
        let across = -(reach as i32)..=reach as i32;
        let coefficients = (0..=reach).flat_map(|i| across.clone().map(move |j| (i, j)));
        let coefficients = coefficients.map(|(i, j)| {
            let k = [i as f64 * step, f64::from(j) * step];
            let twice = if i == 0 { scale } else { 2.0 * scale };
            let mut both = [[0.0; EACH]; 2];
            let [real, imaginary] = &mut both;
            let places = real.chunks_exact_mut(3).zip(imaginary.chunks_exact_mut(3));
            for ((real, imaginary), face) in places.zip(windows.upper_face(k)) {
                for ((real, imaginary), [re, im]) in real.iter_mut().zip(imaginary).zip(face) {
                    (*real, *imaginary) = (re * twice, im * twice);
                }
            }
            both
        });
        Self { step, reach, coefficients: coefficients.collect() }
    }

    fn period(&self) -> f64 {
        TAU / self.step
    }

    fn at(&self, [x, y]: [f64; 2]) -> Response {
        self.sum(&self.column(x), y)
    }

    /// Sums the series over k_x at `x`; one term remains for each k_y.
    fn column(&self, x: f64) -> Vec<[Response; 2]> {
        let width = 2 * self.reach + 1;
        let mut column = vec![[[0.0; EACH]; 2]; width];
        for (i, row) in self.coefficients.chunks_exact(width).enumerate() {
            let (sin, cos) = (i as f64 * self.step * x).sin_cos();
            for ([real, imaginary], [re, im]) in column.iter_mut().zip(row) {
                for ((real, imaginary), (re, im)) in
                    real.iter_mut().zip(imaginary).zip(re.iter().zip(im))
                {
                    *real += re * cos - im * sin;
                    *imaginary += re * sin + im * cos;
                }
            }
        }
        column
    }

    fn sum(&self, column: &[[Response; 2]], y: f64) -> Response {
        let mut sum = [0.0; EACH];
        for (j, [real, imaginary]) in column.iter().enumerate() {
            let (sin, cos) = ((j as f64 - self.reach as f64) * self.step * y).sin_cos();
            for (sum, (re, im)) in sum.iter_mut().zip(real.iter().zip(imaginary)) {
                *sum += re * cos - im * sin;
            }
        }
        sum
    }
}

/// Values of the series on a square grid over one period.
#[derive(Clone, Debug)]
struct Table {
    spacing: f64,
    along: usize,
    /// Row after row, x fastest: for each direction of a force, the facets.
    places: Vec<[[f64; TAXELS]; 3]>,
}

impl Table {
    fn new(series: &Series, thickness: f64) -> Self {
        let along = (series.period() / thickness * PER_THICKNESS).ceil() as usize;
        let spacing = series.period() / along as f64;
        let columns: Vec<_> = (0..along).map(|i| series.column(i as f64 * spacing)).collect();
        let places = (0..along).flat_map(|j| {
            columns.iter().map(move |column| by_direction(&series.sum(column, j as f64 * spacing)))
        });
        Self { spacing, along, places: places.collect() }
    }

    /// Adds the displacement of the facets under one patch.
    ///
    /// The shares of the point loads are first spread over the grid points around them, with the
    /// weights of Lagrange's cubic through the four nearest in each direction. Loads of one patch
    /// have most of their grid points in common, and each of these is read once.
    fn add(&self, facets: &mut [f64; TAXELS], rule: &Rule, patch: &Patch) {
        // Grid points along one axis: the first, and how many.
        let range = |centre: f64, [along, across]: [f64; 2]| {
            // A hair more than the patch, for rounding.
            let reach = (along.abs() + across.abs()) * (1.0 + 1e-9);
            let ((low, _), (high, _)) = (self.split(centre - reach), self.split(centre + reach));
            (low, (high - low) as usize + 4)
        };
        let ([cx, cy], [ux, uy], [vx, vy]) = (patch.centre, patch.along, patch.across);
        let ((left, width), (low, height)) = (range(cx, [ux, vx]), range(cy, [uy, vy]));
        // Torsion also takes the shares times the offsets from the centre.
        let spin = patch.spin(rule);
        let mut planes = vec![vec![0.0; width * height]; if spin == 0.0 { 1 } else { 3 }];
        for ([x, y], share) in patch.places(rule) {
            let ((column, along_x), (row, along_y)) = (self.split(cx + x), self.split(cy + y));
            let first = (row - low) as usize * width + (column - left) as usize;
            for (plane, factor) in planes.iter_mut().zip([share, share * x, share * y]) {
                let rows = plane.get_mut(first..).into_iter().flat_map(|p| p.chunks_mut(width));
                for (row, along_y) in rows.zip(along_y) {
                    let Some(row) = row.first_chunk_mut::<4>() else { continue };
                    let weight = factor * along_y;
                    *row = core::array::from_fn(|i| row[i] + weight * along_x[i]);
                }
            }
        }
        let wrapped = |at: i64| at.rem_euclid(self.along as i64) as usize;
        let [qx, qy, p] = patch.force;
        let mut cells = planes.iter().map(|plane| plane.iter().copied());
        let [mut shares, mut along, mut across] =
            [(); 3].map(|()| cells.next().into_iter().flatten());
        for y in low..low + height as i64 {
            let (row, mut column) = (wrapped(y) * self.along, wrapped(left));
            for share in shares.by_ref().take(width) {
                let [along, across] = [&mut along, &mut across].map(|p| p.next().unwrap_or(0.0));
                let force = [qx * share - spin * across, qy * share + spin * along, p * share];
                let place = self.places.get(row + column);
                for (f, of_facets) in force.iter().zip(place.into_iter().flatten()) {
                    if *f != 0.0 {
                        *facets = core::array::from_fn(|i| facets[i] + f * of_facets[i]);
                    }
                }
                column = if column + 1 == self.along { 0 } else { column + 1 };
            }
        }
    }

    /// First of the four grid points nearest to `at` along one axis, and Lagrange's weights of all.
    fn split(&self, at: f64) -> (i64, [f64; 4]) {
        let at = at / self.spacing;
        let cut = at as i64;
        let below = if cut as f64 > at { cut - 1 } else { cut };
        let t = at - below as f64;
        let weights = [
            -t * (t - 1.0) * (t - 2.0) / 6.0,
            (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
            -(t + 1.0) * t * (t - 2.0) / 2.0,
            (t + 1.0) * t * (t - 1.0) / 6.0,
        ];
        (below - 1, weights)
    }
}

/// Facets of each direction, from directions of each facet.
fn by_direction(response: &Response) -> [[f64; TAXELS]; 3] {
    let mut places = [[0.0; TAXELS]; 3];
    for (facet, each) in response.chunks_exact(3).enumerate() {
        for (of_facets, u) in places.iter_mut().zip(each) {
            if let Some(place) = of_facets.get_mut(facet) {
                *place = *u;
            }
        }
    }
    places
}

#[cfg(test)]
mod tests {
    use super::super::traction::Round;
    use super::super::{Facets, Indenter, SILICONE_YOUNG_MPA};
    use super::*;
    use std::sync::LazyLock;

    const SPHERE: Indenter = Indenter::Sphere { radius: 6.0 };
    static SKIN: LazyLock<HalfSpace> = LazyLock::new(|| HalfSpace::new(SILICONE_YOUNG_MPA, 0.5));
    static LAYER: LazyLock<Layer> = LazyLock::new(|| Layer::new(*SKIN, 2.5, 1.9));

    fn fine() -> Rule {
        Rule::round(Round::Hertz, 8, 16)
    }

    fn most(u: &[f64; TAXELS]) -> f64 {
        u.iter().fold(0.0, |m, u| m.max(u.abs()))
    }

    #[test]
    fn table_agrees_with_series() {
        for (centre, force) in [
            ([0.0, 0.0], [0.3, 0.0, 1.0]),
            ([3.1, -4.9], [0.0, 0.0, 0.05]),
            ([1.25, 0.7], [0.1; 3]),
        ] {
            let patches = SPHERE.tractions(&SKIN, centre, force, 0.0, 0.8);
            let exact = LAYER.exact_displacement(&fine(), patches.iter().flatten());
            let read = LAYER.displacement(&fine(), patches.iter().flatten());
            for (exact, read) in exact.iter().zip(read) {
                assert!((exact - read).abs() < 1e-4 * most(&exact_of(&patches)), "{centre:?}");
            }
        }
    }

    fn exact_of(patches: &[Option<Patch>; 2]) -> [f64; TAXELS] {
        LAYER.exact_displacement(&fine(), patches.iter().flatten())
    }

    #[test]
    fn small_window_moves_with_floor_pressure() {
        // A window that is small against the layer is a hole in a bonded floor. It moves by its own
        // compliance times the pressure that the floor takes there, which is an independent
        // solution.
        let side = 0.8;
        let small = Layer::new(*SKIN, 2.5, side);
        let alone =
            Windows::new(2.5, side, 0.5, &Resolution::USUAL).means(5)[5] / SKIN.shear_modulus();
        let floor = Bonded::new(*SKIN, 2.5);
        // Further away, the shear on the floor and the other windows count too.
        for x in [-1.25, -0.6, 0.0] {
            let patch = Patch::disc([x, -1.25], 0.0, [0.0, 0.0, 1.0]);
            let found = small.exact_displacement(&Rule::point(), [&patch])[5];
            let pressure = floor.pressure(1.0, x + 1.25);
            let expected = alone * side * side * pressure;
            assert!((found / expected - 1.0).abs() < 0.05, "{x}: {found} for {expected}");
        }
    }

    #[test]
    fn half_space_overestimates_framed_skin() {
        // docs/simulator.md quotes these: one newton of a 6 mm sphere above a window and between
        // four. Each list is the largest facet framed and on the half-space, then r2c0 over the
        // largest in both.
        let half = Facets::new(*SKIN, 2.5, 1.9, 4);
        for (centre, quoted) in [
            ([1.25, 1.25], [0.157, 0.591, 0.017, 0.379]),
            ([0.0, 0.0], [0.0995, 0.492, 0.127, 0.584]),
        ] {
            let patches = SPHERE.tractions(&SKIN, centre, [0.0, 0.0, 1.0], 0.0, 0.8);
            let framed = exact_of(&patches);
            let free = half.displacement(&fine(), patches.iter().flatten());
            let found =
                [most(&framed), most(&free), framed[8] / most(&framed), free[8] / most(&free)];
            for (found, quoted) in found.into_iter().zip(quoted) {
                assert!((found - quoted).abs() < 0.000_51, "{centre:?}: {found} for {quoted}");
            }
        }
    }

    /// Error of the top rung against a solution finer in every parameter, which docs/simulator.md
    /// quotes.
    #[test]
    fn layer_is_within_one_seventh_percent_of_finer() {
        let finer = Resolution { degrees: 4, reach: 400.0, apart: 6.0, shortest: 18.0 };
        let finer = Series::new(*SKIN, 2.5, 1.9, &finer);
        let rule = Rule::round(Round::Hertz, 16, 32);
        for (centre, force) in [
            ([1.25, 1.25], [0.0, 0.0, 1.0]),
            ([0.0, 0.0], [0.0, 0.0, 1.0]),
            ([1.25, 0.0], [0.4, 0.2, 1.5]),
            ([3.9, -4.2], [0.0, 0.0, 0.5]),
        ] {
            let patches = SPHERE.tractions(&SKIN, centre, force, 0.0, 0.8);
            let usual = exact_of(&patches);
            let best = gather(&rule, patches.iter().flatten(), |at| finer.at(at));
            let errors = usual.iter().zip(best).map(|(usual, best)| (usual - best).abs());
            let worst = errors.fold(0.0, f64::max) / most(&best);
            assert!(worst < 0.0014, "{centre:?}: {worst}");
        }
    }

    #[test]
    fn shear_lowers_window_ahead_raises_behind() {
        let patches = [Some(Patch::disc([0.0; 2], 1.0, [0.5, 0.0, 0.0])), None];
        let u = exact_of(&patches);
        assert!(u[6] > 0.0 && u[5] < 0.0 && (u[6] + u[5]).abs() < 1e-9);
    }

    /// Tests of finer series.
    mod endurance {
        use super::*;

        /// Both ends of every range in all combinations.
        ///
        /// The contacts reach over the rim as far as allowed.
        #[test]
        fn stated_error_holds_at_range_corners() {
            let ([thin, thick], [narrow, wide]) = (Layer::THICKNESS_MM, Layer::FACET_MM);
            let [loose, tight] = Layer::POISSON;
            // The fourth polynomial is covered by another test.
            let finer = Resolution { degrees: 3, reach: 400.0, apart: 6.0, shortest: 18.0 };
            let rule = Rule::round(Round::Hertz, 4, 12);
            for (depth, facet, poisson) in [
                (thin, wide, loose),
                (thin, narrow, tight),
                (thick, narrow, loose),
                (thick, wide, tight),
            ] {
                let skin = HalfSpace::new(SILICONE_YOUNG_MPA, poisson);
                let usual = Series::new(skin, depth, facet, &Resolution::USUAL);
                let finer = Series::new(skin, depth, facet, &finer);
                for (centre, radius, force) in [
                    ([1.25, 1.25], 1.0, [0.0, 0.0, 1.0]),
                    ([0.0, 0.0], 2.0, [0.0, 0.0, 1.0]),
                    ([1.25, 0.0], 0.7, [1.0, 0.0, 0.0]),
                    ([0.0, 0.0], 0.0, [0.0, 0.0, 1.0]),
                    ([3.9, -4.2], 2.0, [0.4, 0.2, 1.0]),
                    ([5.0, 5.0], 3.0, [0.3, 0.0, 0.5]),
                ] {
                    let patch = Patch::disc(centre, radius, force);
                    let found = gather(&rule, [&patch], |at| usual.at(at));
                    let best = gather(&rule, [&patch], |at| finer.at(at));
                    let errors = found.iter().zip(best).map(|(found, best)| (found - best).abs());
                    let worst = errors.fold(0.0, f64::max) / most(&best);
                    assert!(worst < Layer::ERROR, "{depth} {facet} {poisson} {centre:?}: {worst}");
                }
            }
        }
    }
}
