//! Guide through a calibration recording: presses seen so far, and the one to make next.
//!
//! ```text
//! codes ─▶ bias ─▶ contact ─▶ Press ─▶ filled targets ─▶ next target, or enough
//! ```
//! Without a calibration nothing is known in newtons. Strength is then the root mean square of the
//! taxels' changes relative to their light at rest, which grows nearly in proportion to the force
//! all over the pad, and is told relative to the hardest presses. The region is that of the taxel
//! that changes most; centroids are drawn to the middle by an unknown amount. The direction of a
//! shear comes from the force sensors; the matrix alone does not tell it, and a press then counts
//! for the direction that was asked for.

mod signals;
#[cfg(test)]
mod tests;
mod words;

use std::f64::consts::FRAC_PI_4;

use taxel::condition::{Bias, BiasTaker, Levels};
use taxel::estimate::contact_point::arg_min;
use taxel::estimate::gate::{Gate, GateState};
use taxel::scan::{COLS, Codes, ROWS};
use taxel::units::Micros;

use self::signals::{changes, follow, strength};
use self::words::TOWARDS;
use crate::coverage::nearest;

/// Longest press. A longer contact is a bias that no longer holds, or a finger that was put down.
const LONGEST_US: u64 = 20_000_000;
/// Hardest presses that are left out of the full strength, because one may be a mishap.
const MISHAPS: usize = 2;
/// Least strength of a press, as a share of the full strength, by level: light, medium, hard.
///
/// A corner has two thirds of the middle's signals at the same force.
const LEVELS: [f64; 3] = [0.05, 0.3, 0.6];
/// Strength to ask for at each level, as a share of the full strength.
const ASKED: [f64; 3] = [0.2, 0.45, 0.85];
/// Least shear over normal signal that is a push sideways.
const SHEARED: f64 = 0.2;
/// Least strength, as a share of the press's own peak, at which its shear counts.
const FIRM: f64 = 0.5;
/// Presses that are to be held, and as many that are to be fast.
const TIMES: usize = 3;
/// Presses from which a fit finds the lag of a finger with force sensors.
const PRESSES: usize = 100;
/// Presses after which a target that none of them meets is left out.
const PATIENCE: usize = 8;

/// Values of a calibrated finger's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// Force in newtons.
    pub force: [f64; 3],
    /// Contact point in millimetres, if it is known.
    pub place: Option<[f64; 2]>,
}

/// Press that has ended.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Press {
    /// Index of the region around a taxel.
    region: usize,
    /// Largest strength.
    peak: f64,
    /// Eighth of the circle in which it was sheared.
    towards: Option<usize>,
    held: bool,
    fast: bool,
}

/// Load that is to be recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Target {
    /// The hardest press in the middle.
    Full,
    /// A press in a region, at a level of strength.
    Region(usize, usize),
    /// A push sideways in an eighth of the circle.
    Shear(usize),
    /// A press that is held.
    Hold,
    /// A fast press.
    Fast,
    /// A press anywhere, until there are [`PRESSES`].
    More,
}

/// Step of the recording, in words for the person who presses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// Nothing may touch the finger.
    LetGo,
    /// A press, as described.
    Press(String),
    /// Every target is met.
    Enough,
    /// Every target is met or left out; in words, the loads that the recording lacks.
    Ended(String),
}

/// Presses of a recording under way.
#[derive(Debug)]
pub struct Guide {
    /// Number of frames that the bias is averaged over.
    frames: u16,
    taker: BiasTaker,
    bias: Option<Bias>,
    gate: GateState,
    current: Option<Current>,
    presses: Vec<Press>,
    /// Whether the frames have force sensors, which tell the direction of shear.
    sensors: bool,
    /// Whether the strengths are newtons.
    newtons: bool,
    target: Option<Target>,
    /// Presses since the target was set.
    tries: usize,
    left_out: Vec<Target>,
    /// Whether targets that were left out are being asked for again.
    again: bool,
}

/// Press under way.
#[derive(Debug)]
struct Current {
    began: u64,
    /// Time and strength of each frame.
    course: Vec<(u64, f64)>,
    peak: f64,
    region: usize,
    /// Largest shear over normal signal while it is firm, and its eighth of the circle.
    shear: (f64, usize),
}

impl Guide {
    /// Begins a recording with the average of so many frames without a touch.
    #[must_use]
    pub fn new(frames: u16) -> Self {
        Self {
            frames,
            taker: BiasTaker::new(frames),
            bias: None,
            gate: GateState::default(),
            current: None,
            presses: Vec::new(),
            sensors: false,
            newtons: false,
            target: Some(Target::Full),
            tries: 0,
            left_out: Vec::new(),
            again: false,
        }
    }

    /// Adds the codes of a frame, and what a calibrated finger knows of it.
    ///
    /// Frames without codes of the matrix change nothing.
    pub fn add(&mut self, time: Micros, codes: &Codes, known: Option<Known>) {
        if codes.taxels.is_none() {
            return;
        }
        let levels = Levels::read(codes);
        let Some(bias) = self.bias.as_mut() else {
            let taken = self.taker.add(&levels, &Bias::default());
            if let Some(taken) = taken {
                // A finger that moved or was touched is averaged again.
                (self.taker, self.bias) = (BiasTaker::new(self.frames), taken.ok().map(|t| t.bias));
                if self.presses.is_empty() {
                    self.newtons = known.is_some();
                }
            }
            return;
        };
        let signals = bias.apply(&levels, None);
        let Some(changes) = changes(&signals, bias) else { return };
        let gate = Gate::default();
        let above = bias.exceeded(&signals, gate.threshold(&self.gate));
        // The gate compares the activity with the threshold of its state, which was done above.
        let touched = gate.update(&mut self.gate, if above { f32::MAX } else { 0.0 });
        if !touched {
            follow(bias, &levels);
            let ended = self.current.take();
            ended.into_iter().for_each(|press| self.end(&press));
            return;
        }
        let began = self.current.as_ref().map_or(time.0, |current| current.began);
        if time.0.saturating_sub(began) > LONGEST_US {
            (self.bias, self.current, self.gate) = (None, None, GateState::default());
            return;
        }
        if self.newtons && known.is_none() {
            return;
        }
        // A bias without a known force began strengths that are relative.
        let known = known.filter(|_| self.newtons);
        let (strength, shear) = strength(&signals, &changes, known);
        self.sensors |= signals.bridges.iter().any(Option::is_some);
        let strongest = || {
            let point = arg_min(&changes, signals.health.dead | signals.health.saturated).ok()?;
            Some([point.x, point.y].map(|c| f64::from(c.0)))
        };
        let Some(place) = known.and_then(|known| known.place).or_else(strongest) else { return };
        let current = self.current.get_or_insert_with(|| Current {
            began,
            course: Vec::new(),
            peak: 0.0,
            region: nearest(place),
            shear: (0.0, 0),
        });
        current.course.push((time.0, strength));
        if strength > current.peak {
            (current.peak, current.region) = (strength, nearest(place));
        }
        if let Some([x, y]) = shear
            && strength > FIRM * current.peak
            && x.hypot(y) > current.shear.0
        {
            let eighth = (y.atan2(x) / FRAC_PI_4).round() as i32;
            current.shear = (x.hypot(y), eighth.rem_euclid(8) as usize);
        }
    }

    /// Adds a press that has ended, and moves on from targets that are met or hopeless.
    fn end(&mut self, current: &Current) {
        let press = Press {
            region: current.region,
            peak: current.peak,
            towards: self.towards(current.shear),
            held: current.is_held(),
            fast: current.is_fast(),
        };
        self.presses.push(press);
        self.tries += 1;
        let hopeless = self.tries >= PATIENCE && self.target != Some(Target::More);
        self.left_out.extend(self.target.filter(|target| hopeless && !self.is_met(*target)));
        let mut next = self.next();
        if next.is_none() && !self.again {
            // They may have been left out for presses in an order of their own.
            self.again = true;
            self.left_out.clear();
            next = self.next();
        }
        if next != self.target {
            (self.target, self.tries) = (next, 0);
        }
    }

    /// Eighth of the circle of a push sideways.
    ///
    /// The matrix alone does not tell it: a press counts for the one that was asked for.
    fn towards(&self, (shear, eighth): (f64, usize)) -> Option<usize> {
        match self.target {
            _ if self.sensors || self.newtons => (shear > SHEARED).then_some(eighth),
            Some(Target::Shear(asked)) => Some(asked),
            _ => None,
        }
    }

    /// Every target, in the order in which they are asked for.
    fn targets(&self) -> Vec<Target> {
        let mut all = vec![Target::Full];
        for row in (0..ROWS).rev() {
            for step in 0..COLS {
                // There and back again, so that the next region is beside the last one.
                let column = if row % 2 == 1 { step } else { COLS - 1 - step };
                all.extend(
                    (0..LEVELS.len()).map(|level| Target::Region(row * COLS + column, level)),
                );
            }
        }
        all.extend((0..TOWARDS.len()).map(Target::Shear));
        all.extend([Target::Hold, Target::Fast]);
        all.extend(self.sensors.then_some(Target::More));
        all
    }

    /// First target that is neither met nor left out.
    fn next(&self) -> Option<Target> {
        let over = |target: &Target| self.left_out.contains(target) || self.is_met(*target);
        self.targets().into_iter().find(|target| !over(target))
    }

    fn is_met(&self, target: Target) -> bool {
        let times = |of: fn(&Press) -> bool| self.presses.iter().filter(|press| of(press)).count();
        match target {
            Target::Full => self.presses.len() > MISHAPS,
            Target::Region(region, level) => self.counts(region)[level] > 0,
            Target::Shear(eighth) => self.presses.iter().any(|press| press.towards == Some(eighth)),
            Target::Hold => times(|press| press.held) >= TIMES,
            Target::Fast => times(|press| press.fast) >= TIMES,
            Target::More => self.presses.len() >= PRESSES,
        }
    }

    /// Full strength: the largest peak without [`MISHAPS`].
    fn full(&self) -> f64 {
        let mut peaks: Vec<f64> = self.presses.iter().map(|press| press.peak).collect();
        peaks.sort_by(|a, b| b.total_cmp(a));
        peaks.get(MISHAPS.min(peaks.len().saturating_sub(1))).copied().unwrap_or(0.0)
    }

    /// Presses in a region by level: light, medium, hard.
    fn counts(&self, region: usize) -> [usize; 3] {
        let full = self.full();
        let mut counts = [0; 3];
        for press in self.presses.iter().filter(|press| press.region == region) {
            let level = LEVELS.iter().rposition(|least| press.peak >= least * full);
            level.into_iter().for_each(|level| counts[level] += 1);
        }
        counts
    }

    /// Whether nothing more is asked for.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.bias.is_some() && self.target.is_none()
    }

    /// Next step for the person who presses.
    #[must_use]
    pub fn step(&self) -> Step {
        match self.target {
            _ if self.bias.is_none() => Step::LetGo,
            Some(target) => Step::Press(self.words(target)),
            None => match self.lacking() {
                lacking if lacking.is_empty() => Step::Enough,
                lacking => Step::Ended(lacking.join(", ")),
            },
        }
    }

    /// Begins again without a touch, after a finger that restarted; the presses are kept.
    pub fn restart(&mut self) {
        self.taker = BiasTaker::new(self.frames);
        (self.bias, self.current, self.gate) = (None, None, GateState::default());
    }

    /// Targets that were left out because the presses did not meet them, in words.
    #[must_use]
    pub fn left_out(&self) -> Vec<String> {
        let open = self.left_out.iter().filter(|target| !self.is_met(**target));
        open.map(|target| self.words(*target)).collect()
    }
}
