//! Detection of channels that jump, rest or are noisy alone: floating, stuck or swapped ones, or
//! those with a wrong bit.
//!
//! A touch moves neighbouring taxels together, light moves all readings, and a force moves the
//! midpoints of a bridge against each other, so that their sum rests. A reading that changes far
//! more than the others of its family is therefore no touch, nor are two that change places, nor is
//! a row or a column that changes far more than the other three, nor are two of these that change
//! places. A dark reading rests alone if it is stuck. Noise is told by [`RaggedWatch`].
//!
//! Limits: a jump of less than some thirty times the noise is not found; nor is one of midpoints
//! that change places within their sensor. The matrix is not judged while light clips a taxel, nor
//! are sensors unless all four are sound. A single wrong code withholds for some seventy scans what
//! depends on it.

use super::levels::COLUMN;
use super::ragged::{RaggedWatch, largest};
use super::stuck::is_loud;
use super::{Bias, Signals};
use crate::scan::{COLS, Codes, Midpoints, ROWS, SENSORS, TAXELS, TaxelCodes};
use crate::units::Code;

/// Factor on the change of the second lit reading, or of the third if two change places.
///
/// A touch above a corner of the matrix moves its taxel eight times as far as the next one, and two
/// touches move two taxels.
const OTHERS: i32 = 12;
/// Factor on the change of the third dark reading, for light from one side.
const OTHER_DARK: i32 = 6;
/// Factor on the change of the third sum, for a supply that ripples.
const OTHER_SUMS: i32 = 2;
/// Factor on the least jump, for two rows or columns that change places.
const LEAST_LINES: i32 = 16;
/// Comparisons, one every other scan, after which a dark reading that rests is stuck, and how many
/// of the four must move on average.
const DARK_RESTS: u8 = 18;
const DARK_MOVE: i32 = 5 * LESSONS / 2;
/// Least jump of the matrix: of the usual change of the third of four readings, which is half a
/// standard deviation in noise. A jump of dark readings, of which there are few, is twice as much.
const LEAST: Scale = Scale { times: 13, rounding: 12 };
/// Least jump of a sum: of its own usual change, which is four fifths of a standard deviation.
const LEAST_SUM: Scale = Scale { times: 7, rounding: 8 };
/// Lessons before a family is judged.
const TAUGHT: u32 = 32;
/// Scans of which a turn teaches later.
const LATER: u8 = 32;
/// Lessons that a mean remembers.
const LESSONS: i32 = 16;
/// Factor on the change of the third sum, up to which a sum teaches its own noise.
const LOUDEST: i32 = 8;
/// Scans in a turn: in the first the matrix is compared, in the middle one the sums.
const TURN: u8 = 4;
/// Scans without a jump after which a reading may be sound again.
const QUIET: u8 = 64;
/// Factor on the noise, squared, that all signals together keep within if nothing touches the
/// finger and no reading is off.
const REST: f32 = 9.0;

/// A number for each reading: four rows of lit ones, the dark ones, and the sums of midpoints.
type Readings = [[i32; COLS]; ROWS + 2];

/// State of the detector.
#[derive(Clone, Debug, Default)]
pub struct JumpWatch {
    /// Scans, from 0 again after 255.
    scans: u8,
    /// Scans until a reading may be sound again.
    left: u8,
    /// Jumps, from 0 again after 255.
    jumps: u8,
    /// Whether no taxel was clipped in the last comparison.
    unclipped: bool,
    /// Whether all four sensors were sound in the last comparison.
    complete: bool,
    least: Leasts,
    /// Readings in their last comparison, and their changes then. Those of lit ones are without
    /// that of the light from elsewhere.
    matrix: TaxelCodes,
    sums: [i32; SENSORS],
    changes: Readings,
    ragged: RaggedWatch,
    /// Dark readings in their last comparison, comparisons in which each has rested, and the usual
    /// number of those that move, times [`LESSONS`].
    dark: [Code; COLS],
    dark_rests: [u8; COLS],
    dark_moves: i32,
    /// Bit i: reading i is in doubt.
    doubted: u32,
    /// How far its jumps have taken each reading in doubt, in codes. 0: they have cancelled each
    /// other, but for as much as the reading may move in a touch meanwhile.
    away: Readings,
}

impl JumpWatch {
    /// Processes one scan and adds the channels in doubt to its health. They are sound again if
    /// none has jumped for a while and their own jumps have cancelled each other, or if the finger
    /// reads its bias while nothing has `touched` it.
    pub fn update(&mut self, codes: &Codes, signals: &mut Signals, bias: &Bias, touched: bool) {
        let scan = self.scans;
        self.scans = scan.wrapping_add(1);
        let noisy = self.ragged.update(codes, &signals.health, scan, &self.least);
        if noisy != 0 {
            self.hold(noisy);
        }
        match scan % TURN {
            0 => {
                if let Some(taxels) = &codes.taxels {
                    self.watch_matrix(taxels, signals.health.saturated == 0, scan);
                }
            }
            2 => self.watch_sums(codes, signals.health.bridge_faults == 0, scan),
            _ => {
                if signals.health.saturated == 0
                    && let Some(taxels) = &codes.taxels
                {
                    let stuck = self.watch_dark(&taxels.dark, scan);
                    // Codes of little noise may rest as long.
                    if stuck != 0
                        && let Some(at_rest) = &bias.taxels
                        && is_loud(at_rest.noise, codes.full_scale)
                    {
                        self.hold(stuck);
                    }
                }
            }
        }
        if self.doubted != 0 {
            self.mark_doubted(signals, bias, touched);
        }
    }

    /// Tells that scans have been lost before the next one.
    pub fn interrupt(&mut self) {
        self.ragged.interrupt();
    }

    /// Returns a number that differs after a jump.
    pub fn jumps(&self) -> u8 {
        self.jumps
    }

    /// A clipped reading does not move with the others, neither now nor when it comes back.
    fn watch_matrix(&mut self, taxels: &TaxelCodes, unclipped: bool, scan: u8) {
        let moved = compare(taxels, &mut self.matrix, &mut self.changes, self.least.matrix.codes);
        if !(core::mem::replace(&mut self.unclipped, unclipped) && unclipped) {
            return;
        }
        if moved && self.least.matrix.lessons >= TAUGHT {
            self.judge_matrix();
        }
        if self.teaches(self.least.matrix.lessons, scan)
            && let Some(row) = self.changes.get(usize::from(scan / LATER) % ROWS)
        {
            let [first, _, third] = largest(row);
            self.least.matrix.learn(first, third, &LEAST);
        }
    }

    /// With fewer sensors a ripple of the supply is no different from a jump, and the return of one
    /// is none.
    fn watch_sums(&mut self, codes: &Codes, sound: bool, scan: u8) {
        let (mut complete, mut signs) = (sound, 0);
        let [.., changes] = &mut self.changes;
        let lasts = self.sums.iter_mut().zip(&self.least.sums);
        for ((change, (last, least)), midpoints) in
            changes.iter_mut().zip(lasts).zip(&codes.bridges)
        {
            complete &= midpoints.is_some();
            let now = midpoints.as_ref().map_or(0, sum);
            *change = now - core::mem::replace(last, now);
            signs |= outside(*change, least.codes);
        }
        if !(core::mem::replace(&mut self.complete, complete) && complete) {
            return;
        }
        let [Least { lessons, .. }, ..] = self.least.sums;
        let teaches = self.teaches(lessons, scan);
        if signs < 0 || teaches {
            self.judge_sums(teaches);
        }
    }

    /// Returns whether this turn of the scans teaches what is usual.
    fn teaches(&self, lessons: u32, scan: u8) -> bool {
        (lessons < TAUGHT || scan % LATER < TURN) && self.doubted == 0
    }

    /// Returns the dark readings that rest while most of them move, a bit each as in doubt. One at 0
    /// is at a rail.
    #[inline(never)]
    fn watch_dark(&mut self, dark: &[Code; COLS], scan: u8) -> u32 {
        let (mut moving, mut stuck, mut changes) = (0, 0, [0; COLS]);
        let readings = dark.iter().zip(&mut self.dark).zip(&mut self.dark_rests);
        for (i, (((now, last), rests), change)) in readings.zip(&mut changes).enumerate() {
            *change = i32::from(now.0) - i32::from(last.0);
            moving += i32::from(*change != 0);
            if *change == 0 && now.0 != 0 {
                *rests = rests.saturating_add(1);
                stuck |= u32::from(*rests >= DARK_RESTS) << (TAXELS + i);
            } else {
                (*rests, *last) = (0, *now);
            }
        }
        if self.teaches(self.least.dark.lessons, scan) {
            // Light from elsewhere changes all of them.
            let ambient = mean(&changes);
            let [first, _, third] = largest(&changes.map(|change| change - ambient));
            self.least.dark.learn(first, third, &LEAST);
        }
        self.dark_moves += moving - (self.dark_moves + LESSONS / 2) / LESSONS;
        if self.dark_moves >= DARK_MOVE { stuck } else { 0 }
    }

    #[cold]
    #[inline(never)]
    fn judge_matrix(&mut self) {
        let [lit @ .., dark, _] = &self.changes;
        let (lit, least) = (lit.as_flattened(), self.least.matrix.codes);
        let [_, _, third] = largest(dark);
        let dark_limit = OTHER_DARK * third + 2 * least;
        let dark = beyond(dark, dark_limit);
        let sizes @ [_, _, third] = largest(lit);
        if let Some(limit) = jumps_alone(lit, sizes, least, least) {
            self.doubt(beyond(lit, limit), limit);
        } else if third > least {
            self.judge_lines();
        }
        if dark != 0 {
            self.doubt(dark << TAXELS, dark_limit);
        }
    }

    /// Judges rows and columns like single taxels: the light of a row's LEDs, the gain of a column.
    fn judge_lines(&mut self) {
        let (mut rows, mut columns) = ([0; ROWS], [0; COLS]);
        for (row, of_row) in self.changes.iter().zip(&mut rows) {
            for (change, of_column) in row.iter().zip(&mut columns) {
                *of_row += change;
                *of_column += change;
            }
        }
        self.judge_line(&rows, 0b1111, COLS);
        self.judge_line(&columns, COLUMN.into(), 1);
    }

    /// Doubts the lines that change alone; the taxels of the first one, and the `step` to the next.
    #[inline(never)]
    fn judge_line(&mut self, sums: &[i32; 4], line: u32, step: usize) {
        let least = self.least.matrix.codes;
        // The noise of four readings is twice that of one.
        let limit = jumps_alone(sums, largest(sums), 2 * least, LEAST_LINES * least);
        if let Some(limit) = limit {
            let places = beyond(sums, limit);
            let taxels = (0..4).filter(|place| places >> place & 1 == 1);
            self.doubt(taxels.fold(0, |taxels, place| taxels | line << (step * place)), limit / 4);
        }
    }

    #[cold]
    #[inline(never)]
    fn judge_sums(&mut self, teaches: bool) {
        let [.., sums] = self.changes;
        let [first, _, third] = largest(&sums);
        for (i, change) in sums.iter().map(|change| change.abs()).enumerate() {
            let Some(least) = self.least.sums.get_mut(i) else { break };
            let limit = OTHER_SUMS * third + least.codes;
            if teaches {
                least.learn(first, change.min(LOUDEST * third), &LEAST_SUM);
            }
            if change > limit && least.lessons > TAUGHT {
                self.doubt(1 << (TAXELS + COLS + i), limit);
            }
        }
    }

    /// Doubts readings, a bit each, until nothing has been seen of a fault for [`QUIET`] scans.
    #[inline(never)]
    fn hold(&mut self, faulty: u32) {
        self.left = QUIET;
        self.doubted |= faulty;
    }

    /// Doubts the readings that `jumped`, a bit each, by more than the limit.
    #[inline(never)]
    fn doubt(&mut self, jumped: u32, limit: i32) {
        self.jumps = self.jumps.wrapping_add(1);
        self.hold(jumped);
        let changes = self.changes.as_flattened().iter();
        for (i, (change, away)) in changes.zip(self.away.as_flattened_mut()).enumerate() {
            if jumped >> i & 1 == 1 {
                *away = away.wrapping_add(*change);
                if away.unsigned_abs() <= limit as u32 {
                    *away = 0;
                }
            }
        }
    }

    /// Adds the channels in doubt, less those that are sound again.
    #[cold]
    #[inline(never)]
    fn mark_doubted(&mut self, signals: &mut Signals, bias: &Bias, touched: bool) {
        if self.left > 0 {
            self.left -= 1;
        } else {
            let rests = !touched && !bias.exceeded(signals, REST);
            for (i, away) in self.away.as_flattened_mut().iter_mut().enumerate() {
                if rests || *away == 0 {
                    *away = 0;
                    self.doubted &= !(1 << i);
                }
            }
        }
        // A dark reading is part of its column's signals.
        let columns = (self.doubted >> TAXELS) as u16 & 0xf;
        signals.health.dead |= self.doubted as u16 | (columns * COLUMN);
        signals.health.bridge_faults |= (self.doubted >> (TAXELS + COLS)) as u8;
    }
}

/// Least jump as a multiple of the usual change.
struct Scale {
    times: i32,
    /// Codes by which rounding may change one reading before it changes the others.
    rounding: i32,
}

/// Least jumps of lit readings, of dark ones, and of sums of midpoints.
#[derive(Clone, Debug, Default)]
pub(super) struct Leasts {
    pub matrix: Least,
    pub dark: Least,
    pub sums: [Least; SENSORS],
}

/// Least change that is a jump, in codes. It is learned, because a scan of fewer samples a reading
/// has more noise than the record knows.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Least {
    /// Usual change, times [`LESSONS`].
    usual: i32,
    codes: i32,
    lessons: u32,
}

impl Least {
    /// A least jump that has been learned.
    #[cfg(test)]
    pub fn of(codes: i32) -> Self {
        Self { usual: 0, codes, lessons: TAUGHT }
    }

    /// Returns the least jump; the largest number until enough has been learned.
    pub fn taught(&self) -> i32 {
        if self.lessons < TAUGHT { i32::MAX } else { self.codes }
    }

    /// Learns a change; nothing if the `largest` of its family is 0, as in a scan that repeats.
    #[inline(never)]
    fn learn(&mut self, largest: i32, change: i32, Scale { times, rounding }: &Scale) {
        if largest > 0 {
            self.usual += change - self.usual / LESSONS;
            self.codes = times * self.usual / LESSONS + rounding;
            self.lessons = self.lessons.saturating_add(1);
        }
    }
}

/// Sets the changes of the readings of the matrix from the `last` ones, which become those of
/// `now`; returns whether a change is more than the `least`.
#[inline(never)]
fn compare(now: &TaxelCodes, last: &mut TaxelCodes, changes: &mut Readings, least: i32) -> bool {
    let [lit @ .., dark, _] = changes;
    let mut signs = 0;
    set(dark, &now.dark, &mut last.dark, 0, least, &mut signs);
    let ambient = mean(dark);
    let (now, last) = (now.lit.as_flattened(), last.lit.as_flattened_mut());
    set(lit.as_flattened_mut(), now, last, ambient, least, &mut signs);
    signs < 0
}

/// Sets changes beyond the `ambient` one. The `signs` are negative if one is more than the `least`.
#[inline(always)]
fn set(
    changes: &mut [i32],
    now: &[Code],
    last: &mut [Code],
    ambient: i32,
    least: i32,
    signs: &mut i32,
) {
    for ((change, now), last) in changes.iter_mut().zip(now).zip(last) {
        let before = core::mem::replace(last, *now);
        *change = i32::from(now.0) - i32::from(before.0) - ambient;
        *signs |= outside(*change, least);
    }
}

/// Returns the mean change of dark readings, that of light from elsewhere.
#[inline(always)]
fn mean(dark: &[i32; COLS]) -> i32 {
    dark.iter().sum::<i32>() / COLS as i32
}

/// Returns a negative number if the change is more than the `least`, up or down. OR-ed signs take
/// half the time of comparisons.
#[inline(always)]
fn outside(change: i32, least: i32) -> i32 {
    (least - change) | (least + change)
}

/// Returns the limit that a single change is beyond, or two of readings that change places; from
/// the three largest sizes and the least jumps of one and of two.
fn jumps_alone(changes: &[i32], sizes: [i32; 3], one: i32, two: i32) -> Option<i32> {
    let [first, second, third] = sizes;
    let limit = OTHERS * second + one;
    if first > limit {
        return Some(limit);
    }
    let limit = OTHERS * third + two;
    // Two that change places move against each other, those under a touch do not.
    let up = changes.iter().filter(|change| **change > limit).count();
    (second > limit && up == 1).then_some(limit)
}

/// Returns the readings that changed by more than the limit, a bit each.
#[inline(never)]
fn beyond(changes: &[i32], limit: i32) -> u32 {
    let bits = changes.iter().enumerate();
    bits.fold(0, |bits, (i, change)| bits | u32::from(change.abs() > limit) << i)
}

/// Returns the sum of a sensor's midpoints, which no force changes.
fn sum(midpoints: &Midpoints) -> i32 {
    midpoints.codes().iter().map(|code| i32::from(code.0)).sum()
}

#[cfg(test)]
mod tests;
