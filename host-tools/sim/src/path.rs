//! Where the indenter is and how hard it pushes, over time; friction limited.

use crate::scene::{Act, MOST_CONTACTS, Scene};

mod grip;
mod motion;
mod random;
mod trials;

pub use grip::Grip;
use random::Drawn;

/// What acts on the skin at one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Contact point in mm.
    pub point: [f64; 2],
    /// Force in newtons, z into the skin.
    pub force: [f64; 3],
    /// Moment about the normal at the contact point in N mm, from x to y.
    pub torsion: f64,
    /// More is asked for than friction holds.
    pub slip: bool,
}

/// All that acts on the skin at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contacts {
    loads: [Load; MOST_CONTACTS],
    count: usize,
}

impl Contacts {
    /// The loads, one for each contact.
    #[must_use]
    pub fn loads(&self) -> &[Load] {
        self.loads.get(..self.count).unwrap_or(&self.loads)
    }

    /// Nothing touches.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Adds one; beyond the most that a scene may have, it is left out.
    pub fn push(&mut self, load: Load) {
        if let Some(place) = self.loads.get_mut(self.count) {
            *place = load;
            self.count += 1;
        }
    }

    /// The one load that does the same to a rigid finger: the sum of the forces, at the mean of the
    /// contact points weighted by normal force, and what is left of their moments about the normal
    /// there. It slips where one of them does. `None` where nothing touches.
    #[must_use]
    pub fn whole(&self) -> Option<Load> {
        let (first, others) = self.loads().split_first()?;
        if others.is_empty() {
            return Some(*first);
        }
        let sum = |value: &dyn Fn(&Load) -> f64| self.loads().iter().map(value).sum::<f64>();
        let force = [sum(&|l| l.force[0]), sum(&|l| l.force[1]), sum(&|l| l.force[2])];
        let [x, y] = [sum(&|l| l.point[0] * l.force[2]), sum(&|l| l.point[1] * l.force[2])]
            .map(|moment| moment / force[2]);
        let torsion =
            sum(&|l| l.torsion + (l.point[0] - x) * l.force[1] - (l.point[1] - y) * l.force[0]);
        let slip = self.loads().iter().any(|load| load.slip);
        Some(Load { point: [x, y], force, torsion, slip })
    }

    /// With all forces and moments so many times as large.
    #[must_use]
    pub fn scaled(mut self, times: f64) -> Self {
        for load in &mut self.loads {
            load.force = load.force.map(|force| force * times);
            load.torsion *= times;
        }
        self
    }
}

impl From<Load> for Contacts {
    fn from(load: Load) -> Self {
        let mut contacts = Self::default();
        contacts.push(load);
        contacts
    }
}

/// Everything that happens in a scene.
#[derive(Clone, Debug)]
pub struct Path {
    acts: Vec<Act>,
    /// For each act the first one that is not over when it begins.
    running_since: Vec<usize>,
    grip: Grip,
    seed: u64,
    drawn: Option<(u8, u32, Drawn)>,
}

impl Path {
    /// The path of the scene; random presses follow from `seed`.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let acts = scene.acts();
        let running = |act: &Act| acts.iter().position(|other| other.end_s() > act.at_s());
        let running_since = acts.iter().map(|act| running(act).unwrap_or_default()).collect();
        Self { running_since, acts, grip: Grip::new(scene), seed, drawn: None }
    }

    /// What acts at `time` seconds.
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
                // It is alone.
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
