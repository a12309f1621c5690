//! Displacement field of one contact in f64, with its derivatives by load and coefficients.
//!
//! The field is that of [`taxel::estimate::field`].

use nalgebra::SVector;

/// Number of coefficients of a radial function: two depths and 4 × 3 terms.
pub(super) const RADIAL: usize = 14;
/// Number of coefficients of the field: both functions and the slip share.
///
/// The slip share is that by which slip draws the traction in.
pub(super) const FIELD: usize = 2 * RADIAL + 1;
/// Index of the first term of N, which fixes the unit of length.
pub(super) const UNIT: usize = 2;
/// Number of unknowns of a row's load: f_x, f_y, f_z, x, y.
pub(super) const LOAD: usize = 5;
/// Least D in mm², as on the chip.
const LEAST_DEPTH: f64 = 0.3;

/// Coefficients of the field.
pub(super) type Coefficients = SVector<f64, FIELD>;

/// Displacement of a facet with its derivatives.
pub(super) struct Displacement {
    pub value: f64,
    pub by_load: [f64; LOAD],
    pub by_field: Coefficients,
}

/// Point load 2.5 mm deep in a half-space with ν = ½: the first start of the search.
pub(super) fn half_space() -> Coefficients {
    let mut p = SVector::zeros();
    // N = 1/ρ + z²/ρ³ = (1 + w)/ρ; T = z/ρ³.
    (p[0], p[1], p[2], p[5]) = (6.25, 2.0, 1.0, 1.0);
    (p[RADIAL], p[RADIAL + 1], p[RADIAL + 2]) = (6.25, 2.0, 2.5);
    p[FIELD - 1] = -0.3;
    p
}

/// Field of the reference finger's framed skin, device 1: the other start of the search.
pub(super) fn framed() -> Coefficients {
    Coefficients::from(FRAMED)
}

/// Fitted to the scenes `presses` (seed 1) and `shear` (seed 2) with the bench's labels.
const FRAMED: [f64; FIELD] = [
    12.1, 14.53, 1.0, -2.359, -0.7289, -3.971, 20.81, 2.579, -6.404, -47.37, -2.953, 23.91, 27.6,
    2.258, 14.13, 37.58, -3.985, 36.08, 12.9, 18.14, -144.0, -31.51, -2.648, 32.62, 31.25, 67.85,
    154.8, -30.56, -0.3,
];

/// P(w)/ρ^(2·half) with its derivatives by distance², size² and coefficients.
pub(super) struct Radial {
    value: f64,
    pub by_distance: f64,
    pub by_size: f64,
    by_own: [f64; RADIAL],
}

pub(super) fn radial(p: &[f64], distance2: f64, size2: f64, half: f64) -> Radial {
    let deep = p[0] + p[1] * size2;
    let free = deep > LEAST_DEPTH;
    let depth = deep.max(LEAST_DEPTH);
    let inverse2 = 1.0 / (distance2 + depth);
    let w = depth * inverse2;
    let lead = if half > 1.0 { inverse2 * inverse2.sqrt() } else { inverse2.sqrt() };
    let (mut sum, mut slope, mut grows) = (0.0, 0.0, 0.0);
    let mut by_own = [0.0; RADIAL];
    let mut power = 1.0;
    for (i, t) in p[2..RADIAL].chunks_exact(3).enumerate() {
        let term = t[0] + size2 * (t[1] + size2 * t[2]);
        sum += power * term;
        // w^(i − 1), for the derivative by w.
        slope += i as f64 * (power / w) * term;
        grows += power * (t[1] + 2.0 * size2 * t[2]);
        let share = lead * power;
        by_own[2 + 3 * i..5 + 3 * i].copy_from_slice(&[
            share,
            share * size2,
            share * size2 * size2,
        ]);
        power *= w;
    }
    let by_depth = lead * inverse2 * ((1.0 - w) * slope - half * sum);
    let by_depth = if free { by_depth } else { 0.0 };
    (by_own[0], by_own[1]) = (by_depth, by_depth * size2);
    Radial {
        value: lead * sum,
        by_distance: -lead * inverse2 * (w * slope + half * sum),
        by_size: by_depth * p[1] + lead * grows,
        by_own,
    }
}

/// Displacement of the facet at `centre` under `load`: f_x, f_y, f_z in newtons, x, y in mm.
pub(super) fn displacement(
    p: &Coefficients,
    load: &[f64; LOAD],
    centre: [f64; 2],
    (friction, shear): (f64, bool),
) -> Displacement {
    let [fx, fy, fz, x, y] = *load;
    let fz = fz.max(1e-6);
    let size2 = fz.cbrt().powi(2);
    let by_fz = 2.0 / 3.0 * size2 / fz;
    let (dx, dy) = (centre[0] - x, centre[1] - y);
    let distance2 = dx * dx + dy * dy;
    let n = radial(&p.as_slice()[..RADIAL], distance2, size2, 0.5);
    let mut by_field = Coefficients::zeros();
    for (by, own) in by_field.iter_mut().zip(n.by_own) {
        *by = fz * own;
    }
    let falls = -2.0 * fz * n.by_distance;
    let mut found = Displacement {
        value: fz * n.value,
        by_load: [0.0, 0.0, n.value + fz * n.by_size * by_fz, falls * dx, falls * dy],
        by_field,
    };
    if !shear {
        return found;
    }
    let pull = fx.hypot(fy);
    let used = pull / (fz * friction);
    let slip = p[FIELD - 1];
    let open = 1.0 + slip * used > 0.0;
    let narrowed = size2 * (1.0 + slip * used).max(0.0);
    let t = radial(&p.as_slice()[RADIAL..2 * RADIAL], distance2, narrowed, 1.5);
    let along = fx * dx + fy * dy;
    let by_area = if open { along * t.by_size } else { 0.0 };
    found.value += along * t.value;
    for (by, own) in found.by_field.as_mut_slice()[RADIAL..].iter_mut().zip(t.by_own) {
        *by = along * own;
    }
    found.by_field[FIELD - 1] = by_area * size2 * used;
    // Derivatives of the sheared area by the forces; its tip at no shear has none.
    let by_used = by_area * size2 * slip / (fz * friction * pull.max(1e-9));
    found.by_load[0] += dx * t.value + by_used * fx;
    found.by_load[1] += dy * t.value + by_used * fy;
    found.by_load[2] += by_area * ((1.0 + slip * used) * by_fz - size2 * slip * used / fz);
    let falls = -2.0 * along * t.by_distance;
    found.by_load[3] += falls * dx - fx * t.value;
    found.by_load[4] += falls * dy - fy * t.value;
    found
}

/// Arm of the shear, mm: a contact that moves by as much, times its friction ratio, moves the
/// facets beside it as the shear does. At 2 mm from a contact of this squared size.
///
/// Signals of contacts at unknown places do not tell it.
pub(super) fn arm(p: &Coefficients, size2: f64) -> f64 {
    let normal = radial(&p.as_slice()[..RADIAL], 4.0, size2, 0.5);
    let shear = radial(&p.as_slice()[RADIAL..2 * RADIAL], 4.0, size2, 1.5);
    -0.5 * shear.value / normal.by_distance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_match_differences() {
        let mut p = half_space();
        for (i, p) in p.iter_mut().enumerate() {
            *p += 0.05 * (i as f64 * 1.3).sin();
        }
        let load = [0.2, -0.3, 0.9, 0.7, -1.1];
        let at = |p: &Coefficients, load: &[f64; LOAD]| {
            displacement(p, load, [1.25, -1.25], (0.8, true))
        };
        let (here, step) = (at(&p, &load), 1e-6);
        for k in 0..LOAD {
            let mut moved = load;
            moved[k] += step;
            let slope = (at(&p, &moved).value - here.value) / step;
            assert!((slope - here.by_load[k]).abs() < 1e-4, "{k}: {slope} {}", here.by_load[k]);
        }
        for k in 0..FIELD {
            let mut moved = p;
            moved[k] += step;
            let slope = (at(&moved, &load).value - here.value) / step;
            assert!((slope - here.by_field[k]).abs() < 1e-4, "{k}: {slope} {}", here.by_field[k]);
        }
    }
}
