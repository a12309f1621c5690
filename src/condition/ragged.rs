//! Detection of readings that are noisy alone, told from movement by four scans in a row.
//!
//! The third difference of a reading's codes a, b, c and d in four scans is t = d − 3c + 3b − a.
//! White noise makes t² twice as large as 5·(d − a)²; a step makes it smaller wherever it lies, and
//! so does a wave of four scans or more. Each reading sums what t² has more, and is noisy if its sum
//! is far larger than those of the others of its kind. A slip that jumps and creeps back is told by
//! its one large change, and light or a supply that flickers by its changes of all.
//!
//! Limits: not found are noise below some four times the usual, that of more than two readings of a
//! kind or of one sensor, and that which lasts from scan to scan. Taken for noise are a tap above a
//! corner that is over within three scans, scans of quick touches at uneven times, and a stick-slip
//! of some fifteen scans or less that moves a single midpoint.

use core::ops::Range;

use super::Health;
use super::jump::{Least, Leasts};
use crate::scan::{COLS, Codes, ROWS, SENSORS, TAXELS};
use crate::units::{Code, FullScale};

/// Codes of four readings that are judged together: a row, the dark readings, or a sensor.
type Group = [Code; COLS];
const GROUPS: usize = DARK + 1 + SENSORS;
const DARK: usize = ROWS;
/// Scans in a row of which noise is told. The taxels of so many are kept while the sensors are
/// judged; then the midpoints are kept while the dark readings and the rows are judged.
const IN_A_ROW: usize = 4;
/// Turns that a sum remembers, as a power of two.
const MEMORY: u32 = 3;
/// Factor on the sum of the third reading of a kind, or of the second one of a sensor.
const OTHERS: i32 = 5;
/// Factor on the sum of the third dark reading: light from one side changes one six times as far.
const OTHER_DARK: i32 = 36;
/// Steps of the coarsest converter, whose codes may have been made larger, and what a sum exceeds at
/// least, in squares of a step: readings that rest but for single steps are not noisy.
const COARSEST: u16 = 4095;
const STEPS: i32 = 24;
/// Largest difference that counts, in codes.
const LARGEST: i32 = (1 << 13) - 1;
/// Factor on the square of the least jump, which a noisy reading's sum exceeds, because a movement
/// leaves little of the others' sums.
const LEAST: i32 = 9;
/// Factor on the second largest change from scan to scan, beyond which the largest is a slip: it
/// changes a reading once, and between slips drag changes it back.
const SLIP: i32 = 4;

/// State of the detector.
#[derive(Clone, Debug, Default)]
pub(super) struct RaggedWatch {
    scans: [[Group; GROUPS]; IN_A_ROW],
    /// Whether all taxels, or all sensors, were sound in the scans that are kept.
    matrix_sound: bool,
    bridges_sound: bool,
    /// Each reading's sum, in codes squared.
    sums: [[i32; COLS]; GROUPS],
}

impl RaggedWatch {
    /// Drops the scans that are kept, because the next does not follow at once.
    pub fn interrupt(&mut self) {
        (self.matrix_sound, self.bridges_sound) = (false, false);
    }

    /// Keeps a part of the scan and judges another. Returns the readings that are noisy alone, a bit
    /// each: lit ones, dark ones, sensors.
    pub fn update(&mut self, codes: &Codes, health: &Health, scan: u8, leasts: &Leasts) -> u32 {
        let turn = usize::from(scan) % (2 * IN_A_ROW);
        let at = turn % IN_A_ROW;
        let Some(kept) = self.scans.get_mut(at) else { return 0 };
        let [rows @ .., dark, _, _, _, _] = kept;
        // In the first of four scans the matrix is compared, which takes long.
        if turn == at {
            self.matrix_sound = (self.matrix_sound || at == 0) && health.saturated == 0;
            match &codes.taxels {
                Some(taxels) => (*rows, *dark) = (taxels.lit, taxels.dark),
                None => self.matrix_sound = false,
            }
            if !self.bridges_sound {
                return 0;
            }
            let mut judge = |sensor| {
                // The noise of a sum is twice that of one reading; but one that is louder than those
                // of the other sensors has only three to be compared with.
                let least = leasts.sums.get(sensor).map_or(i32::MAX, Least::taught) / 8 * 5;
                self.judge(DARK + 1 + sensor, least, codes.full_scale)
            };
            return match at {
                0 => 0,
                1 | 2 => judge(at - 1),
                _ => judge(2) | judge(3),
            };
        }
        self.bridges_sound = (self.bridges_sound || at == 0) && health.bridge_faults == 0;
        for (kept, sensor) in kept.iter_mut().skip(DARK + 1).zip(&codes.bridges) {
            match sensor {
                Some(midpoints) => *kept = midpoints.codes(),
                None => self.bridges_sound = false,
            }
        }
        if !self.matrix_sound {
            return 0;
        }
        let mut judge = |group, least: &Least| self.judge(group, least.taught(), codes.full_scale);
        match at {
            0 => judge(DARK, &leasts.dark),
            1 | 2 => judge(at - 1, &leasts.matrix),
            _ => judge(2, &leasts.matrix) | judge(3, &leasts.matrix),
        }
    }

    /// Adds the noise of a group, whose least jump is given; returns its readings that are noisy
    /// alone.
    #[inline(never)]
    fn judge(&mut self, group: usize, least: i32, full_scale: FullScale) -> u32 {
        let scans = self.scans.each_ref().map(|groups| groups.get(group));
        let (Some(sums), [Some(a), Some(b), Some(c), Some(d)]) = (self.sums.get_mut(group), scans)
        else {
            return 0;
        };
        let (step, least) = (i32::from(full_scale.top().0 / COARSEST), least.min(LARGEST));
        let floor = (LEAST * least * least).max(STEPS * step * step);
        let mut signs = 0;
        for ((((sum, a), b), c), d) in sums.iter_mut().zip(a).zip(b).zip(c).zip(d) {
            *sum = (*sum - (*sum >> MEMORY) + noise([*a, *b, *c, *d])).max(0);
            signs |= floor - *sum;
        }
        if signs < 0 { self.single_out(group, floor) } else { 0 }
    }

    /// Returns the reading of a group with the largest sum, as a bit, if its sum is far larger than
    /// those of its kind, and its codes now change far more than others'.
    #[cold]
    #[inline(never)]
    fn single_out(&mut self, group: usize, floor: i32) -> u32 {
        let others = if group == DARK { OTHER_DARK } else { OTHERS };
        let Some(sums) = self.sums.get(group) else { return 0 };
        let largest = sums.iter().enumerate().max_by_key(|(_, sum)| **sum);
        let Some((i, largest)) = largest else { return 0 };
        let large = largest / others;
        let count = |sums: &[i32]| sums.iter().filter(|sum| **sum >= large).count();
        let [lit @ .., dark, _, _, _, _] = &self.sums;
        // But for itself and one that may be noisy too, which is no other midpoint of its sensor.
        let alone = match group {
            DARK => count(dark) <= 2,
            ..DARK => count(lit.as_flattened()) <= 2,
            _ => {
                let sensors = self.sums.as_flattened().get(TAXELS + COLS..).unwrap_or_default();
                count(sums) == 1 && count(sensors) <= 2
            }
        };
        if !alone {
            return 0;
        }
        let noisy = self.is_alone(group, i, others);
        if let Some(sum) = self.sums.get_mut(group).and_then(|sums| sums.get_mut(i)) {
            *sum = if noisy { 0 } else { floor / 2 };
        }
        match group.checked_sub(DARK + 1) {
            Some(sensor) => u32::from(noisy) << (TAXELS + COLS + sensor),
            None => u32::from(noisy) << (COLS * group + i),
        }
    }

    /// Returns whether a reading changes far more than all others of its kind in the scans that are
    /// kept, but for one that may be noisy too, and than the dark reading of its column; and not as
    /// a slip does. A force that shakes changes several readings at once; their sums may be older.
    #[inline(never)]
    fn is_alone(&self, group: usize, i: usize, others: i32) -> bool {
        let far = self.squared(group, i) / others;
        let kind = match group {
            ..DARK => 0..DARK,
            DARK => DARK..DARK + 1,
            _ => DARK + 1..GROUPS,
        };
        // The whole kind comes last, because it takes longest.
        !slips(self.codes(group, i))
            && (group >= DARK || self.squared(DARK, i) < far)
            && self.count(group..group + 1, far) <= if group > DARK { 1 } else { 2 }
            && self.count(kind, far) <= 2
    }

    /// Number of readings of the groups whose squared third difference is at least `far`.
    fn count(&self, groups: Range<usize>, far: i32) -> usize {
        let readings = groups.start * COLS..groups.end * COLS;
        readings.filter(|at| self.squared(at / COLS, at % COLS) >= far).count()
    }

    /// Square of a reading's third difference in the scans that are kept.
    fn squared(&self, group: usize, i: usize) -> i32 {
        let (t, _) = difference(self.codes(group, i));
        t * t
    }

    /// Codes of a reading in the scans that are kept.
    #[inline(never)]
    fn codes(&self, group: usize, i: usize) -> [Code; IN_A_ROW] {
        let code = |scan: &[Group; GROUPS]| scan.get(group).and_then(|group| group.get(i)).copied();
        self.scans.each_ref().map(|scan| code(scan).unwrap_or_default())
    }
}

/// Returns what noise makes larger than movement, in codes squared.
#[inline(always)]
fn noise(codes: [Code; IN_A_ROW]) -> i32 {
    let (third, change) = difference(codes);
    third * third - 5 * change * change
}

/// Returns the third difference of the codes, and the change from the first to the last.
#[inline(always)]
fn difference(codes: [Code; IN_A_ROW]) -> (i32, i32) {
    let [a, b, c, d] = codes.map(|code| i32::from(code.0));
    let limited = |codes: i32| codes.clamp(-LARGEST - 1, LARGEST);
    (limited(d - a - 3 * (c - b)), limited(d - a))
}

/// Returns whether a reading slips: one change is far larger than the other two.
fn slips(codes: [Code; IN_A_ROW]) -> bool {
    let [a, b, c, d] = codes.map(|code| i32::from(code.0));
    let [one, two, three] = [b - a, c - b, d - c].map(i32::abs);
    let second = one.min(two).max(one.max(two).min(three));
    one.max(two).max(three) > SLIP * second
}

/// Returns the sizes of the three largest numbers.
#[inline(never)]
pub(super) fn largest(numbers: &[i32]) -> [i32; 3] {
    let [mut first, mut second, mut third] = [0; 3];
    for number in numbers {
        let size = number.abs();
        if size > third {
            third = size.min(second);
            second = second.max(size.min(first));
            first = first.max(size);
        }
    }
    [first, second, third]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::TaxelCodes;

    fn noise_of(codes: [f64; IN_A_ROW]) -> i32 {
        noise(codes.map(|code| Code(code as u16)))
    }

    #[test]
    fn waves_of_four_scans_or_more_are_no_noise() {
        for scans in [4.0, 4.5, 5.0, 7.0, 12.0, 50.0, 1000.0] {
            for phase in 0..64 {
                let at = |scan: f64| {
                    let turns = scan / scans + f64::from(phase) / 64.0;
                    30_000.0 + 2_000.0 * (core::f64::consts::TAU * turns).sin()
                };
                // Rounding to codes takes or adds a few hundred.
                assert!(noise_of([0.0, 1.0, 2.0, 3.0].map(at)) < 30_000, "{scans}, {phase}");
            }
        }
        let faster = [0.0, 2_000.0, 0.0, 2_000.0].map(|by| 30_000.0 + by);
        assert!(noise_of(faster) > 10_000_000);
    }

    #[test]
    fn steps_are_no_noise() {
        for step in [-30_000.0, -500.0, 1.0, 500.0, 30_000.0] {
            for from in 1..IN_A_ROW {
                let at = |scan| if scan < from { 32_000.0 } else { 32_000.0 + step };
                assert!(noise_of([0, 1, 2, 3].map(at)) < 0, "{step} from {from}");
            }
        }
    }

    #[test]
    fn extreme_codes_stay_in_range() {
        let taxels = TaxelCodes { lit: [[Code(9_000); COLS]; ROWS], dark: [Code(900); COLS] };
        let least = Least::of(2_000);
        let leasts = Leasts { matrix: least, dark: least, sums: [least; SENSORS] };
        for of_all in [false, true] {
            let mut watch = RaggedWatch::default();
            for scan in 0..=u8::MAX {
                let high = Code(if scan % 4 == 1 { u16::MAX } else { 0 });
                let mut taxels = taxels;
                if of_all {
                    taxels.lit = [[high; COLS]; ROWS];
                }
                taxels.lit[2][1] = high;
                let codes = Codes {
                    full_scale: FullScale::BITS_16,
                    taxels: Some(taxels),
                    bridges: [None; SENSORS],
                    reference: None,
                    temperature: None,
                };
                let noisy = watch.update(&codes, &Health::SOUND, scan, &leasts);
                let expected = if !of_all && scan % 8 == 7 { 1 << 9 } else { 0 };
                assert_eq!(noisy, expected, "scan {scan}");
            }
        }
    }
}
