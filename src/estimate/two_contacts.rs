//! Estimation of two simultaneous contacts ([DeMaria2011]'s open case).
//!
//! The search runs only if a single contact does not explain the displacements. Gauss–Newton fits
//! two normal contacts, six unknowns, to the sixteen displacements in the same
//! [`Field`](super::field::Field), one or two steps a scan. The pair is believed if it explains
//! more than a single contact and its contacts are far enough apart. A believed pair is followed
//! alone, with the [linearisation](super::linearised) of a single contact's fit, and compared with
//! a single contact now and then.

use super::field::Load;
use super::inverse::{Inverse, PRESSED_REACH, misfit, square, squared};
use super::linearised::{Linearised, UNKNOWNS};
use crate::math::{at_least, cube_root, sqrt};
use crate::scan::{PITCH, TAXELS};

/// Steps in a scan, if the scans leave time for more than one.
const STEPS: u8 = 2;
/// Least steps of a search, and the most before it begins again.
const SEARCHED: u8 = 4;
const SEARCH: u8 = 10;
/// Least distance of two contacts, in pitches; the matrix cannot separate nearer ones.
const APART: f32 = 1.4;
/// Least normal force of either contact, in newtons; less is within the other's calibration
/// residual.
const LEAST: f32 = 0.04;
/// Largest misfit of a pair, as a share of the single contact's misfit.
const BETTER: f32 = 0.4;
/// Contact size s of the initial guess: half a newton.
const USUAL_SIZE: f32 = 0.8;
/// Distance of the initial contacts from their middle, and their largest coordinate, in mm.
const HALF_WAY: f32 = 2.7;
const EDGE: f32 = 4.0;

/// Two estimated contacts, the stronger one first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Normal force and position of each; shear is not estimated.
    pub contacts: [Load; 2],
    /// Normalised residual: root mean square of the remaining displacements over that of the
    /// calibration at these forces.
    pub misfit: f32,
}

/// State: the pair of the last scan, and the linearisation near it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PairState {
    last: Option<[Load; 2]>,
    /// Steps of the search; 0 for a believed pair.
    searched: u8,
    /// Contacts of `kept`.
    at: Option<[Load; 2]>,
    kept: Linearised,
}

impl PairState {
    /// Forgets the pair.
    pub fn clear(&mut self) {
        (self.last, self.at) = (None, None);
    }

    /// Returns whether the pair of the last scan was believed.
    #[must_use]
    pub fn believed(&self) -> bool {
        self.last.is_some() && self.searched == 0
    }
}

impl Inverse {
    /// Returns two contacts if they explain the displacements `u` better than one. `single` is the
    /// misfit of the single contact. A pair is found within a few scans; `hurried` ones leave time
    /// for one step.
    #[must_use]
    pub fn pair(
        &self,
        state: &mut PairState,
        u: &[f32; TAXELS],
        single: f32,
        hurried: bool,
    ) -> Option<Pair> {
        let followed = state.believed();
        let mut loads = match state.last {
            Some(last) => last,
            None => {
                state.searched = 0;
                state.at = None;
                self.first_guess(u)?
            }
        };
        let steps = if hurried { 1 } else { STEPS };
        let (mut found, mut still) = (None, false);
        for _ in 0..steps {
            let before = loads;
            found = self.pair_step(state, &mut loads, u);
            still = apart(&loads, &before) <= PRESSED_REACH;
        }
        let [a, b] = loads;
        let distance = square(a.point[0] - b.point[0]) + square(a.point[1] - b.point[1]);
        let believed = found.filter(|misfit| {
            *misfit < BETTER * single
                && distance > square(APART * PITCH.0)
                && loads.iter().all(|load| load.normal() > LEAST)
        });
        let searched = state.searched.saturating_add(steps);
        if believed.is_some() && (followed || still && searched >= SEARCHED) {
            state.searched = 0;
            state.last = Some(loads);
        } else {
            let goes_on = !followed && found.is_some() && searched < SEARCH;
            state.searched = searched;
            state.last = goes_on.then_some(loads);
            return None;
        }
        let contacts = if a.size >= b.size { [a, b] } else { [b, a] };
        believed.map(|misfit| Pair { contacts, misfit })
    }

    /// Returns the initial guess of two contacts. The contacts lie on either side of the centroid
    /// of the displacements, along the direction of largest spread. Forces that fit the
    /// displacements best complete the guess.
    fn first_guess(&self, u: &[f32; TAXELS]) -> Option<[Load; 2]> {
        let (_, [x, y]) = self.centroid(u)?;
        // Second moments as the vector (xx − yy, 2xy), which points at twice the angle of the line.
        let (mut along, mut across) = (0.0, 0.0);
        for (u, [cx, cy]) in u.iter().zip(&self.centres.0) {
            let (weight, [dx, dy]) = (u.max(0.0), [cx - x, cy - y]);
            along += weight * (dx * dx - dy * dy);
            across += weight * 2.0 * dx * dy;
        }
        let length = sqrt(along * along + across * across);
        let cosine = if length > 0.0 { (along / length).clamp(-1.0, 1.0) } else { 1.0 };
        let line = [sqrt(0.5 * (1.0 + cosine)), sqrt(0.5 * (1.0 - cosine)).copysign(across)];
        let at = |way: f32| Load {
            size: USUAL_SIZE,
            point: [(x + way * line[0]).clamp(-EDGE, EDGE), (y + way * line[1]).clamp(-EDGE, EDGE)],
            ..Load::default()
        };
        let pair = [at(HALF_WAY), at(-HALF_WAY)];
        let [a, b] = pair.each_ref().map(|load| self.field.around(load));
        let [mut aa, mut ab, mut bb, mut au, mut bu] = [0.0; 5];
        let [mut left_a, mut left_b] = [[0.0; TAXELS]; 2];
        a.subtract(&mut left_a, &self.centres.0, false);
        b.subtract(&mut left_b, &self.centres.0, false);
        for ((a, b), u) in left_a.iter().zip(&left_b).zip(u) {
            aa += a * a;
            ab += a * b;
            bb += b * b;
            au -= a * u;
            bu -= b * u;
        }
        let whole = aa * bb - ab * ab;
        if !(whole > f32::MIN_POSITIVE && whole < f32::MAX) {
            return None;
        }
        let mut shares =
            [bb * au - ab * bu, aa * bu - ab * au].map(|share| share / whole).into_iter();
        Some(pair.map(|load| {
            let force = load.normal() * shares.next().unwrap_or_default();
            Load { size: cube_root(force).clamp(0.3, 1.5), ..load }
        }))
    }

    /// Takes one step from `loads` and returns the misfit, with the kept linearisation if it
    /// reaches so far.
    fn pair_step(
        &self,
        state: &mut PairState,
        loads: &mut [Load; 2],
        u: &[f32; TAXELS],
    ) -> Option<f32> {
        let [a, b] = &*loads;
        let (around_a, around_b) = (self.field.around(a), self.field.around(b));
        let error = self.expected(a.normal() + b.normal());
        let mut left = *u;
        if state.at.as_ref().is_some_and(|at| apart(loads, at) <= PRESSED_REACH) {
            around_a.subtract(&mut left, &self.centres.0, false);
            around_b.subtract(&mut left, &self.centres.0, false);
        } else {
            state.at = None;
            state.kept.weights = [error * error; UNKNOWNS];
            self.press(&around_a, &mut left, &mut state.kept.slopes, 0);
            self.press(&around_b, &mut left, &mut state.kept.slopes, 3);
            if !state.kept.renew(0..UNKNOWNS) {
                return None;
            }
            state.at = Some(*loads);
        }
        let squares = squared(&left);
        let (step, explained) = state.kept.step(&left, &[0.0; UNKNOWNS]);
        let [das, dax, day, dbs, dbx, dby] = step;
        let [a, b] = loads;
        a.advance(das, [dax, day]);
        b.advance(dbs, [dbx, dby]);
        let misfit = misfit(squares - explained, error);
        (misfit < f32::MAX).then_some(misfit)
    }
}

/// Returns how far two pairs are apart, in reaches of a linearisation.
fn apart(loads: &[Load; 2], others: &[Load; 2]) -> f32 {
    let ([a, b], [to_a, to_b]) = (loads, others);
    at_least(a.apart(to_a), b.apart(to_b))
}

#[cfg(test)]
mod tests {
    use super::super::inverse::tests::{displaced, finger};
    use super::super::inverse::{ContactFit, InverseState};
    use super::*;
    use proptest::prelude::*;

    fn touched(loads: &[Load]) -> [f32; TAXELS] {
        let mut u = [0.0; TAXELS];
        for load in loads {
            u.iter_mut().zip(displaced(load)).for_each(|(u, more)| *u += more);
        }
        u
    }

    fn single(u: &[f32; TAXELS]) -> ContactFit {
        let (finger, mut state) = (finger(), InverseState::default());
        (0..6).map(|_| finger.sheared(&mut state, u, None)).last().unwrap().unwrap()
    }

    fn pair(u: &[f32; TAXELS]) -> Option<Pair> {
        first(u, single(u).misfit)
    }

    /// Pair of as many scans as a search has, for a single contact of misfit `single`.
    fn first(u: &[f32; TAXELS], single: f32) -> Option<Pair> {
        let (finger, mut state) = (finger(), PairState::default());
        (0..SEARCH).map(|_| finger.pair(&mut state, u, single, false)).last().flatten()
    }

    #[test]
    fn contacts_closer_than_the_matrix_resolves_are_not_a_pair() {
        let at = |x: f32| Load { size: 0.9, point: [x, 0.0], ..Load::default() };
        let apart = |mm: f32| first(&touched(&[at(-0.5 * mm), at(0.5 * mm)]), 1e6);
        assert_eq!(apart(3.0), None);
        assert!(apart(4.5).is_some());
    }

    #[test]
    fn pair_must_halve_the_misfit() {
        let at = |x: f32| Load { size: 0.9, point: [x, 0.0], ..Load::default() };
        let mut u = touched(&[at(-3.0), at(3.0)]);
        u.iter_mut().step_by(2).for_each(|u| *u += 5e-3);
        let misfit = first(&u, 1e6).unwrap().misfit;
        assert_eq!(first(&u, 2.0 * misfit), None);
        assert!(first(&u, 3.0 * misfit).is_some());
    }

    proptest! {
        #[test]
        fn contacts_two_pitches_apart_are_located(
            x in -3.5..-2.6f32, y in -3.0..3.0f32, apart in 5.0..6.5f32, turn in -0.5..0.5f32,
            sizes in proptest::array::uniform2(0.6..1.1f32),
        ) {
            let a = Load { size: sizes[0], point: [x, y], ..Load::default() };
            let b = Load {
                size: sizes[1],
                point: [x + apart * turn.cos(), (y + apart * turn.sin()).clamp(-3.75, 3.75)],
                ..Load::default()
            };
            let pair = pair(&touched(&[a, b])).unwrap();
            let [mut found, mut other] = pair.contacts;
            if found.point[0] > other.point[0] {
                core::mem::swap(&mut found, &mut other);
            }
            for (found, true_) in [(found, a), (other, b)] {
                prop_assert!((found.normal() - true_.normal()).abs() < 0.02, "{pair:?} {a:?} {b:?}");
                for axis in 0..2 {
                    prop_assert!((found.point[axis] - true_.point[axis]).abs() < 0.1, "{pair:?} {a:?} {b:?}");
                }
            }
        }

        #[test]
        fn single_contact_is_not_a_pair(
            x in -4.0..4.0f32, y in -4.0..4.0f32, size in 0.5..1.26f32, fx in -0.6..0.6f32,
        ) {
            let shear = [fx * size.powi(3), 0.0];
            let u = touched(&[Load { shear, size, point: [x, y], used: 0.6 }]);
            prop_assert_eq!(pair(&u), None);
        }

        #[test]
        fn pair_is_finite_for_any_displacements(
            u in proptest::array::uniform16(prop_oneof![-1e9..1e9f32, -1.0..1.0f32, Just(0.0f32)]),
            single in prop_oneof![0.0..1e9f32, Just(f32::MAX)],
        ) {
            let mut state = PairState::default();
            for _ in 0..12 {
                if let Some(pair) = finger().pair(&mut state, &u, single, false) {
                    prop_assert!(pair.misfit.is_finite());
                    for load in pair.contacts {
                        prop_assert!(load.size.is_finite() && load.point.iter().all(|c| c.is_finite()));
                    }
                }
            }
        }
    }

    #[test]
    fn pair_is_searched_again_once_forgotten() {
        let at = |x: f32| Load { size: 0.9, point: [x, 0.0], ..Load::default() };
        let (finger, mut state) = (finger(), PairState::default());
        let pair = |state: &mut PairState, u| finger.pair(state, &u, 1e6, false);
        let two = touched(&[at(-3.0), at(3.0)]);
        let searched = (0..SEARCH).position(|_| pair(&mut state, two).is_some()).unwrap();
        assert!(searched > 0 && state.believed());
        assert!(pair(&mut state, two).is_some(), "followed without a search");
        state.clear();
        assert!(!state.believed());
        let again = (0..SEARCH).position(|_| pair(&mut state, two).is_some());
        assert_eq!(again, Some(searched));
    }

    #[test]
    fn first_guess_has_the_forces_of_two_alike() {
        for size in [0.6, 0.8, 1.0] {
            let at = |x: f32| Load { size, point: [x, 0.0], ..Load::default() };
            let guess = finger().first_guess(&touched(&[at(-HALF_WAY), at(HALF_WAY)])).unwrap();
            for load in guess {
                assert!((load.size / size - 1.0).abs() < 0.15, "{size}: {load:?}");
            }
        }
    }
}
