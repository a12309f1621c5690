//! Layer on a rigid frame with sixteen square windows, bonded to the frame only.
//!
//! The unknown is the displacement of the lower face in the windows. It is expanded, per window and
//! direction, in φ_m(x)φ_n(y) with φ_m = √(1 − ξ²) U_m(ξ). These functions fit because a free
//! window between clamped edges is a crack, and the displacement of a crack ends like a square
//! root. Galerkin's method uses the layer's own stiffness: the traction for a displacement of the
//! lower face while the upper one is free. It gives a symmetric positive system. The system's
//! matrix is a sum over spatial frequencies that splits into x and y.
//!
//! The layer is taken as periodic ([`Resolution::apart`]) and is all bonded between the
//! repetitions.

use core::f64::consts::{PI, TAU};

use taxel::scan::{TAXEL_CENTRES, TAXELS};

use super::spectrum::{Wave, bessel};
use crate::ranges::PAD_MM;

/// Number of directions of a displacement.
const AXES: usize = 3;

/// Numerical resolution of the layer's solution.
#[derive(Clone, Copy, Debug)]
pub struct Resolution {
    /// Number of polynomials in each direction of a window.
    pub degrees: usize,
    /// Highest wave number of the windows' own solution, times half a window's side.
    pub reach: f64,
    /// Gap from the pad to its next repetition, in thicknesses.
    pub apart: f64,
    /// Highest wave number that still reaches the upper face, times the thickness.
    pub shortest: f64,
}

impl Resolution {
    /// Resolution of the simulator.
    ///
    /// One polynomial more changes a facet's displacement by less than a thousandth, and the
    /// shortest wave arrives with e^−14. The tests of `layer` measure the remaining error.
    pub const USUAL: Self = Self { degrees: 3, reach: 150.0, apart: 4.0, shortest: 14.0 };

    /// Period of the repetition in mm.
    pub fn period(&self, thickness: f64) -> f64 {
        PAD_MM + self.apart * thickness
    }
}

/// Displacement of the lower face while one newton pushes each window in turn.
///
/// The values are for a shear modulus of 1 MPa.
#[derive(Clone, Debug)]
pub struct Windows {
    thickness: f64,
    poisson: f64,
    half_side: f64,
    degrees: usize,
    /// Coefficients for each pushed window q: window w, axis c, degrees m and n at ((w·3 +
    /// c)·degrees + m)·degrees + n.
    coefficients: Vec<Vec<f64>>,
}

impl Windows {
    /// Solves windows of `side` mm under a layer of `thickness` mm.
    ///
    /// The error of cutting off frequencies falls as one over their reach, so that a second
    /// solution of half the reach measures and removes it.
    pub fn new(thickness: f64, side: f64, poisson: f64, resolution: &Resolution) -> Self {
        let half_side = side / 2.0;
        let both = Stiffness::new(thickness, poisson, half_side, resolution);
        let [mut far, near] =
            both.map(|stiffness| Self::cut(thickness, half_side, poisson, &stiffness));
        let both = far.coefficients.iter_mut().flatten().zip(near.coefficients.iter().flatten());
        both.for_each(|(far, near)| *far += *far - near);
        far
    }

    /// Solves with only the frequencies that `stiffness` sums.
    fn cut(thickness: f64, half_side: f64, poisson: f64, stiffness: &Stiffness) -> Self {
        let degrees = stiffness.degrees;
        let mut matrix = stiffness.matrix();
        let each = AXES * degrees * degrees;
        // A uniform pressure of one newton does work on φ₀φ₀ along z only.
        let push = (PI / 4.0) * (PI / 4.0);
        let mut pushed: Vec<Vec<f64>> = (0..TAXELS)
            .map(|window| {
                let mut load = vec![0.0; TAXELS * each];
                if let Some(load) = load.get_mut(window * each + 2 * degrees * degrees) {
                    *load = push;
                }
                load
            })
            .collect();
        factor(&mut matrix);
        pushed.iter_mut().for_each(|load| substitute(&matrix, load));
        Self { thickness, poisson, half_side, degrees, coefficients: pushed }
    }

    /// Mean u_z of each window under one newton spread over window `pushed`.
    #[cfg(test)]
    pub fn means(&self, pushed: usize) -> [f64; TAXELS] {
        let each = AXES * self.degrees * self.degrees;
        core::array::from_fn(|w| {
            let at = w * each + 2 * self.degrees * self.degrees;
            self.coefficients[pushed][at] * (PI / 4.0) * (PI / 4.0)
        })
    }

    /// Fourier coefficients (real and imaginary parts) of the *upper* face's displacement at the
    /// frequency `k`, for each of the windows.
    ///
    /// One newton pushes that window; the field is Σ_k u_k e^{ik·x} / period².
    pub fn upper_face(&self, k: [f64; 2]) -> impl Iterator<Item = [[f64; 2]; AXES]> {
        let shapes = self.transforms(k);
        let size = k[0].hypot(k[1]);
        let rise = (size > 0.0).then(|| Rise::new(k, size, self.thickness, self.poisson));
        self.coefficients.iter().map(move |coefficients| {
            let mut lower = [[0.0; 2]; AXES];
            let windows = coefficients.chunks_exact(AXES * self.degrees * self.degrees);
            for (of_window, shapes) in windows.zip(shapes.chunks_exact(self.degrees.pow(2))) {
                let of_axis = of_window.chunks_exact(self.degrees * self.degrees);
                for ([real, imaginary], of_axis) in lower.iter_mut().zip(of_axis) {
                    for (c, [re, im]) in of_axis.iter().zip(shapes) {
                        *real += c * re;
                        *imaginary += c * im;
                    }
                }
            }
            rise.as_ref().map_or(lower, |rise| rise.through(lower))
        })
    }

    /// Transforms of φ_m(x)φ_n(y) of each window at the frequency `k`, real and imaginary parts.
    fn transforms(&self, k: [f64; 2]) -> Vec<[f64; 2]> {
        let [along_x, along_y] =
            k.map(|k| shapes(k * self.half_side, self.half_side, self.degrees));
        let mut transforms = Vec::with_capacity(TAXELS * self.degrees * self.degrees);
        for [x, y] in TAXEL_CENTRES {
            let turn = -(k[0] * f64::from(x.0) + k[1] * f64::from(y.0));
            for (m, fx) in along_x.iter().enumerate() {
                for (n, fy) in along_y.iter().enumerate() {
                    // (−i)^(m + n) is a number of quarter turns.
                    let (sin, cos) = (turn - 0.5 * PI * (m + n) as f64).sin_cos();
                    transforms.push([fx * fy * cos, fx * fy * sin]);
                }
            }
        }
        transforms
    }
}

/// Way of a displacement from the lower face to the upper one, at one frequency.
struct Rise {
    /// Direction of the wave in the plane.
    along: [f64; 2],
    /// Displacement of the upper face, along the wave and down, under a unit displacement of the
    /// lower face along it, and under one down.
    unit: [[f64; 2]; 2],
    across: f64,
}

impl Rise {
    fn new(k: [f64; 2], size: f64, thickness: f64, poisson: f64) -> Self {
        let unit = [[1.0, 0.0], [0.0, 1.0]]
            .map(|face| Wave::new(size, thickness, poisson, [0.0; 2], face).displacement(0.0));
        Self { along: k.map(|k| k / size), unit, across: 1.0 / (size * thickness).cosh() }
    }

    /// Displacement of the upper face, real and imaginary parts, under that of the `lower` one.
    fn through(&self, [x, y, z]: [[f64; 2]; AXES]) -> [[f64; 2]; AXES] {
        let Self { along: [cx, cy], unit, across } = *self;
        // Along and across the wave; U = −i u along.
        let part = |i: usize| {
            let at = |v: [f64; 2]| if i == 0 { v[0] } else { v[1] };
            (cx * at(x) + cy * at(y), -cy * at(x) + cx * at(y), at(z))
        };
        let ((lr, tr, zr), (li, ti, zi)) = (part(0), part(1));
        let (ur, ui) = (li, -lr);
        let (upper_ur, upper_ui) =
            (unit[0][0] * ur + unit[1][0] * zr, unit[0][0] * ui + unit[1][0] * zi);
        let (upper_zr, upper_zi) =
            (unit[0][1] * ur + unit[1][1] * zr, unit[0][1] * ui + unit[1][1] * zi);
        let (along_r, along_i) = (-upper_ui, upper_ur);
        let (across_r, across_i) = (across * tr, across * ti);
        [
            [cx * along_r - cy * across_r, cx * along_i - cy * across_i],
            [cy * along_r + cx * across_r, cy * along_i + cx * across_i],
            [upper_zr, upper_zi],
        ]
    }
}

/// Transform f_m(κ) with φ̂_m = (−i)^m f_m: aπ(m + 1)J_{m+1}(κ)/κ, κ = ka.
fn shapes(kappa: f64, half_side: f64, degrees: usize) -> Vec<f64> {
    (0..degrees)
        .map(|m| {
            // J₁(κ)/κ goes to ½, the others to nothing.
            let value = if kappa == 0.0 {
                if m == 0 { 0.5 } else { 0.0 }
            } else {
                (m + 1) as f64 * bessel(m + 1, kappa) / kappa
            };
            half_side * PI * value
        })
        .collect()
}

/// Sums over frequency from which the matrix is assembled.
struct Stiffness {
    degrees: usize,
    /// Sums by axis pair (xx, xy, xz, yy, yz, zz), then by (m, m′, columns apart) in x, then in y.
    sums: Vec<f64>,
}

/// Number of distances between windows: 0 to 3 columns apart.
const APART: usize = 4;
/// Pairs of axes and whether their stiffness is odd in k_x and in k_y.
const PAIRS: [(usize, usize, bool, bool); 6] = [
    (0, 0, false, false),
    (0, 1, true, true),
    (0, 2, true, false),
    (1, 1, false, false),
    (1, 2, false, true),
    (2, 2, false, false),
];

impl Stiffness {
    /// Sums all frequencies within reach, and those within half of it.
    fn new(thickness: f64, poisson: f64, half_side: f64, resolution: &Resolution) -> [Self; 2] {
        let (degrees, period) = (resolution.degrees, resolution.period(thickness));
        let step = TAU / period;
        let [far, near] =
            [1.0, 0.5].map(|share| (share * resolution.reach / half_side / step).ceil() as usize);
        let pitch = f64::from(taxel::scan::PITCH.0);
        let factors = degrees * degrees * APART;
        let shapes: Vec<Vec<f64>> =
            (0..far).map(|i| shapes(i as f64 * step * half_side, half_side, degrees)).collect();
        let factor = |odd: bool, at: usize, i: usize| {
            let (m, n, apart) = (at / APART / degrees, at / APART % degrees, at % APART);
            let turn = i as f64 * step * pitch * apart as f64;
            let trig = if (usize::from(odd) + m + n) % 2 == 0 { turn.cos() } else { turn.sin() };
            let twice = if i == 0 { 1.0 } else { 2.0 };
            shapes.get(i).map_or(0.0, |f| {
                f.get(m).copied().unwrap_or(0.0) * f.get(n).copied().unwrap_or(0.0)
            }) * trig
                * twice
        };
        // lines[odd][k][(m·degrees + m′)·APART + apart]: f_m f_m′ times the cosine or the sine, the
        // part of e^{ikd} that remains where the whole is even in k.
        let lines = [false, true].map(|odd| -> Vec<Vec<f64>> {
            (0..far).map(|i| (0..factors).map(|at| factor(odd, at, i)).collect()).collect()
        });
        let radial: Vec<Vec<Radial>> = (0..far)
            .map(|i| (0..=i).map(|j| Radial::new([i, j], step, thickness, poisson)).collect())
            .collect();
        let area = period.powi(2);
        let mut sums = [(); 2].map(|()| vec![0.0; PAIRS.len() * factors * factors]);
        for i in 0..far {
            let row: Vec<[f64; 6]> = (0..far)
                .map(|j| {
                    let radial = radial.get(i.max(j)).and_then(|row| row.get(i.min(j)));
                    let k = [i as f64 * step, j as f64 * step];
                    radial.map_or([0.0; 6], |radial| radial.stiffness(k).map(|s| s / area))
                })
                .collect();
            for (at, (_, _, odd_x, odd_y)) in PAIRS.into_iter().enumerate() {
                let [x, y] = [odd_x, odd_y].map(|odd| &lines[usize::from(odd)]);
                let Some(x) = x.get(i) else { continue };
                let mut inner = vec![0.0; factors];
                let mut begin = 0;
                for (reach, sums) in [near, far].into_iter().zip(&mut sums) {
                    for (line, row) in y.iter().zip(&row).take(reach).skip(begin) {
                        inner.iter_mut().zip(line).for_each(|(sum, f)| *sum += f * row[at]);
                    }
                    begin = reach;
                    let sums = sums.chunks_exact_mut(factors).skip(at * factors);
                    for (sums, x) in sums.zip(x).take(if i < reach { factors } else { 0 }) {
                        sums.iter_mut().zip(&inner).for_each(|(sum, y)| *sum += x * y);
                    }
                }
            }
        }
        let [near, far] = sums.map(|sums| Self { degrees, sums });
        [far, near]
    }

    /// Lower triangle of the stiffness matrix, row by row.
    fn matrix(&self) -> Vec<Vec<f64>> {
        let size = TAXELS * AXES * self.degrees * self.degrees;
        (0..size).map(|i| (0..=i).map(|j| self.entry(i, j)).collect()).collect()
    }

    /// Stiffness between two unknowns.
    ///
    /// The factors i^(m − m′ + n − n′), the i of the coupling to z, and one i for each sine make a
    /// real number.
    fn entry(&self, i: usize, j: usize) -> f64 {
        let split = |i: usize| {
            let (rest, n) = (i / self.degrees, i % self.degrees);
            let (rest, m) = (rest / self.degrees, rest % self.degrees);
            (rest / AXES, rest % AXES, m, n)
        };
        let ((w, a, m, n), (w2, b, m2, n2)) = (split(i), split(j));
        let swapped = a > b;
        let pair = (a.min(b), a.max(b));
        let Some((at, (_, _, odd_x, odd_y))) =
            PAIRS.iter().enumerate().find(|(_, (a, b, ..))| (*a, *b) == pair)
        else {
            return 0.0;
        };
        let apart = |w: usize, w2: usize| w as i32 - w2 as i32;
        let (dx, dy) = (apart(w % 4, w2 % 4), apart(w / 4, w2 / 4));
        let factors = self.degrees * self.degrees * APART;
        let index =
            |m: usize, n: usize, d: i32| (m * self.degrees + n) * APART + d.unsigned_abs() as usize;
        let value = self
            .sums
            .get((at * factors + index(m, m2, dx)) * factors + index(n, n2, dy))
            .copied()
            .unwrap_or(0.0);
        let mut quarters = (m + n) as i32 - (m2 + n2) as i32;
        let mut sign = 1.0;
        for (odd, degrees, d) in [(*odd_x, m + m2, dx), (*odd_y, n + n2, dy)] {
            if (usize::from(odd) + degrees) % 2 == 1 {
                quarters += 1;
                sign *= f64::from(d.signum());
            }
        }
        if pair == (0, 2) || pair == (1, 2) {
            // Hermitian: with the axes swapped, the factor is −i.
            quarters += if swapped { -1 } else { 1 };
        }
        match quarters.rem_euclid(4) {
            0 => sign * value,
            2 => -sign * value,
            _ => 0.0,
        }
    }
}

/// Stiffness of the lower face at one wave number, whatever the wave's direction in the plane.
///
/// A stiffness is the traction along the first axis for a unit displacement along the second, for a
/// shear modulus of one. Between the plane and z, a factor i is left out.
#[derive(Clone, Copy, Debug, Default)]
struct Radial {
    size: f64,
    along: f64,
    across: f64,
    mixed: f64,
    normal: f64,
}

impl Radial {
    fn new([i, j]: [usize; 2], step: f64, thickness: f64, poisson: f64) -> Self {
        let size = (i as f64 * step).hypot(j as f64 * step);
        if size == 0.0 {
            return Self::default();
        }
        let lower = |face| Wave::new(size, thickness, poisson, [0.0; 2], face).traction(thickness);
        let ([along, _], [mixed, normal]) = (lower([1.0, 0.0]), lower([0.0, 1.0]));
        let across = size * (size * thickness).tanh();
        Self { size, along, across, mixed, normal }
    }

    /// Stiffness per pair of axes of a wave with the components `k`.
    fn stiffness(&self, k: [f64; 2]) -> [f64; 6] {
        let Self { size, along, across, mixed, normal } = *self;
        if size == 0.0 {
            return [0.0; 6];
        }
        let [cx, cy] = k.map(|k| k / size);
        [
            along * cx * cx + across * cy * cy,
            (along - across) * cx * cy,
            mixed * cx,
            along * cy * cy + across * cx * cx,
            mixed * cy,
            normal,
        ]
    }
}

/// Replaces the lower triangle by its Cholesky factor.
fn factor(matrix: &mut [Vec<f64>]) {
    for i in 0..matrix.len() {
        let (done, rest) = matrix.split_at_mut(i);
        let Some(row) = rest.first_mut() else { return };
        for j in 0..=i {
            let (before, from) = row.split_at_mut(j);
            let Some(value) = from.first_mut() else { return };
            match done.get(j) {
                Some(other) => {
                    let known: f64 = before.iter().zip(other).map(|(a, b)| a * b).sum();
                    *value = (*value - known) / other.last().copied().unwrap_or(1.0);
                }
                None => {
                    let known: f64 = before.iter().map(|a| a * a).sum();
                    *value = (*value - known).max(f64::MIN_POSITIVE).sqrt();
                }
            }
        }
    }
}

/// Solves with Cholesky's factor, forwards and back.
fn substitute(factor: &[Vec<f64>], x: &mut [f64]) {
    for (i, row) in factor.iter().enumerate() {
        let (before, from) = x.split_at_mut(i);
        let known: f64 = row.iter().zip(before.iter()).map(|(a, b)| a * b).sum();
        if let (Some(value), Some(pivot)) = (from.first_mut(), row.last()) {
            *value = (*value - known) / pivot;
        }
    }
    for (i, row) in factor.iter().enumerate().rev() {
        let (before, from) = x.split_at_mut(i);
        if let (Some(value), Some(pivot)) = (from.first_mut(), row.last()) {
            *value /= pivot;
            before.iter_mut().zip(row).for_each(|(b, a)| *b -= a * *value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_polynomials_change_little() {
        let [few, many] = [3, 4].map(|degrees| {
            let resolution = Resolution { degrees, ..Resolution::USUAL };
            Windows::new(2.5, 1.9, 0.5, &resolution).means(5)
        });
        for (less, more) in few.iter().zip(many) {
            assert!((less - more).abs() < 1e-3 * few[5], "{less} {more}");
        }
    }

    #[test]
    fn window_response_is_symmetric() {
        let windows = Windows::new(2.5, 1.9, 0.5, &Resolution::USUAL);
        let [corner, inner, far] = [0, 5, 15].map(|pushed| windows.means(pushed));
        assert!((corner[5] - inner[0]).abs() < 1e-12 && (corner[15] - far[0]).abs() < 1e-12);
        assert!((inner[6] - inner[9]).abs() < 1e-12 && (inner[4] - inner[1]).abs() < 1e-12);
    }

    #[test]
    fn open_square_moves_between_its_circles() {
        // Half of a penny crack of radius c under the pressure p opens by the volume 8pc³/3E*
        // (Sneddon), E* = 4G for ν = ½; a crack that contains another opens more.
        let side = 1.9;
        let found = Windows::new(5.0, side, 0.5, &Resolution::USUAL).means(5)[5];
        let mean = |c: f64| 8.0 * c.powi(3) / (3.0 * 4.0) / (side * side) / (side * side);
        let (inside, around) = (mean(side / 2.0), mean(side / 2.0 * f64::sqrt(2.0)));
        assert!(inside < found && found < around, "{inside} {found} {around}");
    }
}
