//! Incipient slip: slip margin, friction coefficient and required grip.
//!
//! A sheared contact slips from its rim inwards long before gross slip. The optical matrix sees
//! that slip annulus in the shape of its signals. The annulus gives the friction utilisation b
//! ([`super::inverse`]) for any friction coefficient. A sheared contact therefore reveals its
//! friction, μ = F_t/(b·F_n), before it slips. A single scan carries little information; all scans
//! of a shear together suffice.
//!
//! The estimate is kept for contacts and sensors that cannot see the annulus. The estimate is
//! corrected whenever the contact holds more than expected, or slides.
//!
//! Two contacts are judged together by their summed load: |ΣF_t| against μ·ΣF_n. How they share the
//! shear is unknown: neither a wrench nor sensors under one rigid plate measure their mutual pull
//! along the line between them. There is therefore no margin for each.

use serde::{Deserialize, Serialize};

use super::inverse::FrictionUtilisation;
use super::limit_surface::LimitSurface;
use crate::math::{at_least, at_most, sqrt};
use crate::measured::{Measured, NoValue};
use crate::units::Newtons;

/// Coefficients of the slip estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Slip {
    /// Prior: friction coefficient, and the standard deviation of 1/μ.
    pub usual: [f32; 2],
    /// Limit surface of the contact.
    pub surface: LimitSurface,
    /// Margin below which a warning begins; it ends 0.02 above, so that it does not chatter.
    pub warn: f32,
    /// Safety factor: the recommended grip leaves the load at one over this.
    pub safety: f32,
}

impl Slip {
    /// Makes coefficients for a sphere of 6 mm on the silicone of [DeMaria2011]. `mu` is the prior
    /// friction coefficient. Rubber has 0.2 to 1.2 on most materials: 1/μ is 0.8 to 5.
    #[must_use]
    pub fn usual(mu: f32) -> Self {
        Self { usual: [mu, 1.5], surface: LimitSurface::hertz(6.0, 0.236), warn: 0.35, safety: 1.5 }
    }
}

/// Load of a contact, or of two together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traction {
    /// Shear in newtons.
    pub shear: [f32; 2],
    /// Normal force in newtons.
    pub normal: f32,
    /// Torsion in N·mm.
    pub torsion: f32,
    /// Arm in mm by which two contacts hold additional torsion: Σ F_n·r/ΣF_n. Here r is the
    /// distance from the position where a single contact makes the same moments. The arm of a
    /// single contact is 0.
    pub arm: f32,
    /// Noise of shear (N) and torsion (N·mm); so much of either does not count as load.
    pub sigma: [f32; 2],
    /// Standard deviation of the contact point in mm.
    pub place_sigma: f32,
    /// Information on the friction utilisation, if the matrix sees the slip annulus.
    pub ring: Option<FrictionUtilisation>,
    /// Whether vibration indicates gross slip. A knock may look alike, so that friction learns
    /// nothing.
    pub rubs: bool,
    /// Whether displacement indicates gross slip.
    pub slides: bool,
}

/// Estimate of a contact's friction, and state of its warning.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SlipState {
    /// Estimate of 1/μ and its variance.
    known: Option<[f32; 2]>,
    /// Load relative to the limit, smoothed.
    load: f32,
    /// Whether a warning is active.
    warned: bool,
    /// Seconds since the last friction utilisation, at most [`NEW_AFTER`].
    unlearned: f32,
}

/// Slip estimate of a contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Verdict {
    /// Slip margin: share of the friction limit that is left, 1 unloaded, 0 at the limit.
    pub margin: f32,
    /// Friction coefficient used.
    pub friction: f32,
    /// Normal force that leaves the safe margin at this shear and torsion.
    pub grip: Newtons,
}

/// Least normal force, in newtons, for an estimate of friction.
const LEAST_NORMAL: f32 = 0.05;
/// Systematic standard deviation of the friction utilisation. More scans do not reduce it, because
/// the field's form errs alike in all of them.
const RING_ERROR: f32 = 0.1;
/// Time in seconds that makes a measurement new: a sooner one repeats part of the last.
const NEW_AFTER: f32 = 1e-3;
/// Share of such a measurement's information on the utilisation that is new, because measurements
/// are correlated.
const NEW: f32 = 0.5;
/// Standard deviation of the friction utilisation, which is 1, during gross slip.
const SLIDE_ERROR: f32 = 0.07;
/// Correction of the friction from gross slip, because noise lengthens the shear. With the relative
/// noise n in each direction, its mean grows by n²/2 and its mean square by 2 n².
const LENGTHENED: f32 = 1.5;
/// Least shear that friction learns from, in standard deviations.
const NOISE: f32 = 3.0;
/// Typical growth of shear per second near slip, as a share of normal force. Noisier loads are
/// smoothed.
const QUICK: f32 = 5.0;
/// Growth of the variance of 1/μ per second, because the touched material may change.
const WANDER: f32 = 1e-3;
/// Growth of the variance of 1/μ from contact to contact: the next object may be of any material.
const NEXT_CONTACT: f32 = 0.15;
/// Hysteresis of the warning: it ends so much above the margin at which it began.
const HYSTERESIS: f32 = 0.02;
/// Range of μ; rubber on most materials lies within.
pub(crate) const FRICTION: [f32; 2] = [0.05, 2.0];

impl SlipState {
    /// Ends the contact. Friction stays known, less surely, because the next object may be another.
    pub fn release(&mut self) {
        (self.load, self.warned, self.unlearned) = (0.0, false, 0.0);
        if let Some([_, variance]) = &mut self.known {
            *variance += NEXT_CONTACT;
        }
    }
}

impl Slip {
    /// Returns whether a warning is due with this scan's estimate.
    pub fn warns(&self, state: &mut SlipState, verdict: &Verdict) -> bool {
        state.warned = verdict.margin < self.warn + if state.warned { HYSTERESIS } else { 0.0 };
        state.warned
    }

    /// Estimates slip from one scan of a contact, `elapsed` seconds after the last estimate.
    ///
    /// # Errors
    /// [`NoValue::IllConditioned`] if the normal force is too small for a ratio of shear to normal
    /// force.
    pub fn judge(
        &self,
        state: &mut SlipState,
        traction: &Traction,
        elapsed: f32,
    ) -> Measured<Verdict> {
        let Traction { shear: [fx, fy], normal, torsion, arm, sigma, ring, rubs, slides, .. } =
            *traction;
        if !(LEAST_NORMAL..f32::MAX).contains(&normal) {
            return Err(NoValue::IllConditioned);
        }
        let shear = sqrt(fx * fx + fy * fy);
        let ratio = at_most(shear / normal, FRICTION[1]);
        let surely = shear - NOISE * sigma[0];
        state.unlearned = at_most(state.unlearned + elapsed, NEW_AFTER);
        let taught = if ring.is_some() { core::mem::take(&mut state.unlearned) } else { 0.0 };
        let ring = ring.filter(|_| surely > 0.0 && !slides).unwrap_or_default();
        let noise = at_most(sigma[0] / at_least(shear, f32::MIN_POSITIVE), 1.0);
        let inverse =
            self.learn(state, [ratio, surely / normal, noise], ring, slides, [elapsed, taught]);
        let friction = 1.0 / inverse;
        let turning = at_least(torsion.abs() - sigma[1], 0.0) * self.surface.own_share(normal, arm);
        let pulled = at_least(shear - sigma[0], 0.0);
        let load = at_most(self.surface.load([pulled, 0.0], turning, normal, friction), 1.0);
        let quick = QUICK * elapsed * normal;
        let noise = at_least(sigma[0], f32::MIN_POSITIVE);
        state.load += (load - state.load) * (quick / (quick + noise));
        let load = if slides || rubs { 1.0 } else { state.load.clamp(0.0, 1.0) };
        let grip = Newtons((self.safety * load * normal).clamp(0.0, 1e3));
        Ok(Verdict { margin: 1.0 - load, friction, grip })
    }

    /// Updates and returns 1/μ. `ratio` is shear over normal force, `held` the part of it beyond
    /// noise, and `noise` the noise over the shear. The last estimate was `elapsed` seconds ago;
    /// `ring` is new over `taught` seconds.
    fn learn(
        &self,
        state: &mut SlipState,
        [ratio, held, noise]: [f32; 3],
        ring: FrictionUtilisation,
        slides: bool,
        [elapsed, taught]: [f32; 2],
    ) -> f32 {
        let [usual, spread] = self.usual;
        let start = [1.0 / usual.clamp(FRICTION[0], FRICTION[1]), spread * spread];
        let [mut inverse, variance] = state.known.unwrap_or(start);
        let variance = at_most(variance + WANDER * elapsed, spread * spread);
        let seen = if slides && ratio > FRICTION[0] {
            let new = at_most(elapsed / NEW_AFTER, 1.0);
            let weight = new / (SLIDE_ERROR * SLIDE_ERROR);
            FrictionUtilisation { weight, moment: weight * (1.0 + LENGTHENED * noise * noise) }
        } else {
            let known = (start[1] - variance) / (start[1] * variance * ratio * ratio);
            ring.beside(known, NEW * (taught / NEW_AFTER))
        };
        // b = F_t/F_n · 1/μ is linear in 1/μ: one Kalman step.
        let variance = variance / (1.0 + ratio * ratio * variance * seen.weight);
        inverse += variance * ratio * (seen.moment - seen.weight * ratio * inverse);
        // A contact that holds shows that μ is at least its ratio.
        let most = 1.0 / at_least(held, FRICTION[0]);
        if !slides && inverse > most {
            inverse = most;
        }
        inverse = inverse.clamp(1.0 / FRICTION[1], 1.0 / FRICTION[0]);
        state.known = Some([inverse, variance]);
        inverse
    }
}

impl FrictionUtilisation {
    /// Returns what a scan, of which a share is `new`, adds to the information `known`.
    ///
    /// All scans share a systematic error of variance S, so that information of I counts as
    /// I/(1 + I·S), and a friction known better learns nothing.
    fn beside(&self, known: f32, new: f32) -> Self {
        let shared = RING_ERROR * RING_ERROR;
        let left = 1.0 - known * shared;
        if !(self.weight > 0.0 && left > 0.0) {
            return Self::default();
        }
        let new = new * left;
        let share = new * left / (1.0 + new * self.weight * shared);
        Self { weight: share * self.weight, moment: share * self.moment }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Time between two scans, in seconds.
    const SCAN: f32 = 1e-3;

    fn slip() -> Slip {
        Slip::usual(0.8)
    }

    /// Estimates of a shear that grows from zero to the limit of friction `mu` in 200 scans. `seen`
    /// includes the slip annulus.
    fn dragged(state: &mut SlipState, mu: f32, seen: bool) -> std::vec::Vec<Verdict> {
        (0..=200)
            .map(|i| {
                let b = i as f32 / 200.0;
                let traction = Traction {
                    shear: [b * mu * 1.2, 0.0],
                    normal: 1.2,
                    ring: seen.then_some(FrictionUtilisation { weight: 400.0, moment: 400.0 * b }),
                    ..Traction::default()
                };
                slip().judge(state, &traction, SCAN).unwrap()
            })
            .collect()
    }

    /// Index of the first of `verdicts` that warns.
    fn warned(verdicts: &[Verdict]) -> usize {
        let mut state = SlipState::default();
        verdicts.iter().position(|verdict| slip().warns(&mut state, verdict)).unwrap()
    }

    #[test]
    fn warning_has_hysteresis_and_ends_with_contact() {
        let mut state = SlipState::default();
        let mut warns = |margin| {
            slip().warns(&mut state, &Verdict { margin, friction: 0.8, grip: Newtons(1.0) })
        };
        assert_eq!(
            [0.36, 0.345, 0.355, 0.345, 0.365, 0.375, 0.36].map(&mut warns),
            [false, true, true, true, true, false, false]
        );
        assert!(warns(0.3));
        state.release();
        assert!(
            !slip().warns(&mut state, &Verdict { margin: 0.36, friction: 0.8, grip: Newtons(1.0) })
        );
    }

    #[test]
    fn warning_precedes_slip_if_annulus_is_seen() {
        for mu in [0.2, 0.5, 0.8, 1.2] {
            let verdicts = dragged(&mut SlipState::default(), mu, true);
            let first = warned(&verdicts);
            assert!((80..190).contains(&first), "{mu}: {first}");
            let friction = verdicts[200].friction;
            assert!((friction / mu - 1.0).abs() < 0.3, "{mu}: {friction}");
        }
    }

    #[test]
    fn gross_slip_gives_friction_without_annulus() {
        let mut state = SlipState::default();
        let sliding =
            Traction { shear: [0.3, 0.0], normal: 1.0, slides: true, ..Traction::default() };
        for _ in 0..50 {
            assert_eq!(slip().judge(&mut state, &sliding, SCAN).unwrap().margin, 0.0);
        }
        let verdicts = dragged(&mut state, 0.3, false);
        let first = warned(&verdicts);
        assert!((100..190).contains(&first), "{first}");
    }

    #[test]
    fn shear_noise_leaves_friction_unbiased_in_slip() {
        let mut state = SlipState::default();
        for i in 0..400 {
            let [x, y] = [i & 1, i >> 1 & 1].map(|sign| if sign == 0 { 0.012 } else { -0.012 });
            let sliding = Traction {
                shear: [0.04 + x, y],
                normal: 0.2,
                sigma: [0.012, 0.0],
                slides: true,
                ..Traction::default()
            };
            slip().judge(&mut state, &sliding, SCAN).unwrap();
        }
        let [inverse, _] = state.known.unwrap();
        // 14 % more without the correction.
        assert!((0.2 * inverse - 1.0).abs() < 0.04, "friction {}", 1.0 / inverse);
    }

    #[test]
    fn weak_annulus_adds_up_over_scans() {
        let mut state = SlipState::default();
        // The standard deviation of one scan is 0.7, half of the possible range.
        for i in 0..200 {
            let (b, noise) = (0.004 * i as f32, if i % 2 == 0 { 0.7 } else { -0.7 });
            let ring = Some(FrictionUtilisation { weight: 2.0, moment: 2.0 * (b + noise) });
            let shear = [0.3 * b, 0.0];
            slip()
                .judge(
                    &mut state,
                    &Traction { shear, normal: 1.0, ring, ..Traction::default() },
                    SCAN,
                )
                .unwrap();
        }
        let [inverse, _] = state.known.unwrap();
        assert!((0.3 * inverse - 1.0).abs() < 0.3, "friction {}", 1.0 / inverse);
    }

    #[test]
    fn error_shared_by_all_scans_counts_once() {
        // A tenth of the friction 0.8 is used; every scan says two fifths.
        for (spread, weight, scans) in [
            (1.5, 10.0, 1),
            (1.5, 10.0, 20),
            (1.5, 10.0, 20_000),
            (0.3, 10.0, 1_000),
            (1.5, 1e6, 1),
        ] {
            let slip = Slip { usual: [0.8, spread], ..slip() };
            let mut state = SlipState::default();
            let ring = Some(FrictionUtilisation { weight, moment: 0.4 * weight });
            let held = Traction { shear: [0.08, 0.0], normal: 1.0, ring, ..Traction::default() };
            let frictions =
                (0..scans).map(|_| slip.judge(&mut state, &held, SCAN).unwrap().friction);
            let last = frictions.last().unwrap();
            // Half of each scan is new; all scans together count for less than 1/0.1².
            let new = 0.5 * weight * scans as f32;
            let seen = 0.08 * 0.08 * new / (1.0 + new * 0.1 * 0.1);
            let prior = 1.0 / (spread * spread);
            let expected = (prior + seen) / (prior / 0.8 + seen / 0.2);
            let off = last / expected - 1.0;
            assert!(off.abs() < 0.03, "{spread}, {weight}, {scans}: {last}, expected {expected}");
        }
    }

    #[test]
    fn light_touch_warns_for_shear_not_noise() {
        let warned = |shear: f32| {
            let mut state = SlipState::default();
            let frames = (0..500).filter(|i| {
                let shear = [shear + if i % 2 == 0 { 0.03 } else { -0.03 }, 0.0];
                let sigma = [0.02, 0.0];
                let traction = Traction { shear, normal: 0.2, sigma, ..Traction::default() };
                let verdict = slip().judge(&mut state, &traction, SCAN).unwrap();
                slip().warns(&mut state, &verdict)
            });
            frames.count()
        };
        assert_eq!(warned(0.08), 0);
        assert!(warned(0.15) > 400, "{}", warned(0.15));
    }

    #[test]
    fn shear_within_noise_gives_no_friction() {
        let mut state = SlipState::default();
        let ring = Some(FrictionUtilisation { weight: 400.0, moment: 400.0 });
        for _ in 0..200 {
            let traction = Traction {
                shear: [0.05, 0.0],
                normal: 0.06,
                sigma: [0.02, 0.0],
                ring,
                ..Traction::default()
            };
            let friction = slip().judge(&mut state, &traction, SCAN).unwrap().friction;
            assert!((friction - 0.8).abs() < 1e-3, "{friction}");
        }
    }

    /// State after 50 scans of gross slip.
    fn slid(mu: f32) -> SlipState {
        let mut state = SlipState::default();
        let slides =
            Traction { shear: [mu, 0.0], normal: 1.0, slides: true, ..Traction::default() };
        for _ in 0..50 {
            slip().judge(&mut state, &slides, SCAN).unwrap();
        }
        state
    }

    #[test]
    fn friction_is_less_certain_after_each_contact() {
        let learned = |contacts: usize| {
            let mut state = slid(0.3);
            (0..contacts).for_each(|_| state.release());
            // Half way to the limit of another material.
            dragged(&mut state, 1.0, true)[100].friction
        };
        assert!(learned(0) < 0.6, "{}", learned(0));
        assert!(learned(20) > 0.65, "{}", learned(20));
    }

    #[test]
    fn annulus_does_not_change_friction_known_better() {
        let mut state = slid(0.5);
        // A quarter of the normal force uses half of the friction; 0.6 is within the systematic
        // error.
        let ring = Some(FrictionUtilisation { weight: 400.0, moment: 400.0 * 0.6 });
        let held = Traction { shear: [0.25, 0.0], normal: 1.0, ring, ..Traction::default() };
        let friction = (0..1000)
            .map(|_| slip().judge(&mut state, &held, SCAN).unwrap().friction)
            .last()
            .unwrap();
        assert!((friction / 0.5 - 1.0).abs() < 0.03, "{friction}");
    }

    #[test]
    fn holding_contact_does_not_slip() {
        let mut state = SlipState::default();
        let verdicts = dragged(&mut state, 1.4, false);
        assert!(verdicts[200].friction >= 1.4 - 1e-4, "{}", verdicts[200].friction);
    }

    #[test]
    fn recommended_grip_leaves_the_safe_margin() {
        let mut state = SlipState::default();
        let shear = [0.5, 0.0];
        let traction = Traction { shear, normal: 0.8, ..Traction::default() };
        let now = slip().judge(&mut state, &traction, SCAN).unwrap();
        let gripped = Traction { shear, normal: now.grip.0, ..Traction::default() };
        let then = slip().judge(&mut state, &gripped, SCAN).unwrap();
        assert!((then.margin - (1.0 - 1.0 / 1.5)).abs() < 0.01, "{now:?} {then:?}");
    }

    #[test]
    fn two_contacts_share_friction_and_hold_more_torsion() {
        let judged = |torsion, arm| {
            let traction =
                Traction { shear: [0.3, -0.4], normal: 1.25, torsion, arm, ..Traction::default() };
            slip().judge(&mut SlipState::default(), &traction, SCAN).unwrap().margin
        };
        // 0.5 N of 0.8 · 1.25 N, for any positions.
        for arm in [0.0, 2.5, 4.0] {
            assert!((judged(0.0, arm) - 0.5).abs() < 1e-3, "{arm}: {}", judged(0.0, arm));
        }
        // Two contacts, 5 mm apart and pressed alike, hold 2.5 mm · 0.8 · 1.25 N by that alone.
        assert_eq!(judged(2.0, 0.0), 0.0);
        let apart = judged(2.0, 2.5);
        assert!((0.1..0.4).contains(&apart), "{apart}");
    }

    #[test]
    fn torsion_uses_friction() {
        let turned = |torsion| {
            let traction =
                Traction { shear: [0.3, 0.0], normal: 1.0, torsion, ..Traction::default() };
            slip().judge(&mut SlipState::default(), &traction, SCAN).unwrap().margin
        };
        assert!(turned(0.5) < turned(0.0));
    }

    proptest! {
        #[test]
        fn verdict_is_finite_and_margin_within_zero_to_one(
            tractions in proptest::collection::vec(
                (any::<[f32; 2]>(), any::<f32>(), any::<[f32; 2]>(), proptest::option::of((-1.0..2.0f32, 0.0..1e30f32)), any::<bool>()),
                1..20,
            ),
            mu in any::<f32>(),
        ) {
            let slip = Slip::usual(mu);
            let mut state = SlipState::default();
            for (shear, normal, [torsion, arm], ring, slides) in tractions {
                let ring = ring.map(|(b, weight)| FrictionUtilisation { weight, moment: weight * b });
                let sigma = [torsion, normal];
                let rubs = !slides;
                let traction = Traction { shear, normal, torsion, arm, sigma, ring, rubs, slides, ..Traction::default() };
                let Ok(verdict) = slip.judge(&mut state, &traction, SCAN) else { continue };
                prop_assert!((0.0..=1.0).contains(&verdict.margin), "{verdict:?}");
                prop_assert!(verdict.friction.is_finite() && verdict.grip.0.is_finite(), "{verdict:?}");
            }
        }
    }
}
