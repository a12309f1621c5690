//! Slip annulus of a field whose recordings do not show it.
//!
//! Shear of a contact that sticks has the mean square radius ⅔ a², and at full slip that of the
//! pressure, ⅖ a² (Cattaneo, Mindlin; Johnson, *Contact Mechanics*, §7.2). The sheared area thus
//! shrinks by two fifths. Recordings whose shear has one form throughout, because the indenter
//! was glued to the skin or slid, fit no such share; a finger would not see a slip begin.
//!
//! The growth of the contact tells the two forms apart. Both N and T are the skin's response to a
//! point, smeared over the contact, so that ∂u/∂s² is a multiple of the Laplacian of u. The multiple of T
//! is 5/3 that of N while the contact sticks, and equal at full slip.

use super::forward::{Coefficients, FIELD, RADIAL, radial};

/// Share by which slip shrinks the sheared area.
const SHRINKS: f64 = -0.4;
/// Fitted share above which recordings show no annulus.
const SHOWN: f64 = -0.1;
/// Ratio of the multiples halfway between full slip and a contact that sticks.
const STICKS: f64 = 4.0 / 3.0;
/// s² at which the contact grows: 0.35 N.
const SIZE2: f64 = 0.5;
/// Distances from the contact that count, mm, and their step.
const FARTHEST: f64 = 5.0;
const STEP: f64 = 0.1;

/// Returns the field with the annulus of theory, if the recordings with shear show none.
pub(super) fn completed(field: &Coefficients) -> Coefficients {
    let mut field = *field;
    if field[FIELD - 1] < SHOWN {
        return field;
    }
    field[FIELD - 1] = SHRINKS;
    if multiple(&field, Part::Shear) < STICKS * multiple(&field, Part::Normal) {
        // At full slip 1 + e·b is 1 + e: the area without slip is larger by as much.
        widen(&mut field, 1.0 / (1.0 + SHRINKS));
    }
    field
}

/// Multiplies the sheared area at every load.
fn widen(field: &mut Coefficients, by: f64) {
    let shear = &mut field.as_mut_slice()[RADIAL..2 * RADIAL];
    shear[1] *= by;
    for term in shear[2..].chunks_exact_mut(3) {
        term[1] *= by;
        term[2] *= by * by;
    }
}

#[derive(Clone, Copy)]
enum Part {
    Normal,
    Shear,
}

/// Multiple of the Laplacian by which a part's displacement grows with s², by least squares over
/// the plane.
fn multiple(field: &Coefficients, part: Part) -> f64 {
    let (own, half) = match part {
        Part::Normal => (&field.as_slice()[..RADIAL], 0.5),
        Part::Shear => (&field.as_slice()[RADIAL..2 * RADIAL], 1.5),
    };
    let at = |distance2: f64| radial(own, distance2, SIZE2, half);
    let (mut both, mut squares) = (0.0, 0.0);
    let steps = (FARTHEST / STEP) as usize;
    for distance in (1..=steps).map(|i| STEP * i as f64) {
        let (distance2, by) = (distance * distance, 1e-3);
        let here = at(distance2);
        let bend = (at(distance2 + by).by_distance - at(distance2 - by).by_distance) / (2.0 * by);
        // ∇²n(d²) = 4 n′ + 4 d² n″ and ∇²(x t(d²)) = x (8 t′ + 4 d² t″). The mean of x² around the
        // contact is ½ d².
        let (slopes, weight) = match part {
            Part::Normal => (4.0, distance),
            Part::Shear => (8.0, distance * distance2),
        };
        let laplacian = slopes * here.by_distance + 4.0 * distance2 * bend;
        both += weight * laplacian * here.by_size;
        squares += weight * laplacian * laplacian;
    }
    both / squares
}

#[cfg(test)]
mod tests {
    use super::*;
    use taxel::estimate::field::Radial;

    /// Field of a simulated finger whose recordings show the annulus.
    fn shown() -> Coefficients {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/device-11.toml");
        let record = taxel_files::calibration::read(path).unwrap();
        let field = record.model.unwrap().field;
        let of = |part: Radial| part.depth.into_iter().chain(part.terms.into_iter().flatten());
        let all = of(field.normal).chain(of(field.shear)).chain([field.slip]);
        Coefficients::from_iterator(all.map(f64::from))
    }

    /// A finger by recordings in which every contact has used the share `used` of friction.
    fn recorded_at(used: f64) -> Coefficients {
        let mut field = shown();
        widen(&mut field, 1.0 + SHRINKS * used);
        field[FIELD - 1] = 0.0;
        field
    }

    #[test]
    fn annulus_that_recordings_show_is_kept() {
        assert_eq!(completed(&shown()), shown());
    }

    #[test]
    fn annulus_is_completed_from_contacts_that_stick_and_that_slide() {
        let mut expected = shown();
        expected[FIELD - 1] = SHRINKS;
        for used in [0.0, 1.0] {
            let found = completed(&recorded_at(used));
            let off = (found - expected).norm() / expected.norm();
            assert!(off < 1e-9, "recorded at {used}: {off}");
        }
    }
}
