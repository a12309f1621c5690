//! Where the indenter is and how hard it pushes, over time; friction limited.

use std::f64::consts::TAU;

use rand_distr::{Distribution as _, Uniform};

use crate::scene::{Press, Random, Scene, Slide};
use crate::seeds::{Purpose, stream};

/// What acts on the skin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Contact point in mm.
    pub point: [f64; 2],
    /// Force in newtons, z into the skin.
    pub force: [f64; 3],
    /// The shear that was asked for is more than friction holds.
    pub slip: bool,
}

impl Load {
    /// Coulomb: |Q| ≤ μP. What exceeds it is lost to slip.
    fn limited(point: [f64; 2], shear: [f64; 2], normal: f64, mu: f64) -> Option<Self> {
        if normal <= 0.0 {
            return None;
        }
        let [x, y] = shear;
        let (asked, held) = (x.hypot(y), mu * normal);
        let slip = asked > held;
        let share = if slip { held / asked } else { 1.0 };
        Some(Self { point, force: [x * share, y * share, normal], slip })
    }
}

/// Everything that happens in a scene.
#[derive(Clone, Debug)]
pub struct Path {
    acts: Vec<Act>,
    mu: f64,
    seed: u64,
    drawn: Option<(u8, u32, Drawn)>,
}

#[derive(Clone, Debug)]
enum Act {
    Press(Press),
    Slide(Slide),
    Random(u8, Random),
}

impl Path {
    /// The path of the scene; random presses follow from `seed`.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let presses = scene.press.iter().map(|p| Act::Press(*p.get_ref()));
        let slides = scene.slide.iter().map(|s| Act::Slide(*s.get_ref()));
        let random = (0..).zip(&scene.random).map(|(i, r)| Act::Random(i, *r.get_ref()));
        let mut acts: Vec<Act> = presses.chain(slides).chain(random).collect();
        acts.sort_by(|a, b| a.at_s().total_cmp(&b.at_s()));
        Self { acts, mu: scene.friction.mu, seed, drawn: None }
    }

    /// What acts at `time` seconds; `None` where nothing touches.
    pub fn at(&mut self, time: f64) -> Option<Load> {
        let next = self.acts.partition_point(|act| act.at_s() <= time);
        match self.acts.get(next.checked_sub(1)?)? {
            Act::Press(press) => press.at(time - press.at_s, self.mu),
            Act::Slide(slide) => slide.at(time - slide.at_s, self.mu),
            Act::Random(act, random) => {
                let (act, random) = (*act, *random);
                let since = time - random.at_s;
                let press = (since / random.each_s) as u32;
                if press >= random.presses {
                    return None;
                }
                let drawn = match self.drawn {
                    Some((a, p, drawn)) if (a, p) == (act, press) => drawn,
                    _ => Drawn::new(&random, self.seed, act, press),
                };
                self.drawn = Some((act, press, drawn));
                drawn.at(since / random.each_s - f64::from(press), self.mu)
            }
        }
    }
}

impl Act {
    fn at_s(&self) -> f64 {
        match self {
            Self::Press(press) => press.at_s,
            Self::Slide(slide) => slide.at_s,
            Self::Random(_, random) => random.at_s,
        }
    }
}

impl Press {
    /// When it is over, in seconds of the scene.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.at_s + self.rise_s + self.hold_s + self.fall_s
    }

    fn at(&self, since: f64, mu: f64) -> Option<Load> {
        let normal = self.fz_n * pulse(since, self.rise_s, self.hold_s, self.fall_s);
        let third = self.hold_s / 3.0;
        let shear = pulse(since - self.rise_s, third, third, third);
        let shear = [self.fx_n * shear, self.fy_n * shear];
        Load::limited([self.x_mm, self.y_mm], shear, normal, mu)
    }
}

impl Slide {
    /// When it is over, in seconds of the scene.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.at_s + self.rise_s + self.travel_s + self.fall_s
    }

    fn at(&self, since: f64, mu: f64) -> Option<Load> {
        /// Shares of the drag during which the contact sticks, at its beginning and at its end.
        const STICK: f64 = 0.1;
        /// The drag pulls this much harder than friction holds.
        const PULL: f64 = 1.05;
        let normal = self.fz_n * pulse(since, self.rise_s, self.travel_s, self.fall_s);
        let way = (since - self.rise_s) / self.travel_s;
        let pull = PULL * pulse(way, STICK, 1.0 - 2.0 * STICK, STICK);
        let done = ((way - STICK) / (1.0 - 2.0 * STICK)).clamp(0.0, 1.0);
        let [dx, dy] = [self.to_mm[0] - self.from_mm[0], self.to_mm[1] - self.from_mm[1]];
        let length = dx.hypot(dy).max(f64::MIN_POSITIVE);
        let point = [self.from_mm[0] + dx * done, self.from_mm[1] + dy * done];
        let shear = [dx, dy].map(|d| d / length * pull * mu * normal);
        Load::limited(point, shear, normal, mu)
    }
}

impl Random {
    /// When the last press is over, in seconds of the scene.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.at_s + f64::from(self.presses) * self.each_s
    }
}

/// One random press.
#[derive(Clone, Copy, Debug)]
struct Drawn {
    from: [f64; 2],
    to: [f64; 2],
    normal: f64,
    shear_of_limit: f64,
    direction: f64,
    turn: f64,
}

impl Drawn {
    fn new(random: &Random, seed: u64, act: u8, press: u32) -> Self {
        let mut rng = stream(seed, Purpose::RandomPress(act, press));
        let mut draw = |[low, high]: [f64; 2]| {
            // Refused only for ranges that the scene's check has refused before.
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

    /// At `phase` 0 … 1 of its time: a tenth of rest at both ends, rise and fall without a hold, so that
    /// every force up to the peak is met; shear comes after and goes before.
    fn at(&self, phase: f64, mu: f64) -> Option<Load> {
        let normal = self.normal * pulse(phase - 0.1, 0.4, 0.0, 0.4);
        let shear = self.shear_of_limit * pulse(phase - 0.2, 0.2, 0.2, 0.2) * mu * normal;
        let angle = self.direction + self.turn * phase;
        let point = [0, 1].map(|i| match (self.from.get(i), self.to.get(i)) {
            (Some(from), Some(to)) => from + (to - from) * phase,
            _ => 0.0,
        });
        Load::limited(point, [shear * angle.cos(), shear * angle.sin()], normal, mu)
    }
}

/// From 0 to 1 during `rise`, 1 during `hold`, back to 0 during `fall`; without jerks.
fn pulse(since: f64, rise: f64, hold: f64, fall: f64) -> f64 {
    let smooth = |x: f64| {
        let x = x.clamp(0.0, 1.0);
        x * x * (3.0 - 2.0 * x)
    };
    if since <= rise { smooth(since / rise) } else { smooth((rise + hold + fall - since) / fall) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn path(text: &str) -> Path {
        let text = format!("[scan]\nrate_hz = 1000\nduration_s = 100\n{text}");
        Path::new(&Scene::parse("test.toml", &text).unwrap(), 3)
    }

    const PRESS: &str = "[[press]]\nat_s = 1\nx_mm = 1\ny_mm = -2\nfz_n = 1.5\nfx_n = 0.6\n\
                         rise_s = 0.2\nhold_s = 0.6\nfall_s = 0.2\n";
    const SLIDE: &str = "[[slide]]\nat_s = 1\nfrom_mm = [-3, 0]\nto_mm = [1, 3]\nfz_n = 0.9\n\
                         rise_s = 0.2\ntravel_s = 1.0\nfall_s = 0.2\n";

    #[test]
    fn a_press_rises_shears_and_is_gone() {
        let mut path = path(PRESS);
        assert_eq!(path.at(0.9), None);
        assert_eq!(path.at(1.2).unwrap().force, [0.0, 0.0, 1.5]);
        let held = path.at(1.5).unwrap();
        assert_eq!((held.point, held.slip), ([1.0, -2.0], false));
        assert!((held.force[0] - 0.6).abs() < 1e-12);
        assert_eq!(path.at(2.01), None);
    }

    #[test]
    fn more_shear_than_friction_holds_is_slip_and_the_force_is_the_one_held() {
        let mut path = path(&format!("[friction]\nmu = 0.2\n{PRESS}"));
        let held = path.at(1.5).unwrap();
        assert!(held.slip);
        assert!((held.force[0] - 0.2 * 1.5).abs() < 1e-12);
    }

    #[test]
    fn a_slide_slips_while_it_moves_and_sticks_at_both_ends() {
        let mut path = path(SLIDE);
        assert!(!path.at(1.21).unwrap().slip);
        let middle = path.at(1.7).unwrap();
        assert!(middle.slip);
        assert!((middle.point[0] + 1.0).abs() < 1e-9 && (middle.point[1] - 1.5).abs() < 1e-9);
        assert!((middle.force[0] - 0.8 * 0.8 * 0.9).abs() < 1e-9, "along its way: {middle:?}");
        assert!((middle.force[1] - 0.6 * 0.8 * 0.9).abs() < 1e-9, "along its way: {middle:?}");
        let last = path.at(2.3).unwrap();
        assert_eq!((last.point, last.slip), ([1.0, 3.0], false));
    }

    #[test]
    fn random_presses_are_the_seeds() {
        let text = "[scan]\nrate_hz = 100\nduration_s = 10\n[[random]]\nat_s = 0\npresses = 10\n\
                    each_s = 1\nx_mm = [-3, 3]\ny_mm = [-3, 3]\nfz_n = [0.1, 1.8]\n";
        let scene = Scene::parse("test.toml", text).unwrap();
        let run = |seed| -> Vec<Option<Load>> {
            let mut path = Path::new(&scene, seed);
            (0..100).map(|i| path.at(f64::from(i) * 0.1 + 0.05)).collect()
        };
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
    }

    proptest! {
        #[test]
        fn friction_holds_no_more_than_mu_p_and_keeps_the_direction(
            qx in -3.0..3.0f64, qy in -3.0..3.0f64, p in 0.001..3.0f64, mu in 0.0..2.0f64,
        ) {
            let load = Load::limited([0.0; 2], [qx, qy], p, mu).unwrap();
            let [fx, fy, fz] = load.force;
            prop_assert_eq!(fz, p);
            prop_assert!(fx.hypot(fy) <= mu * p * (1.0 + 1e-12));
            prop_assert!((fx * qy - fy * qx).abs() < 1e-9 && fx * qx + fy * qy >= 0.0);
            prop_assert_eq!(load.slip, qx.hypot(qy) > mu * p);
        }

        #[test]
        fn random_presses_keep_their_ranges_and_never_slip(time in 0.0..60.0f64) {
            let load = path(
                "[[random]]\nat_s = 0\npresses = 60\neach_s = 1\nx_mm = [-1.5, 1.5]\n\
                 y_mm = [0, 2]\nfz_n = [0.2, 1.8]\nshear_of_limit = [0.2, 0.95]\nroll_mm = 2\n",
            ).at(time);
            if let Some(Load { point: [x, y], force: [.., fz], slip }) = load {
                prop_assert!(x.abs() <= 1.5 && (0.0..=2.0).contains(&y) && fz <= 1.8 && !slip);
            }
        }

        #[test]
        fn nothing_jumps(time in 0.9..2.6f64) {
            for text in [PRESS, SLIDE] {
                let mut path = path(text);
                let force = |load: Option<Load>| load.map_or([0.0; 3], |load| load.force);
                let (a, b) = (force(path.at(time)), force(path.at(time + 1e-4)));
                for (a, b) in a.iter().zip(b) {
                    prop_assert!((a - b).abs() < 0.005);
                }
            }
        }
    }
}
