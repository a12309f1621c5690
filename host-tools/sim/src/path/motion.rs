//! Motion and force of each act.

use std::f64::consts::{PI, TAU};

use super::Grip;
use crate::load::Load;
use crate::scene::{Press, Roll, Slide, Spring, Tap};

impl Press {
    pub(super) fn at(&self, since: f64, grip: &Grip) -> Option<Load> {
        let normal = self.fz_n * pulse(since, self.rise_s, self.hold_s, self.fall_s);
        let third = self.hold_s / 3.0;
        let held = pulse(since - self.rise_s, third, third, third);
        let shear = [self.fx_n * held, self.fy_n * held];
        grip.hold([self.x_mm, self.y_mm], shear, self.torsion_nmm * held, normal)
    }
}

impl Tap {
    pub(super) fn at(&self, since: f64, grip: &Grip) -> Option<Load> {
        let phase = since / self.width_s;
        let normal = if phase < 1.0 { self.fz_n * (PI * phase).sin() } else { 0.0 };
        grip.hold([self.x_mm, self.y_mm], [0.0; 2], 0.0, normal)
    }
}

impl Roll {
    pub(super) fn at(&self, since: f64, grip: &Grip) -> Option<Load> {
        let normal = self.fz_n * pulse(since, self.rise_s, self.travel_s, self.fall_s);
        let done = ((since - self.rise_s) / self.travel_s).clamp(0.0, 1.0);
        grip.hold(between(self.from_mm, self.to_mm, done), [0.0; 2], 0.0, normal)
    }
}

impl Slide {
    pub(super) fn at(&self, since: f64, grip: &Grip) -> Option<Load> {
        let normal = self.fz_n * pulse(since, self.rise_s, self.travel_s, self.fall_s);
        match &self.spring {
            None => self.dragged(since, normal, grip),
            Some(spring) => self.sprung(spring, since, normal, grip),
        }
    }

    /// Load under a stiff drag.
    fn dragged(&self, since: f64, normal: f64, grip: &Grip) -> Option<Load> {
        /// Share of the drag during which the contact sticks, at its beginning and at its end.
        const STICK: f64 = 0.1;
        /// Ratio of the drag's pull to the friction limit.
        const PULL: f64 = 1.05;
        let way = (since - self.rise_s) / self.travel_s;
        let pull = PULL * pulse(way, STICK, 1.0 - 2.0 * STICK, STICK);
        let done = ((way - STICK) / (1.0 - 2.0 * STICK)).clamp(0.0, 1.0);
        let (_, [dx, dy]) = self.way();
        let shear = [dx, dy].map(|d| d * pull * grip.mu * normal);
        grip.hold(between(self.from_mm, self.to_mm, done), shear, 0.0, normal)
    }

    /// Load under a drag through a spring until the stage halts; the spring relaxes during the
    /// release.
    fn sprung(&self, spring: &Spring, since: f64, normal: f64, grip: &Grip) -> Option<Load> {
        let (length, direction) = self.way();
        let speed = length / self.travel_s;
        let dragged = (since - self.rise_s).clamp(0.0, self.travel_s);
        let pulled = Pulled::at(dragged, spring, speed, self.fz_n, grip);
        let limit = if pulled.slips { grip.mu_kinetic } else { grip.mu } * normal;
        let letting_go = since > self.rise_s + self.travel_s;
        let asked = spring.stiffness_n_mm * pulled.stretch;
        let (force, slip) = if letting_go || !pulled.slips {
            (asked.clamp(-limit, limit), asked.abs() > limit)
        } else {
            (limit, true)
        };
        let behind = if letting_go { force / spring.stiffness_n_mm } else { pulled.stretch };
        let along = (speed * dragged - behind) / length.max(f64::MIN_POSITIVE);
        let point = between(self.from_mm, self.to_mm, along);
        let force = [direction[0] * force, direction[1] * force, normal];
        (normal > 0.0).then_some(Load { point, force, torsion: 0.0, slip })
    }

    /// Length in mm and direction of the slide.
    fn way(&self) -> (f64, [f64; 2]) {
        let [dx, dy] = [self.to_mm[0] - self.from_mm[0], self.to_mm[1] - self.from_mm[1]];
        let length = dx.hypot(dy);
        (length, [dx, dy].map(|d| d / length.max(f64::MIN_POSITIVE)))
    }
}

/// Mass pulled over the skin by a spring whose other end moves at constant speed.
///
/// The mass sticks until the spring pulls with μP, then slips with kinetic friction until it is at
/// rest again. During slip the stretch e of the spring swings about e_k = μ_k P/k with ω = √(k/m):
/// e = e_k + A cos ωt + v/ω sin ωt, A = (μ − μ_k)P/k. The mass is at rest again when tan(ωt/2) =
/// −Aω/v, with e = e_k − A.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pulled {
    /// Stretch of the spring in mm.
    stretch: f64,
    slips: bool,
}

impl Pulled {
    /// State `dragged` seconds after the stage began to move at `speed` mm/s.
    fn at(dragged: f64, spring: &Spring, speed: f64, normal: f64, grip: &Grip) -> Self {
        let stiffness = spring.stiffness_n_mm;
        let [sticks, slips] = [grip.mu, grip.mu_kinetic].map(|mu| mu * normal / stiffness);
        if speed * dragged <= sticks {
            return Self { stretch: speed * dragged, slips: false };
        }
        // N/mm over grams is 10⁶ s⁻².
        let omega = (1e6 * stiffness / spring.mass_g).sqrt();
        let swing = sticks - slips;
        let slipping = (TAU - 2.0 * (swing * omega).atan2(speed)) / omega;
        let sticking = 2.0 * swing / speed;
        let since = (dragged - sticks / speed) % (slipping + sticking);
        if since < slipping {
            let (sin, cos) = (omega * since).sin_cos();
            Self { stretch: slips + swing * cos + speed / omega * sin, slips: true }
        } else {
            Self { stretch: slips - swing + speed * (since - slipping), slips: false }
        }
    }
}

/// Point at the share `done` of a straight path.
pub(super) fn between(from: [f64; 2], to: [f64; 2], done: f64) -> [f64; 2] {
    let ([x0, y0], [x1, y1]) = (from, to);
    [x0 + (x1 - x0) * done, y0 + (y1 - y0) * done]
}

/// Smooth pulse: from 0 to 1 during `rise`, 1 during `hold`, back to 0 during `fall`.
pub(super) fn pulse(since: f64, rise: f64, hold: f64, fall: f64) -> f64 {
    let smooth = |x: f64| {
        let x = x.clamp(0.0, 1.0);
        x * x * (3.0 - 2.0 * x)
    };
    if since <= rise { smooth(since / rise) } else { smooth((rise + hold + fall - since) / fall) }
}
