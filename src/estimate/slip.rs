//! Incipient slip: how much of its friction a contact has left, what that friction is, and how hard to
//! grip.
//!
//! A sheared contact slips from its rim inwards long before it slides. The optical matrix sees that ring
//! in the shape of its signals (the share of friction in use, [`super::inverse`]), whatever the friction
//! coefficient is; so a contact that is sheared tells its friction, μ = F_t/(b·F_n), before it slips. What
//! was told is kept, for contacts and sensors that cannot see the ring, and put right whenever the contact
//! holds more than was thought, or slides.

use serde::{Deserialize, Serialize};

use super::limit_surface::LimitSurface;
use crate::roots::sqrt;
use crate::units::Newtons;

/// How slip is judged.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Slip {
    /// Friction coefficient before any is known, and how much 1/μ may differ from its own (1 σ).
    pub usual: [f32; 2],
    /// What the contact holds.
    pub surface: LimitSurface,
    /// A warning is due below this margin.
    pub warn: f32,
    /// The grip that is recommended leaves the load at one over this.
    pub safety: f32,
}

impl Slip {
    /// For a sphere of 6 mm on the silicone of 002, friction taken as `mu` at first. Rubber's lies between
    /// 0.2 and 1.2 on most things: 1/μ is 0.8 to 5.
    #[must_use]
    pub fn usual(mu: f32) -> Self {
        Self { usual: [mu, 1.5], surface: LimitSurface::hertz(6.0, 0.236), warn: 0.35, safety: 1.5 }
    }
}

/// What one contact does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traction {
    /// Shear in newtons.
    pub shear: [f32; 2],
    /// Normal force in newtons.
    pub normal: f32,
    /// Torsion in N·mm.
    pub torsion: f32,
    /// Share of friction in use as the ring shows it, and its standard deviation, where it is seen.
    pub used: Option<[f32; 2]>,
    /// It slides, as its vibration or its way tells.
    pub slides: bool,
}

/// What is known of a contact's friction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SlipState {
    /// 1/μ and its variance.
    known: Option<[f32; 2]>,
}

/// The verdict on one contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// What is left of the friction: 1 unloaded, 0 at the limit.
    pub margin: f32,
    /// The friction coefficient taken.
    pub friction: f32,
    /// Normal force that would leave the safe margin at this shear and torsion.
    pub grip: Newtons,
    /// The margin is below the warning's.
    pub warning: bool,
}

/// Least normal force for which friction is estimated, in newtons.
const LEAST_NORMAL: f32 = 0.05;
/// The ring is no truer than this share of friction, however sure the fit is: what the field's form
/// leaves out is the same from frame to frame.
const RING_ERROR: f32 = 0.1;
/// … so a frame counts as this share of a new observation.
const NEW: f32 = 0.02;
/// A ring that says less than this much of its friction is in use says nothing of μ.
const LEAST_USED: f32 = 0.35;
/// How the variance of 1/μ grows from frame to frame: things touched change.
const WANDER: f32 = 1e-6;
/// … and from contact to contact.
const NEXT_THING: f32 = 0.04;
/// μ lies between these; rubber on most things does.
const FRICTION: [f32; 2] = [0.05, 2.0];

impl SlipState {
    /// The contact ended: friction stays known, less surely, because the next thing may be another.
    pub fn release(&mut self) {
        if let Some([_, variance]) = &mut self.known {
            *variance += NEXT_THING;
        }
    }
}

impl Slip {
    /// One frame of a contact.
    pub fn judge(&self, state: &mut SlipState, traction: &Traction) -> Verdict {
        let [usual, spread] = self.usual;
        let Traction { shear: [fx, fy], normal, torsion, used, slides } = *traction;
        let [mut inverse, mut variance] =
            state.known.unwrap_or([1.0 / usual.clamp(FRICTION[0], FRICTION[1]), spread * spread]);
        variance = (variance + WANDER).min(spread * spread);
        let touching = normal > LEAST_NORMAL;
        let ratio =
            if touching { (sqrt(fx * fx + fy * fy) / normal).min(FRICTION[1]) } else { 0.0 };
        let mut observe = |used: f32, noise: f32, share: f32| {
            // b = F_t/F_n · 1/μ is linear in 1/μ: one step of Kalman's filter.
            let gain = variance * ratio / (ratio * ratio * variance + noise * noise / share);
            inverse += gain * (used - ratio * inverse);
            variance -= gain * ratio * variance;
        };
        if touching && slides && ratio > FRICTION[0] {
            observe(1.0, 0.05, 0.5);
        } else if let (true, Some([b, sigma])) = (touching, used)
            && b > LEAST_USED
        {
            observe(b.min(1.0), sigma + RING_ERROR, NEW);
        }
        // What holds is held: μ is at least the ratio seen.
        let most = if ratio > FRICTION[0] { 1.0 / ratio } else { 1.0 / FRICTION[0] };
        if !slides && inverse > most {
            inverse = most;
        }
        inverse = inverse.clamp(1.0 / FRICTION[1], 1.0 / FRICTION[0]);
        state.known = Some([inverse, variance]);
        let friction = 1.0 / inverse;

        let held = self.surface.load([fx, fy], torsion, normal, friction);
        let load = match used {
            // Torsion adds to what the ring of shear shows as the surface has it.
            Some([b, sigma]) if touching => {
                let doubt = sqrt(ratio * ratio * variance);
                let (a, r) = (sigma + RING_ERROR, doubt + 0.02);
                let (wa, wr) = (1.0 / (a * a), 1.0 / (r * r));
                (b.clamp(0.0, 1.0) * wa + held.min(1.0) * wr) / (wa + wr)
            }
            _ => held,
        };
        let load = if slides { 1.0 } else { load.clamp(0.0, 1.0) };
        let margin = 1.0 - load;
        let grip = (self.safety * load * normal).clamp(0.0, 1e3);
        Verdict { margin, friction, grip: Newtons(grip), warning: touching && margin < self.warn }
    }
}

/// The finger's margin is that of the contact that will slip first.
#[must_use]
pub fn overall(verdicts: &[Verdict]) -> Option<Verdict> {
    verdicts.iter().copied().reduce(|a, b| if b.margin < a.margin { b } else { a })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn slip() -> Slip {
        Slip::usual(0.8)
    }

    /// Shear that grows from nothing to the limit of friction `mu` in 200 frames, with or without sight
    /// of the ring; margins of the frames.
    fn dragged(state: &mut SlipState, mu: f32, seen: bool) -> std::vec::Vec<Verdict> {
        (0..=200)
            .map(|i| {
                let b = i as f32 / 200.0;
                let traction = Traction {
                    shear: [b * mu * 1.2, 0.0],
                    normal: 1.2,
                    used: seen.then_some([b, 0.05]),
                    ..Traction::default()
                };
                slip().judge(state, &traction)
            })
            .collect()
    }

    #[test]
    fn where_the_ring_is_seen_the_warning_comes_before_the_slip_whatever_the_friction() {
        for mu in [0.2, 0.5, 0.8, 1.2] {
            let verdicts = dragged(&mut SlipState::default(), mu, true);
            let first = verdicts.iter().position(|v| v.warning).unwrap();
            assert!((80..190).contains(&first), "{mu}: {first}");
            let friction = verdicts[200].friction;
            assert!((friction / mu - 1.0).abs() < 0.3, "{mu}: {friction}");
        }
    }

    #[test]
    fn a_slide_teaches_the_friction_to_a_sensor_that_cannot_see_the_ring() {
        let mut state = SlipState::default();
        let sliding =
            Traction { shear: [0.3, 0.0], normal: 1.0, slides: true, ..Traction::default() };
        for _ in 0..50 {
            assert_eq!(slip().judge(&mut state, &sliding).margin, 0.0);
        }
        let verdicts = dragged(&mut state, 0.3, false);
        let first = verdicts.iter().position(|v| v.warning).unwrap();
        assert!((100..190).contains(&first), "{first}");
    }

    #[test]
    fn what_holds_is_not_said_to_slip() {
        let mut state = SlipState::default();
        let verdicts = dragged(&mut state, 1.4, false);
        assert!(verdicts[200].friction >= 1.4 - 1e-4, "{}", verdicts[200].friction);
    }

    #[test]
    fn the_recommended_grip_leaves_the_margin_that_it_promises() {
        let mut state = SlipState::default();
        let shear = [0.5, 0.0];
        let now = slip().judge(&mut state, &Traction { shear, normal: 0.8, ..Traction::default() });
        let gripped = Traction { shear, normal: now.grip.0, ..Traction::default() };
        let then = slip().judge(&mut state, &gripped);
        assert!((then.margin - (1.0 - 1.0 / 1.5)).abs() < 0.01, "{now:?} {then:?}");
    }

    #[test]
    fn torsion_uses_up_friction_too() {
        let turned = |torsion| {
            let traction =
                Traction { shear: [0.3, 0.0], normal: 1.0, torsion, ..Traction::default() };
            slip().judge(&mut SlipState::default(), &traction).margin
        };
        assert!(turned(0.5) < turned(0.0));
    }

    #[test]
    fn the_finger_slips_where_its_weakest_contact_does() {
        let mut state = SlipState::default();
        let of = |shear, state: &mut SlipState| {
            slip()
                .judge(state, &Traction { shear: [shear, 0.0], normal: 1.0, ..Traction::default() })
        };
        let verdicts = [of(0.1, &mut state), of(0.6, &mut state)];
        assert_eq!(overall(&verdicts), Some(verdicts[1]));
        assert_eq!(overall(&[]), None);
    }

    proptest! {
        #[test]
        fn no_traction_gives_nan_or_infinity_or_a_margin_outside_zero_to_one(
            tractions in proptest::collection::vec(
                (any::<[f32; 2]>(), any::<f32>(), any::<f32>(), proptest::option::of((-1.0..2.0f32, 0.0..9.0f32)), any::<bool>()),
                1..20,
            ),
            mu in any::<f32>(),
        ) {
            let slip = Slip::usual(mu);
            let mut state = SlipState::default();
            for (shear, normal, torsion, used, slides) in tractions {
                let used = used.map(|(b, sigma)| [b, sigma]);
                let verdict = slip.judge(&mut state, &Traction { shear, normal, torsion, used, slides });
                prop_assert!((0.0..=1.0).contains(&verdict.margin), "{verdict:?}");
                prop_assert!(verdict.friction.is_finite() && verdict.grip.0.is_finite(), "{verdict:?}");
            }
        }
    }
}
