//! Path of the indenter: its position and force over time, limited by friction.

use crate::load::Contacts;
use crate::scene::{Act, Scene};

mod grip;
mod motion;
mod random;
mod trials;

pub use grip::Grip;
use random::Drawn;

/// Path of a scene: all of its acts.
#[derive(Clone, Debug)]
pub struct Path {
    acts: Vec<Act>,
    /// For each act, the index of the first act that has not ended when it begins.
    running_since: Vec<usize>,
    grip: Grip,
    seed: u64,
    drawn: Option<(u8, u32, Drawn)>,
}

impl Path {
    /// Creates the path of the scene; random presses follow from `seed`.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let acts = scene.acts();
        let running = |act: &Act| acts.iter().position(|other| other.end_s() > act.at_s());
        let running_since = acts.iter().map(|act| running(act).unwrap_or_default()).collect();
        Self { running_since, acts, grip: Grip::new(scene), seed, drawn: None }
    }

    /// Contacts at `time` seconds.
    pub fn at(&mut self, time: f64) -> Contacts {
        let mut contacts = Contacts::default();
        let next = self.acts.partition_point(|act| act.at_s() <= time);
        let since = next.checked_sub(1).and_then(|last| self.running_since.get(last));
        let running = since.and_then(|first| self.acts.get(*first..next)).unwrap_or_default();
        for act in running {
            let since = time - act.at_s();
            let load = match act {
                Act::Press(press) => press.at(since, &self.grip),
                Act::Slide(slide) => slide.at(since, &self.grip),
                Act::Tap(tap) => tap.at(since, &self.grip),
                Act::Roll(roll) => roll.at(since, &self.grip),
                Act::Random(act, random) => {
                    let press = (since / random.each_s) as u32;
                    if press >= random.presses.get() {
                        continue;
                    }
                    let drawn = match self.drawn {
                        Some((a, p, drawn)) if (a, p) == (*act, press) => drawn,
                        _ => Drawn::new(random, self.seed, *act, press),
                    };
                    self.drawn = Some((*act, press, drawn));
                    drawn.at(since / random.each_s - f64::from(press), &self.grip)
                }
                Act::Grid(grid) => grid.at(since, &self.grip),
                // A plate never overlaps another act.
                Act::Plate(plate) => return plate.at(since, &self.grip),
            };
            if let Some(load) = load {
                contacts.push(load);
            }
        }
        contacts
    }
}

#[cfg(test)]
mod tests;
