//! Presses drawn from ranges.

use std::f64::consts::TAU;

use rand_distr::{Distribution as _, Uniform};

use super::Grip;
use super::motion::{between, pulse};
use crate::load::Load;
use crate::scene::Random;
use crate::seeds::{Purpose, stream};

/// Press drawn at random.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drawn {
    from: [f64; 2],
    to: [f64; 2],
    normal: f64,
    shear_of_limit: f64,
    direction: f64,
    turn: f64,
}

impl Drawn {
    pub(super) fn new(random: &Random, seed: u64, act: u8, press: u32) -> Self {
        let mut rng = stream(seed, Purpose::RandomPress(act, press));
        let mut draw = |[low, high]: [f64; 2]| {
            // Fails only for ranges that the scene's check has already rejected.
            Uniform::new_inclusive(low, high).map_or(low, |range| range.sample(&mut rng))
        };
        let from = [draw(random.x_mm), draw(random.y_mm)];
        let (heading, way) = (draw([0.0, TAU]), draw([0.0, random.roll_mm]));
        let to = [
            (from[0] + way * heading.cos()).clamp(random.x_mm[0], random.x_mm[1]),
            (from[1] + way * heading.sin()).clamp(random.y_mm[0], random.y_mm[1]),
        ];
        Self {
            from,
            to,
            normal: draw(random.fz_n),
            shear_of_limit: draw(random.shear_of_limit),
            direction: draw([0.0, TAU]),
            turn: draw([-TAU / 2.0, TAU / 2.0]),
        }
    }

    /// Load at `phase` 0 … 1 of the press's time.
    ///
    /// The press rests for a tenth at both ends. Force rises and falls without a hold, so that
    /// every force up to the peak occurs. Shear begins later and ends earlier.
    pub(super) fn at(&self, phase: f64, grip: &Grip) -> Option<Load> {
        let normal = self.normal * pulse(phase - 0.1, 0.4, 0.0, 0.4);
        let shear = self.shear_of_limit * pulse(phase - 0.2, 0.2, 0.2, 0.2) * grip.mu * normal;
        let angle = self.direction + self.turn * phase;
        let point = between(self.from, self.to, phase);
        grip.hold(point, [shear * angle.cos(), shear * angle.sin()], 0.0, normal)
    }
}
