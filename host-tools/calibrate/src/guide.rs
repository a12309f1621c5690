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

use std::f64::consts::FRAC_PI_4;
use std::fmt::{self, Display, Formatter, Write as _};

use taxel::condition::{Bias, BiasTaker, Levels, Signals};
use taxel::estimate::contact_point::arg_min;
use taxel::estimate::gate::{Gate, GateState};
use taxel::scan::{COLS, Codes, ROWS, TAXELS};
use taxel::units::Micros;

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
/// Names of the levels.
const HOW: [&str; 3] = ["lightly", "half as hard as the hardest", "as hard as the hardest"];
/// Least shear over normal signal that is a push sideways.
const SHEARED: f64 = 0.2;
/// Least strength, as a share of the press's own peak, at which its shear counts.
const FIRM: f64 = 0.5;
/// Least strength of a held press, as a share of its peak, and the time that it takes.
const HELD: (f64, u64) = (0.8, 500_000);
/// Longest time of a fast press from its beginning to nine tenths of its peak.
const FAST: (f64, u64) = (0.9, 100_000);
/// Presses that are to be held, and as many that are to be fast.
const TIMES: usize = 3;
/// Presses from which a fit finds the lag of a finger with force sensors.
const PRESSES: usize = 100;
/// Presses after which a target that none of them meets is left out.
const PATIENCE: usize = 8;

/// Directions of shear, an eighth of the circle each.
const TOWARDS: [&str; 8] = [
    "to the right",
    "up and to the right",
    "up",
    "up and to the left",
    "to the left",
    "down and to the left",
    "down",
    "down and to the right",
];
/// Arrows of the directions.
const ARROWS: [char; 8] = ['→', '↗', '↑', '↖', '←', '↙', '↓', '↘'];

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

impl Display for Step {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::LetGo => f.write_str("touch nothing for a second"),
            Self::Press(words) => f.write_str(words),
            Self::Enough => f.write_str("enough"),
            Self::Ended(lacking) => write!(f, "ended: {lacking} recorded"),
        }
    }
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

    /// Loads that the recording lacks, each as "no …".
    fn lacking(&self) -> Vec<String> {
        let open = || self.left_out.iter().filter(|target| !self.is_met(**target));
        let directions: Vec<usize> = open()
            .filter_map(
                |target| if let Target::Shear(eighth) = target { Some(*eighth) } else { None },
            )
            .collect();
        let mut regions: Vec<usize> = open()
            .filter_map(|target| if let Target::Region(k, _) = target { Some(*k) } else { None })
            .collect();
        regions.dedup();
        let (some, none): (Vec<usize>, Vec<usize>) =
            regions.into_iter().partition(|region| self.counts(*region) != [0; 3]);
        let names = |regions: &[usize]| -> String {
            let names = regions.iter().map(|k| format!("r{}c{}", k / COLS, k % COLS));
            names.collect::<Vec<_>>().join(" ")
        };
        let mut lacking = Vec::new();
        if !none.is_empty() {
            lacking.push(format!("no press in {}", names(&none)));
        }
        if !some.is_empty() {
            lacking.push(format!("not every strength in {}", names(&some)));
        }
        match directions.len() {
            0 => {}
            all if all == TOWARDS.len() => lacking.push("no shear".into()),
            _ => lacking.extend(directions.iter().map(|k| format!("no shear {}", TOWARDS[*k]))),
        }
        let timed = |target: Target, name: &str, of: fn(&Press) -> bool| {
            let found = self.presses.iter().filter(|press| of(press)).count();
            open().any(|other| *other == target).then(|| match found {
                0 => format!("no {name} press"),
                found => format!(
                    "no more than {found} {name} press{}",
                    if found == 1 { "" } else { "es" }
                ),
            })
        };
        lacking.extend(timed(Target::Hold, "held", |press| press.held));
        lacking.extend(timed(Target::Fast, "fast", |press| press.fast));
        lacking
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

    fn words(&self, target: Target) -> String {
        match target {
            Target::Full => format!(
                "press the middle {} times, as hard as it will ever be pressed",
                MISHAPS + 1
            ),
            Target::Region(region, level) => {
                format!(
                    "press {} (r{}c{}), {}",
                    whereabouts(region),
                    region / COLS,
                    region % COLS,
                    self.how(level)
                )
            }
            Target::Shear(eighth) => {
                format!("press firmly and push sideways {} until it slips", TOWARDS[eighth])
            }
            Target::Hold => "press and hold for half a second".into(),
            Target::Fast => "tap as fast as in use".into(),
            Target::More => format!(
                "press all over the pad, briefly and pushed any way, {PRESSES} times in all"
            ),
        }
    }

    /// Strength of a level: in newtons if they are known, else compared with the last press.
    fn how(&self, level: usize) -> String {
        let asked = ASKED[level] * self.full();
        if self.newtons {
            return format!("{}, with about {asked:.1} N", HOW[level]);
        }
        let last = self.presses.last().map_or(asked, |press| press.peak);
        let compared = match asked / last.max(f64::MIN_POSITIVE) {
            ratio if ratio > 3.0 => ", much harder than the last",
            ratio if ratio > 1.5 => ", about twice as hard as the last",
            ratio if ratio < 0.3 => ", much more lightly than the last",
            ratio if ratio < 0.7 => ", about half as hard as the last",
            _ => "",
        };
        format!("{}{compared}", HOW[level])
    }

    /// Map of the pad with what each region still lacks, and counts of the other targets.
    #[must_use]
    pub fn picture(&self) -> String {
        let asked = match self.target {
            Some(Target::Region(region, _)) => Some(region),
            _ => None,
        };
        let mut text = String::new();
        for row in (0..ROWS).rev() {
            let _ = write!(text, "  r{row}");
            for region in row * COLS..(row + 1) * COLS {
                let counts = self.counts(region);
                let marks = ['l', 'm', 'h'].into_iter().zip(counts);
                let marks: String = marks.map(|(mark, n)| if n > 0 { mark } else { '·' }).collect();
                let (open, close) = if asked == Some(region) { ('>', '<') } else { ('[', ']') };
                let _ = write!(text, " {open}{marks}{:3}{close}", counts.iter().sum::<usize>());
            }
            text.push('\n');
        }
        text += "       c0       c1       c2       c3\n";
        let pushed =
            |eighth| if self.is_met(Target::Shear(eighth)) { ARROWS[eighth] } else { '·' };
        let arrows: String = (0..TOWARDS.len()).map(pushed).collect();
        let times = |of: fn(&Press) -> bool| {
            self.presses.iter().filter(|press| of(press)).count().min(TIMES)
        };
        let _ = write!(
            text,
            "  sideways {arrows}, held {} of {TIMES}, fast {} of {TIMES}, presses {}{}",
            times(|press| press.held),
            times(|press| press.fast),
            self.presses.len(),
            if self.sensors { format!(" of {PRESSES}") } else { String::new() }
        );
        text
    }
}

impl Current {
    /// Whether the strength stays near the peak for half a second.
    fn is_held(&self) -> bool {
        let (share, time) = HELD;
        let firm =
            self.course.chunk_by(|a, b| (a.1 >= share * self.peak) == (b.1 >= share * self.peak));
        firm.filter(|run| run[0].1 >= share * self.peak)
            .any(|run| run[run.len() - 1].0.saturating_sub(run[0].0) >= time)
    }

    /// Whether the strength nearly reaches the peak at once.
    fn is_fast(&self) -> bool {
        let (share, time) = FAST;
        let reached = self.course.iter().find(|(_, strength)| *strength >= share * self.peak);
        reached.is_some_and(|(at, _)| at.saturating_sub(self.began) <= time)
    }
}

/// Changes of the taxels relative to their light at rest; negative where it came nearer.
fn changes(signals: &Signals, bias: &Bias) -> Option<[f32; TAXELS]> {
    let (mut changes, rest) = (signals.taxels?, bias.taxels?.level);
    changes.iter_mut().zip(rest).for_each(|(change, rest)| *change /= rest.max(f32::MIN_POSITIVE));
    Some(changes)
}

/// Strength of a frame, and its shear over the normal signal if that is known.
fn strength(
    signals: &Signals,
    changes: &[f32; TAXELS],
    known: Option<Known>,
) -> (f64, Option<[f64; 2]>) {
    if let Some(Known { force: [x, y, z], .. }) = known {
        return (z.max(0.0), (z > 0.0).then(|| [x / z, y / z]));
    }
    let faulty = signals.health.dead | signals.health.saturated;
    let sound = (0..TAXELS).filter(|k| faulty >> k & 1 == 0);
    let squares: f64 = sound.map(|k| f64::from(changes[k]).powi(2)).sum();
    let sum =
        |axis: usize| -> f64 { signals.bridges.iter().flatten().map(|u| f64::from(u[axis])).sum() };
    let [x, y, z] = [sum(0), sum(1), sum(2).abs()];
    ((squares / TAXELS as f64).sqrt(), (z > 0.0).then(|| [x / z, y / z]))
}

/// Lets the bias follow the levels of the unloaded finger, which drift as it warms.
fn follow(bias: &mut Bias, levels: &Levels) {
    const SHARE: f32 = 1e-3;
    let towards = |bias: &mut [f32], levels: &[f32]| {
        bias.iter_mut().zip(levels).for_each(|(bias, level)| *bias += SHARE * (level - *bias));
    };
    if let (Some(bias), Some(levels)) = (&mut bias.taxels, &levels.taxels) {
        towards(&mut bias.level, levels);
    }
    for (bias, levels) in bias.bridges.iter_mut().zip(&levels.bridges) {
        if let (Some(bias), Some(levels)) = (bias, levels) {
            towards(&mut bias.level, levels);
        }
    }
}

/// Place of a region in words, with y up and x to the right.
fn whereabouts(region: usize) -> String {
    let (row, column) = (region / COLS, region % COLS);
    let up = ["lower", "lower", "upper", "upper"][row];
    let side = ["left", "left", "right", "right"][column];
    let height = ["down", "down", "up", "up"][row];
    match ([0, ROWS - 1].contains(&row), [0, COLS - 1].contains(&column)) {
        (true, true) => format!("the {up} {side} corner"),
        (true, false) => format!("the {up} edge, a little to the {side}"),
        (false, true) => format!("the {side} edge, a little {height}"),
        (false, false) => format!("{up} {side} of the middle"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taxel::scan::{Midpoints, SENSORS, TAXEL_CENTRES, TaxelCodes};
    use taxel::units::{Code, FullScale};

    /// Finger whose codes follow its presses, at 200 frames a second.
    struct Person {
        guide: Guide,
        now: u64,
        sensors: bool,
        known: bool,
    }

    impl Person {
        fn new(sensors: bool, known: bool) -> Self {
            let mut person = Self { guide: Guide::new(200), now: 0, sensors, known };
            assert_eq!(person.guide.step(), Step::LetGo);
            person.press([0.0; 2], 0.0, [0.0; 2], [0, 200, 0]);
            person
        }

        /// Presses a place with a strength, sheared, for so many frames to rise, hold and fall.
        fn press(&mut self, place: [f64; 2], strength: f64, shear: [f64; 2], frames: [u64; 3]) {
            let [rise, hold, fall] = frames;
            for i in 0..rise + hold + fall + 10 {
                let share = match i {
                    i if i < rise => (i + 1) as f64 / rise as f64,
                    i if i < rise + hold => 1.0,
                    i => 1.0 - ((i - rise - hold + 1) as f64 / fall.max(1) as f64).min(1.0),
                };
                self.frame(place, share * strength, shear);
            }
        }

        fn frame(&mut self, place: [f64; 2], strength: f64, shear: [f64; 2]) {
            self.now += 5_000;
            // A step of noise, so that the bias has some.
            let noise = (self.now / 5_000 % 3) as f64;
            let code = |value: f64| Code((value + noise).clamp(0.0, 65_535.0) as u16);
            let mut lit = [[Code(0); COLS]; ROWS];
            for (k, [x, y]) in TAXEL_CENTRES.iter().enumerate() {
                let away = (place[0] - f64::from(x.0)).hypot(place[1] - f64::from(y.0));
                lit[k / COLS][k % COLS] =
                    code(20_000.0 + 10_000.0 * strength * (1.0 + (away / 2.5).powi(2)).powf(-1.5));
            }
            let [x, y] = shear.map(|shear| 2_000.0 * shear * strength);
            let z = 1_000.0 * strength;
            let bridge = Midpoints {
                a: code(32_000.0 - x / 2.0 + z / 2.0),
                b: code(32_000.0 + x / 2.0 + z / 2.0),
                c: code(32_000.0 + y / 2.0 - z / 2.0),
                d: code(32_000.0 - y / 2.0 - z / 2.0),
            };
            let codes = Codes {
                full_scale: FullScale::BITS_16,
                taxels: Some(TaxelCodes { lit, dark: [Code(3_000); COLS] }),
                bridges: [self.sensors.then_some(bridge); SENSORS],
                reference: None,
                temperature: None,
            };
            let force = [shear[0] * strength, shear[1] * strength, strength];
            let known = self.known.then_some(Known { force, place: Some(place) });
            self.guide.add(Micros(self.now), &codes, known);
        }

        /// Does what the guide asks for.
        fn obey(&mut self) {
            let Some(target) = self.guide.target else { return };
            let centre = |k: usize| TAXEL_CENTRES[k].map(|c| f64::from(c.0));
            match target {
                Target::Full => self.press([0.0; 2], 1.0, [0.0; 2], [30, 10, 10]),
                Target::Region(region, level) => {
                    self.press(centre(region), ASKED[level], [0.0; 2], [30, 10, 10]);
                }
                Target::Shear(eighth) => {
                    let (y, x) = (eighth as f64 * FRAC_PI_4).sin_cos();
                    self.press([0.0; 2], 0.8, [0.5 * x, 0.5 * y], [30, 10, 10]);
                }
                Target::Hold => self.press([0.0; 2], 0.8, [0.0; 2], [30, 120, 10]),
                Target::Fast => self.press([0.0; 2], 0.8, [0.0; 2], [4, 5, 5]),
                Target::More => self.press([1.0, 1.0], 0.5, [0.0; 2], [30, 10, 10]),
            }
        }

        /// Obeys until it is enough; returns the number of presses.
        fn finish(&mut self) -> usize {
            for _ in 0..300 {
                if matches!(self.guide.step(), Step::Enough) {
                    break;
                }
                self.obey();
            }
            assert_eq!(self.guide.step(), Step::Enough, "{}", self.guide.picture());
            self.guide.presses.len()
        }
    }

    #[test]
    fn obedient_person_covers_the_pad() {
        for (sensors, known) in [(true, false), (false, false), (true, true), (false, true)] {
            let mut person = Person::new(sensors, known);
            let presses = person.finish();
            // The hardest ones in the middle fill a region, too.
            let least = MISHAPS + 3 * TAXELS + TOWARDS.len() + 2 * TIMES;
            assert_eq!(presses, if sensors { PRESSES } else { least }, "{sensors} {known}");
            assert_eq!(person.guide.left_out(), Vec::<String>::new());
            let picture = person.guide.picture();
            assert_eq!(picture.matches("[lmh").count(), TAXELS, "{picture}");
            assert!(picture.contains("sideways →↗↑↖←↙↓↘, held 3 of 3, fast 3 of 3"), "{picture}");
        }
    }

    #[test]
    fn first_steps_are_told_in_words() {
        let mut person = Person::new(true, false);
        let mut said = vec![person.guide.step().to_string()];
        for _ in 0..6 {
            person.obey();
            said.push(person.guide.step().to_string());
        }
        said.dedup();
        assert_eq!(
            said,
            [
                "press the middle 3 times, as hard as it will ever be pressed",
                "press the upper left corner (r3c0), lightly, much more lightly than the last",
                "press the upper left corner (r3c0), half as hard as the hardest, about twice as hard as the last",
                "press the upper left corner (r3c0), as hard as the hardest, about twice as hard as the last",
                "press the upper edge, a little to the left (r3c1), lightly, much more lightly than the last",
            ]
        );
        let mut known = Person::new(true, true);
        (0..3).for_each(|_| known.obey());
        let asked = "press the upper left corner (r3c0), lightly, with about 0.2 N";
        assert_eq!(known.guide.step().to_string(), asked);
    }

    #[test]
    fn picture_shows_the_region_that_is_asked_for() {
        let mut person = Person::new(true, false);
        (0..4).for_each(|_| person.obey());
        let lines: Vec<String> = person.guide.picture().lines().map(str::to_owned).collect();
        assert_eq!(lines[0], "  r3 >l··  1< [···  0] [···  0] [···  0]");
        assert_eq!(lines[5], "  sideways ········, held 0 of 3, fast 0 of 3, presses 4 of 100");
    }

    #[test]
    fn presses_out_of_order_count() {
        let mut person = Person::new(true, false);
        (0..3).for_each(|_| person.obey());
        let last = TAXEL_CENTRES[TAXELS - 1].map(|c| f64::from(c.0));
        person.press(last, 0.5, [0.4, 0.0], [30, 10, 10]);
        assert_eq!(person.guide.counts(TAXELS - 1), [0, 1, 0]);
        assert!(person.guide.is_met(Target::Shear(0)));
    }

    #[test]
    fn harder_presses_ask_for_the_earlier_regions_again() {
        let mut person = Person::new(true, false);
        (0..6).for_each(|_| person.obey());
        assert_eq!(person.guide.counts(12), [1, 1, 1]);
        // One mishap changes nothing, but three hard presses are the new full strength.
        person.press([0.0; 2], 1.9, [0.0; 2], [30, 10, 10]);
        assert_eq!(person.guide.counts(12), [1, 1, 1]);
        (0..2).for_each(|_| person.press([0.0; 2], 1.9, [0.0; 2], [30, 10, 10]));
        assert_eq!(person.guide.counts(12), [2, 1, 0]);
        assert_eq!(person.guide.target, Some(Target::Region(12, 2)));
    }

    #[test]
    fn region_that_cannot_be_pressed_is_left_out() {
        let mut person = Person::new(true, false);
        (0..3).for_each(|_| person.obey());
        (0..3 * PATIENCE).for_each(|_| person.press([0.0; 2], 0.5, [0.0; 2], [30, 10, 10]));
        let left_out = person.guide.left_out();
        assert_eq!(left_out.len(), 3, "{left_out:?}");
        assert!(left_out[0].starts_with("press the upper left corner (r3c0), lightly"));
        let asked = person.guide.step().to_string();
        assert!(asked.contains("upper edge, a little to the left (r3c1), lightly"), "{asked}");
        // It is asked for once more when there is nothing else.
        for _ in 0..200 {
            match person.guide.target {
                Some(Target::Region(12, _)) => person.press([0.0; 2], 0.5, [0.0; 2], [30, 10, 10]),
                _ => person.obey(),
            }
        }
        let ended = Step::Ended("no press in r3c0".into());
        assert_eq!((person.guide.step(), person.guide.left_out().len()), (ended, 3));
        assert_eq!(person.guide.presses.len(), PRESSES + 3 * PATIENCE);
    }

    #[test]
    fn recording_without_shear_and_held_presses_is_not_enough() {
        let mut person = Person::new(true, false);
        for _ in 0..300 {
            match person.guide.target {
                None => break,
                Some(Target::Shear(_) | Target::Hold) => {
                    person.press([0.0; 2], 0.8, [0.0; 2], [30, 10, 10]);
                }
                Some(_) => person.obey(),
            }
        }
        let told = "ended: no shear, no held press recorded";
        assert_eq!(person.guide.step().to_string(), told);
    }

    #[test]
    fn restarted_finger_begins_again_without_a_touch() {
        let mut person = Person::new(true, false);
        (0..3).for_each(|_| person.obey());
        // It restarts in a press.
        (0..20).for_each(|_| person.frame([0.0; 2], 1.0, [0.0; 2]));
        person.guide.restart();
        person.now = 0;
        assert_eq!(person.guide.step(), Step::LetGo);
        person.press([0.0; 2], 0.0, [0.0; 2], [0, 400, 0]);
        assert_eq!(person.guide.presses.len(), 3);
        assert!(matches!(person.guide.step(), Step::Press(_)));
    }

    #[test]
    fn force_that_comes_late_does_not_mix_with_relative_strengths() {
        let mut person = Person::new(true, false);
        (0..3).for_each(|_| person.obey());
        person.known = true;
        person.press([0.0; 2], 1.0, [0.0; 2], [30, 10, 10]);
        let peaks: Vec<f64> = person.guide.presses.iter().map(|press| press.peak).collect();
        assert!((peaks[3] / peaks[0] - 1.0).abs() < 0.1, "{peaks:?}");
    }

    #[test]
    fn touched_finger_is_asked_to_be_let_go() {
        let mut person = Person { guide: Guide::new(200), now: 0, sensors: true, known: false };
        person.press([0.0; 2], 1.0, [0.0; 2], [40, 20, 40]);
        assert_eq!(person.guide.step(), Step::LetGo);
        person.press([0.0; 2], 0.0, [0.0; 2], [0, 400, 0]);
        assert!(matches!(person.guide.step(), Step::Press(_)));
        // A contact that does not end is a zero that has moved.
        person.press([0.0; 2], 0.1, [0.0; 2], [10, 4_100, 0]);
        assert_eq!(person.guide.presses.len(), 0, "{:?}", person.guide.presses);
    }
}
