//! The inverse problem of [TactileEnc], named as future work in [DeMaria2011]: which single contact
//! makes these signals?
//!
//! Signals become displacements by each taxel's measured curve; Gauss–Newton then finds the touch whose
//! [`Field`] meets them best. It starts where the last frame ended, takes a fixed number of steps, and says
//! how sure it is: the covariance of what it found, and the misfit, which tells that what touches the
//! finger is no single contact of the kind it was calibrated with.

use serde::{Deserialize, Serialize};

use super::field::{Field, Load};
use super::solve::Normal;
use crate::math::sqrt;
use crate::measured::{Measured, NoValue};
use crate::scan::{COLS, ROWS, TAXEL_CENTRES, TAXELS};

/// Steps in the first frame of a contact. From the last frame's touch one step is as good as converged at a
/// kilohertz.
const FIRST_STEPS: usize = 3;
/// Least f_z that is followed, as s: 1 mN.
const LEAST_SIZE: f32 = 0.1;
/// Most, as s: 27 N, beyond the range of any sensor of [DeMaria2011] or [Ospina2017].
const MOST_SIZE: f32 = 3.0;
/// A step moves the contact by this much at most, in mm, and s by [`SIZE_STEP`].
const POINT_STEP: f32 = 1.0;
const SIZE_STEP: f32 = 0.3;
/// Contacts farther out than this, in mm, are not followed: the pad ends at 5.
const FARTHEST: f32 = 7.0;
/// Rubber holds no more than this many times the normal force.
const MOST_FRICTION: f32 = 2.0;
/// Before it is seen, the share of friction in use is taken as even between none and all: ½ ± 0.4.
const USED: [f32; 2] = [0.5, 0.4];
/// No frame tells it better than to a thousandth, squared.
const LEAST_VARIANCE: f32 = 1e-6;

/// From signals to displacements.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Curves {
    /// What of its neighbours' signals a taxel picks up: left, right, below (row − 1), above (row + 1).
    pub stray: [[f32; 4]; TAXELS],
    /// u as a polynomial of the taxel's own signal: coefficients of c … c⁵.
    pub gap: [[f32; 5]; TAXELS],
}

impl Curves {
    /// u_k, positive where the facet came nearer.
    #[must_use]
    pub fn displacements(&self, c: &[f32; TAXELS]) -> [f32; TAXELS] {
        let at = |k: Option<usize>| k.and_then(|k| c.get(k)).copied().unwrap_or_default();
        let mut u = [0.0; TAXELS];
        for (k, ((u, [left, right, below, above]), [a1, a2, a3, a4, a5])) in
            u.iter_mut().zip(&self.stray).zip(&self.gap).enumerate()
        {
            let column = k % COLS;
            let own = at(Some(k))
                - left * at((column > 0).then(|| k.wrapping_sub(1)))
                - right * at((column + 1 < COLS).then_some(k + 1))
                - below * at(k.checked_sub(COLS))
                - above * at((k + COLS < ROWS * COLS).then_some(k + COLS));
            *u = own * (a1 + own * (a2 + own * (a3 + own * (a4 + own * a5))));
        }
        u
    }
}

/// The coefficients of one finger.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Inverse {
    /// Signals to displacements.
    pub curves: Curves,
    /// Displacements of a touch.
    pub field: Field,
    /// What is left of the displacements in calibration, root mean square over the taxels: without load,
    /// and a newton more for each newton.
    pub error: [f32; 2],
    /// The calibration held shear, so that T is known.
    pub shear: bool,
    /// Friction coefficient of what touched the finger in calibration.
    pub friction: f32,
}

/// What the inverse remembers: the last frame's touch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InverseState {
    last: Option<Load>,
    /// It is not of the frame before this one.
    old: bool,
}

/// The shear as other sensors feel it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pull {
    /// f_x and f_y over f_z.
    pub ratio: [f32; 2],
    /// Standard deviation of either.
    pub sigma: f32,
}

/// A touch as found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Force and place.
    pub load: Load,
    /// Standard deviations of f_x, f_y, f_z (N), x, y (mm) and of the share of friction in use.
    pub sigma: [f32; 6],
    /// What is seen of the share of friction in use.
    pub ring: Ring,
    /// Root mean square of what is left of the displacements, over what calibration left at this force.
    pub misfit: f32,
}

/// The share of friction in use as a frame shows it, without what was taken for likely before: frames may
/// be added up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ring {
    /// One over its variance; 0 where nothing is seen.
    pub weight: f32,
    /// The share, times its weight.
    pub moment: f32,
}

impl Ring {
    /// Out of the share as found together with what was likely before, [`USED`].
    fn of(found: f32, variance: f32) -> Self {
        let [usual, spread] = USED;
        let (before, after) = (1.0 / (spread * spread), 1.0 / variance.max(LEAST_VARIANCE));
        let seen = after > before;
        let known = Self { weight: after - before, moment: found * after - usual * before };
        if seen { known } else { Self::default() }
    }
}

impl Touch {
    /// f_x, f_y, f_z in newtons.
    #[must_use]
    pub fn force(&self) -> [f32; 3] {
        let [x, y] = self.load.shear;
        [x, y, self.load.normal()]
    }

    #[inline(never)]
    fn is_sound(&self) -> bool {
        self.misfit < f32::MAX && self.sigma.iter().all(|sigma| *sigma < f32::MAX)
    }
}

impl InverseState {
    /// Forgets the contact.
    pub fn clear(&mut self) {
        self.last = None;
    }

    /// Frames are missing: one step may not lead from the last touch to the next.
    pub fn interrupt(&mut self) {
        self.old = true;
    }
}

impl Inverse {
    /// One frame of displacements, of a touch without shear.
    ///
    /// # Errors
    /// [`NoValue::IllConditioned`] where the displacements do not determine a contact.
    pub fn pressed(&self, state: &mut InverseState, u: &[f32; TAXELS]) -> Measured<Touch> {
        self.find(state, u, |inverse, load, u| inverse.pressed_step(load, u))
    }

    /// One frame of displacements, with shear and the share of friction that it uses. Force and place are
    /// those of the displacements alone; the share of friction, which displacements tell from a weaker shear
    /// only just, leans on what else feels the shear.
    ///
    /// # Errors
    /// [`NoValue::NotEstimated`] for a calibration that held no shear, [`NoValue::IllConditioned`] where
    /// the displacements do not determine a contact.
    pub fn sheared(
        &self,
        state: &mut InverseState,
        u: &[f32; TAXELS],
        felt: Option<Pull>,
    ) -> Measured<Touch> {
        if !self.shear {
            return Err(NoValue::NotEstimated);
        }
        self.find(state, u, |inverse, load, u| inverse.sheared_step(load, u, felt))
    }

    fn find(
        &self,
        state: &mut InverseState,
        u: &[f32; TAXELS],
        step: impl Fn(&Self, &mut Load, &[f32; TAXELS]) -> Option<Touch>,
    ) -> Measured<Touch> {
        let (start, steps) = match state.last {
            Some(last) => (Some(last), if state.old { FIRST_STEPS } else { 1 }),
            None => (self.start(u), FIRST_STEPS),
        };
        let found =
            start.and_then(|mut load| (0..steps).fold(None, |_, _| step(self, &mut load, u)));
        let sound = found.filter(Touch::is_sound);
        *state = InverseState { last: sound.map(|touch| touch.load), old: false };
        sound.ok_or(NoValue::IllConditioned)
    }

    /// Where to begin: the centroid of what sank, and the force of a contact there that sinks as much.
    #[inline(never)]
    fn start(&self, u: &[f32; TAXELS]) -> Option<Load> {
        let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
        for (u, centre) in u.iter().zip(&TAXEL_CENTRES) {
            let weight = u.max(0.0);
            sum += weight;
            x += weight * centre[0].0;
            y += weight * centre[1].0;
        }
        if !(sum > f32::MIN_POSITIVE && sum < f32::MAX) {
            return None;
        }
        let newton =
            Load { size: 1.0, point: [x / sum, y / sum], used: USED[0], ..Load::default() };
        let around = self.field.around(&newton);
        let whole = TAXEL_CENTRES.iter().fold(0.0, |sum, c| sum + around.pressed(place(c)).0);
        let force = if whole > f32::MIN_POSITIVE { sum / whole } else { 0.0 };
        let size = crate::math::cube_root(force).clamp(LEAST_SIZE, MOST_SIZE);
        Some(Load { size, ..newton })
    }

    /// What calibration leaves of a newton, as a share of what a newton sinks the facet under it.
    pub(crate) fn expected_share(&self) -> f32 {
        let newton = Load { size: 1.0, ..Load::default() };
        let (sinks, _) = self.field.around(&newton).pressed([0.0; 2]);
        let [floor, share] = self.error;
        if sinks > f32::MIN_POSITIVE { ((floor + share) / sinks).min(1.0) } else { 1.0 }
    }

    /// What calibration leaves at this normal force.
    pub(super) fn expected(&self, normal: f32) -> f32 {
        let [floor, share] = self.error;
        floor + share * normal
    }

    fn pressed_step(&self, load: &mut Load, u: &[f32; TAXELS]) -> Option<Touch> {
        let error = self.expected(load.normal());
        let mut normal = Normal::<3>::EMPTY;
        let mut squares = 0.0;
        let around = self.field.around(load);
        for (u, centre) in u.iter().zip(&TAXEL_CENTRES) {
            let (model, row) = around.pressed(place(centre));
            let left = u - model;
            squares += left * left;
            normal.add(&row, left);
        }
        normal.damp(&[0.0, square(error / FARTHEST), square(error / FARTHEST)]);
        let ([ds, dx, dy], [vs, vx, vy]) = normal.solve()?;
        let left = squares - ds * normal.right[0] - dx * normal.right[1] - dy * normal.right[2];
        load.shear = [0.0; 2];
        load.used = USED[0];
        load.advance(ds, [dx, dy]);
        let misfit = misfit(left, error);
        let wide = error * misfit.max(1.0);
        let [s, x, y] = [vs, vx, vy].map(|variance| wide * sqrt(variance));
        let sigma = [0.0, 0.0, 3.0 * load.size * load.size * s, x, y, USED[1]];
        Some(Touch { load: *load, sigma, ring: Ring::default(), misfit })
    }

    fn sheared_step(
        &self,
        load: &mut Load,
        u: &[f32; TAXELS],
        felt: Option<Pull>,
    ) -> Option<Touch> {
        let error = self.expected(load.normal());
        let mut normal = Normal::<6>::EMPTY;
        let mut squares = 0.0;
        let around = self.field.around(load);
        for (u, centre) in u.iter().zip(&TAXEL_CENTRES) {
            let (model, row) = around.sheared(place(centre));
            let left = u - model;
            squares += left * left;
            normal.add(&row, left);
        }
        let [usual, spread] = USED;
        let held = error / (MOST_FRICTION * load.normal());
        let prior = square(error / spread);
        normal.damp(&[
            square(held),
            square(held),
            0.0,
            square(error / FARTHEST),
            square(error / FARTHEST),
            prior,
        ]);
        let unseen = normal.right;
        normal.right[5] += prior * (usual - load.used);
        let (mut step, mut variances) = normal.solve()?;
        let left = unseen.iter().zip(&step).fold(squares, |left, (g, d)| left - g * d);
        if let Some(pull) = felt {
            ([.., step[5]], [.., variances[5]]) = normal.leaning(load, &pull, error).solve()?;
        }
        let [dfx, dfy, ds, dx, dy, db] = step;
        load.advance(ds, [dx, dy]);
        load.used = (load.used + db).clamp(-0.5, 1.5);
        let [fx, fy] = [load.shear[0] + dfx, load.shear[1] + dfy];
        let (shear, most) = (sqrt(fx * fx + fy * fy), MOST_FRICTION * load.normal());
        let share = if shear > most { most / shear } else { 1.0 };
        load.shear = [fx * share, fy * share];
        let misfit = misfit(left, error);
        let wide = error * misfit.max(1.0);
        let mut sigma = variances.map(|variance| wide * sqrt(variance));
        sigma[2] *= 3.0 * load.size * load.size;
        let ring = Ring::of(load.used, sigma[5] * sigma[5]);
        Some(Touch { load: *load, sigma, ring, misfit })
    }
}

impl Normal<6> {
    /// With the ratios of shear to normal force seen by others, where what is left of displacements is `error`.
    fn leaning(mut self, load: &Load, pull: &Pull, error: f32) -> Self {
        let normal = load.normal();
        let weight = error / (pull.sigma * normal);
        let slope = -3.0 * load.size * load.size * weight;
        let ([rx, ry], [fx, fy]) = (pull.ratio, load.shear);
        self.add(&[weight, 0.0, rx * slope, 0.0, 0.0, 0.0], weight * (rx * normal - fx));
        self.add(&[0.0, weight, ry * slope, 0.0, 0.0, 0.0], weight * (ry * normal - fy));
        self
    }
}

impl Load {
    /// A step, no longer than can be trusted, to where a contact can be.
    #[inline(never)]
    pub(super) fn advance(&mut self, ds: f32, [dx, dy]: [f32; 2]) {
        self.size = (self.size + ds.clamp(-SIZE_STEP, SIZE_STEP)).clamp(LEAST_SIZE, MOST_SIZE);
        let [x, y] = self.point;
        self.point = [
            (x + dx.clamp(-POINT_STEP, POINT_STEP)).clamp(-FARTHEST, FARTHEST),
            (y + dy.clamp(-POINT_STEP, POINT_STEP)).clamp(-FARTHEST, FARTHEST),
        ];
    }
}

fn misfit(squares: f32, error: f32) -> f32 {
    sqrt(squares * (1.0 / TAXELS as f32)) / error
}

fn square(x: f32) -> f32 {
    x * x
}

fn place(centre: &[crate::units::Millimetres; 2]) -> [f32; 2] {
    centre.map(|c| c.0)
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::field::tests::HALF_SPACE;
    use super::*;
    use proptest::prelude::*;

    pub(crate) fn finger() -> Inverse {
        Inverse {
            curves: Curves { stray: [[0.0; 4]; TAXELS], gap: [[-1.0, 0.0, 0.0, 0.0, 0.0]; TAXELS] },
            field: HALF_SPACE,
            error: [2e-4, 2e-4],
            shear: true,
            friction: 0.8,
        }
    }

    pub(crate) fn displaced(load: &Load) -> [f32; TAXELS] {
        let around = HALF_SPACE.around(load);
        TAXEL_CENTRES.map(|c| around.sheared(place(&c)).0)
    }

    /// After twelve frames: one sheared by two thirds of its normal force beside the outer taxels wants seven, and its
    /// misfit says so until then.
    fn settled(u: &[f32; TAXELS]) -> Touch {
        let (finger, mut state) = (finger(), InverseState::default());
        (0..12).map(|_| finger.sheared(&mut state, u, None)).last().unwrap().unwrap()
    }

    proptest! {
        #[test]
        fn a_touch_comes_back_from_the_displacements_that_it_makes(
            share in 0.0..0.7f32, turn in -3.0..3.0f32, size in 0.5..1.26f32,
            x in -3.75..3.75f32, y in -3.75..3.75f32,
        ) {
            let shear = share * size.powi(3);
            let load = Load {
                shear: [shear * turn.cos(), shear * turn.sin()], size, point: [x, y], used: 0.5,
            };
            let touch = settled(&displaced(&load));
            prop_assert!((touch.load.normal() / load.normal() - 1.0).abs() < 0.01, "{touch:?}");
            for axis in 0..2 {
                prop_assert!((touch.load.point[axis] - load.point[axis]).abs() < 0.02, "{touch:?}");
                let apart = (touch.load.shear[axis] - load.shear[axis]).abs();
                prop_assert!(apart < 0.02 * load.normal(), "{touch:?} {load:?}");
            }
            prop_assert!(touch.misfit < 1.0);
        }

        #[test]
        fn no_displacements_and_no_coefficients_give_nan_or_infinity(
            u in proptest::array::uniform16(prop_oneof![-1e9..1e9f32, -1.0..1.0f32, Just(0.0f32)]),
            scale in prop_oneof![-1e3..1e3f32, -1.0..1.0f32, Just(0.0f32)],
            floor in prop_oneof![1e-9..1.0f32, Just(1e-9f32)],
            ratio in proptest::array::uniform2(-2.0..2.0f32), sigma in 1e-6..1.0f32, pulls in any::<bool>(),
        ) {
            let pull = pulls.then_some(Pull { ratio, sigma });
            let mut finger = finger();
            finger.error = [floor, 0.0];
            for radial in [&mut finger.field.normal, &mut finger.field.shear] {
                radial.terms.as_flattened_mut().iter_mut().for_each(|t| *t *= scale);
                radial.depth[1] *= scale;
            }
            let mut state = InverseState::default();
            for _ in 0..4 {
                for touch in [finger.pressed(&mut state, &u), finger.sheared(&mut state, &u, pull)]
                    .into_iter().flatten()
                {
                    let numbers = touch.force().into_iter().chain(touch.load.point)
                        .chain(touch.sigma).chain([touch.misfit, touch.load.used])
                        .chain([touch.ring.weight, touch.ring.moment]);
                    for number in numbers {
                        prop_assert!(number.is_finite(), "{touch:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_share_of_friction_in_use_is_seen_where_the_contact_is_large() {
        for used in [0.2, 0.9] {
            let load = Load { shear: [0.9, 0.0], size: 1.2, point: [0.3, -0.2], used };
            let touch = settled(&displaced(&load));
            assert!((touch.load.used - used).abs() < 0.05, "{used}: {touch:?}");
        }
    }

    #[test]
    fn a_shear_that_others_feel_makes_the_share_of_friction_in_use_surer_and_no_force_other() {
        let load = Load { shear: [0.3, 0.0], size: 1.0, point: [0.3, -0.2], used: 0.7 };
        let found = |felt| {
            let (finger, mut state) = (finger(), InverseState::default());
            let u = displaced(&load);
            (0..6).map(|_| finger.sheared(&mut state, &u, felt)).last().unwrap().unwrap()
        };
        let (alone, felt) = (found(None), found(Some(Pull { ratio: [0.3, 0.0], sigma: 0.003 })));
        assert!(felt.ring.weight > 1.3 * alone.ring.weight, "{felt:?} {alone:?}");
        assert!((felt.ring.moment / felt.ring.weight - 0.7).abs() < 0.05, "{felt:?}");
        assert!((felt.load.shear[0] - alone.load.shear[0]).abs() < 0.01, "{felt:?} {alone:?}");
    }

    #[test]
    fn two_contacts_are_no_single_one() {
        let one = Load { size: 0.8, point: [-3.0, 0.0], ..Load::default() };
        let two = Load { point: [3.0, 0.5], ..one };
        let mut u = displaced(&one);
        assert!(settled(&u).misfit < 1.0);
        u.iter_mut().zip(displaced(&two)).for_each(|(u, more)| *u += more);
        assert!(settled(&u).misfit > 10.0);
    }

    #[test]
    fn a_touch_that_is_followed_needs_no_time_to_settle() {
        let (finger, mut state) = (finger(), InverseState::default());
        for i in 0..200 {
            let t = i as f32 / 200.0;
            let load = Load {
                size: 0.4 + 0.8 * t,
                point: [4.0 * t - 2.0, t],
                used: 0.5,
                shear: [0.1 * t, 0.0],
            };
            let touch = finger.sheared(&mut state, &displaced(&load), None).unwrap();
            if i > 3 {
                assert!((touch.load.point[0] - load.point[0]).abs() < 0.01, "{i}: {touch:?}");
            }
        }
    }

    #[test]
    fn touch_that_moved_during_lost_scans_is_found_at_once() {
        let at = |x: f32| displaced(&Load { size: 1.0, point: [x, 0.0], ..Load::default() });
        let far_off = |lost: bool| {
            let (finger, mut state) = (finger(), InverseState::default());
            for _ in 0..6 {
                finger.pressed(&mut state, &at(-1.2)).unwrap();
            }
            if lost {
                state.interrupt();
            }
            (finger.pressed(&mut state, &at(1.2)).unwrap().load.point[0] - 1.2).abs()
        };
        assert!(far_off(true) < 0.2, "{}", far_off(true));
        assert!(far_off(false) > 1.0, "one step is a millimetre: {}", far_off(false));
    }

    #[test]
    fn a_calibration_without_shear_does_not_guess_it() {
        let finger = Inverse { shear: false, ..finger() };
        let mut state = InverseState::default();
        assert_eq!(finger.sheared(&mut state, &[0.1; TAXELS], None), Err(NoValue::NotEstimated));
    }

    #[test]
    fn stray_light_is_taken_off_before_the_curve() {
        let mut curves = finger().curves;
        curves.stray[5] = [0.1, 0.0, 0.0, 0.2];
        let mut c = [0.0; TAXELS];
        (c[4], c[5], c[9]) = (-0.5, -1.0, -0.25);
        let u = curves.displacements(&c);
        assert!((u[5] - (1.0 - 0.05 - 0.05)).abs() < 1e-6, "{}", u[5]);
        assert_eq!(u[6], 0.0);
    }
}
