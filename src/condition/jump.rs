//! Detection of channels that jump alone: noisy, floating or swapped ones, or those with a wrong
//! bit.
//!
//! A touch moves neighbouring taxels together, light moves all readings, and a force moves the
//! midpoints of a bridge against each other, so that their sum rests. A reading that changes far
//! more than the others of its family is therefore no touch, nor are two that change places, nor is
//! a row or a column that changes far more than the other three.
//!
//! Limits: a jump of less than some thirty times the noise is not found; nor is one of midpoints
//! that change places within their sensor. The matrix is not judged while light clips a taxel, nor
//! are sensors unless all four are sound. A single wrong code withholds for some seventy scans what
//! depends on it.

use super::levels::COLUMN;
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
/// Least jump of the matrix: of the usual change of the third of four readings, which is half a
/// standard deviation in noise. Dark readings, of which there are few, need twice as much.
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
    least: Least,
    least_sums: [Least; SENSORS],
    /// Readings in their last comparison, and their changes then. Those of lit ones are without
    /// that of the light from elsewhere.
    matrix: TaxelCodes,
    sums: [i32; SENSORS],
    changes: Readings,
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
        match scan % TURN {
            0 => {
                if let Some(taxels) = &codes.taxels {
                    self.watch_matrix(taxels, signals.health.saturated == 0, scan);
                }
            }
            2 => self.watch_sums(codes, signals.health.bridge_faults == 0, scan),
            _ => {}
        }
        if self.doubted != 0 {
            self.mark_doubted(signals, bias, touched);
        }
    }

    /// Returns a number that differs after a jump.
    pub fn jumps(&self) -> u8 {
        self.jumps
    }

    /// A clipped reading does not move with the others, neither now nor when it comes back.
    fn watch_matrix(&mut self, taxels: &TaxelCodes, unclipped: bool, scan: u8) {
        let moved = compare(taxels, &mut self.matrix, &mut self.changes, self.least.codes);
        if !(core::mem::replace(&mut self.unclipped, unclipped) && unclipped) {
            return;
        }
        if moved && self.least.lessons >= TAUGHT {
            self.judge_matrix();
        }
        if self.teaches(self.least.lessons, scan)
            && let Some(row) = self.changes.get(usize::from(scan / LATER) % ROWS)
        {
            let [first, _, third] = largest(row);
            self.least.learn(first, third, &LEAST);
        }
    }

    /// With fewer sensors a ripple of the supply is no different from a jump, and the return of one
    /// is none.
    fn watch_sums(&mut self, codes: &Codes, sound: bool, scan: u8) {
        let (mut complete, mut signs) = (sound, 0);
        let [.., changes] = &mut self.changes;
        let lasts = self.sums.iter_mut().zip(&self.least_sums);
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
        let [Least { lessons, .. }, ..] = self.least_sums;
        let teaches = self.teaches(lessons, scan);
        if signs < 0 || teaches {
            self.judge_sums(teaches);
        }
    }

    /// Returns whether this turn of the scans teaches what is usual.
    fn teaches(&self, lessons: u32, scan: u8) -> bool {
        (lessons < TAUGHT || scan % LATER < TURN) && self.doubted == 0
    }

    #[cold]
    #[inline(never)]
    fn judge_matrix(&mut self) {
        let [lit @ .., dark, _] = &self.changes;
        let (lit, least) = (lit.as_flattened(), self.least.codes);
        let [_, _, third] = largest(dark);
        let dark_limit = OTHER_DARK * third + 2 * least;
        let dark = beyond(dark, dark_limit);
        let [first, second, third] = largest(lit);
        let mut limit = OTHERS * second + least;
        let mut jumped = first > limit;
        if !jumped {
            limit = OTHERS * third + least;
            // Two that change places move against each other, those under a touch do not.
            let up = lit.iter().filter(|change| **change > limit).count();
            jumped = second > limit && up == 1;
        }
        if jumped {
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

    /// Doubts the line that changes alone; the taxels of the first one, and the `step` to the next.
    #[inline(never)]
    fn judge_line(&mut self, sums: &[i32; 4], line: u32, step: usize) {
        let [first, second, _] = largest(sums);
        // The noise of four readings is twice that of one.
        let limit = OTHERS * second + 2 * self.least.codes;
        if first > limit {
            let place = beyond(sums, limit).trailing_zeros() as usize;
            self.doubt(line << ((step * place) & 15), limit / 4);
        }
    }

    #[cold]
    #[inline(never)]
    fn judge_sums(&mut self, teaches: bool) {
        let [.., sums] = self.changes;
        let [first, _, third] = largest(&sums);
        for (i, change) in sums.iter().map(|change| change.abs()).enumerate() {
            let Some(least) = self.least_sums.get_mut(i) else { break };
            let limit = OTHER_SUMS * third + least.codes;
            if teaches {
                least.learn(first, change.min(LOUDEST * third), &LEAST_SUM);
            }
            if change > limit && least.lessons > TAUGHT {
                self.doubt(1 << (TAXELS + COLS + i), limit);
            }
        }
    }

    /// Doubts the readings that `jumped`, a bit each, by more than the limit.
    #[inline(never)]
    fn doubt(&mut self, jumped: u32, limit: i32) {
        self.left = QUIET;
        self.jumps = self.jumps.wrapping_add(1);
        self.doubted |= jumped;
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

/// Least change that is a jump, in codes. It is learned, because a scan of fewer samples a reading
/// has more noise than the record knows.
#[derive(Clone, Copy, Debug, Default)]
struct Least {
    /// Usual change, times [`LESSONS`].
    usual: i32,
    codes: i32,
    lessons: u32,
}

impl Least {
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
    let ambient = dark.iter().sum::<i32>() / COLS as i32;
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

/// Returns a negative number if the change is more than the `least`, up or down. OR-ed signs take
/// half the time of comparisons.
#[inline(always)]
fn outside(change: i32, least: i32) -> i32 {
    (least - change) | (least + change)
}

/// Returns the sizes of the three largest changes.
#[inline(never)]
fn largest(changes: &[i32]) -> [i32; 3] {
    let [mut first, mut second, mut third] = [0; 3];
    for change in changes {
        let size = change.abs();
        if size > third {
            third = size.min(second);
            second = second.max(size.min(first));
            first = first.max(size);
        }
    }
    [first, second, third]
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
mod tests {
    use super::*;
    use crate::condition::random::noise;
    use crate::condition::{BridgeBias, Health, TaxelBias};
    use crate::units::FullScale;

    /// Noise of a reading in codes, of 16 bits.
    const CODES: f32 = 10.0;
    const SQRT_2: f32 = core::f32::consts::SQRT_2;
    const LIT: f32 = 30_000.0;
    const DARK: f32 = 2_000.0;
    const MIDPOINT: f32 = 32_768.0;
    /// Scans of 10 ms at 4 kHz.
    const TEN_MS: usize = 40;

    /// A finger with four sensors, and what changes its readings.
    struct Fingertip {
        watch: JumpWatch,
        random: u32,
        /// Codes added to each lit reading, dark reading and midpoint.
        lit: [f32; TAXELS],
        dark: [f32; COLS],
        midpoints: [[f32; 4]; SENSORS],
        sensors: usize,
        touched: bool,
        /// Noise of a reading, and what each sensor has more.
        codes: f32,
        louder: [f32; SENSORS],
        /// Faults that other detectors have found.
        known: Health,
        /// Times that each scan is given.
        repeats: usize,
    }

    impl Fingertip {
        fn new() -> Self {
            let mut finger = Self {
                watch: JumpWatch::default(),
                random: 7,
                lit: [0.0; TAXELS],
                dark: [0.0; COLS],
                midpoints: [[0.0; 4]; SENSORS],
                sensors: SENSORS,
                touched: false,
                codes: CODES,
                louder: [1.0; SENSORS],
                known: Health::SOUND,
                repeats: 1,
            };
            finger.rests(1000);
            finger
        }

        /// A finger that has just been switched on.
        fn restarted(mut self) -> Self {
            self.watch = JumpWatch::default();
            self
        }

        fn rests(&mut self, scans: usize) {
            assert!((0..scans).all(|_| self.next() == self.known));
        }

        fn next(&mut self) -> Health {
            let top = 65_535.0;
            let (random, codes) = (&mut self.random, self.codes);
            let mut code = |at: f32| Code((at + codes * noise(random) + 0.5) as u16);
            let dark = self.dark.map(|by| code(DARK + by));
            let mut lit = [[Code(0); COLS]; 4];
            let mut c = [0.0; TAXELS];
            for (k, (lit, c)) in lit.as_flattened_mut().iter_mut().zip(&mut c).enumerate() {
                *lit = code(LIT + self.lit[k]);
                *c = (LIT - DARK - f32::from(lit.0) + f32::from(dark[k % COLS].0)) / top;
            }
            let mut bridges = [None; SENSORS];
            let mut outputs = [None; SENSORS];
            for i in 0..self.sensors {
                let mut midpoint = |by| {
                    let Code(read) = code(0.5 * MIDPOINT);
                    let noise = f32::from(read) - 0.5 * MIDPOINT;
                    Code((MIDPOINT + by + self.louder[i] * noise) as u16)
                };
                let [a, b, c, d] = self.midpoints[i].map(&mut midpoint);
                let [fa, fb, fc, fd] = [a, b, c, d].map(|code| f32::from(code.0) / top);
                bridges[i] = Some(Midpoints { a, b, c, d });
                outputs[i] = Some([fb - fa, fc - fd, fa + fb - fc - fd]);
            }
            let codes = Codes {
                full_scale: FullScale::BITS_16,
                taxels: Some(TaxelCodes { lit, dark }),
                bridges,
                reference: None,
                temperature: None,
            };
            let mut signals = Signals { taxels: Some(c), bridges: outputs, health: self.known };
            let taxels = TaxelBias { level: [0.0; TAXELS], noise: SQRT_2 * CODES / top };
            let sensor = BridgeBias { level: [0.0; 3], noise: 1.63 * CODES / top };
            let bias = Bias { taxels: Some(taxels), bridges: [Some(sensor); SENSORS] };
            for _ in 0..self.repeats {
                signals.health = self.known;
                self.watch.update(&codes, &mut signals, &bias, self.touched);
            }
            signals.health
        }

        /// Scans until just `expected` is in doubt; no other channel may be before.
        fn until(&mut self, expected: Health, mut change: impl FnMut(&mut Self)) -> usize {
            for scan in 1..=2 * TEN_MS {
                change(self);
                let doubted = self.next();
                if doubted == expected {
                    return scan;
                }
                assert!(doubted.dead & !expected.dead == 0, "{doubted:?} for {expected:?}");
                assert!(
                    doubted.bridge_faults & !expected.bridge_faults == 0,
                    "{doubted:?} for {expected:?}"
                );
            }
            panic!("{expected:?} was not found");
        }
    }

    fn taxel(k: usize) -> Health {
        Health { dead: 1 << k, ..Health::SOUND }
    }

    fn sensor(i: usize) -> Health {
        Health { bridge_faults: 1 << i, ..Health::SOUND }
    }

    #[test]
    fn noisy_reading_is_named_within_10_ms() {
        for k in 0..TAXELS {
            let mut finger = Fingertip::new();
            let scans = finger.until(taxel(k), |finger| {
                finger.lit[k] = 40.0 * CODES * noise(&mut finger.random);
            });
            assert!(scans <= TEN_MS, "taxel {k}: {scans}");
        }
        for i in 0..SENSORS {
            let mut finger = Fingertip::new();
            let scans = finger.until(sensor(i), |finger| {
                finger.midpoints[i][2] = 20.0 * CODES * noise(&mut finger.random);
            });
            assert!(scans <= TEN_MS, "sensor {i}: {scans}");
        }
    }

    #[test]
    fn noise_that_ends_is_forgotten_at_rest() {
        let mut finger = Fingertip::new();
        finger.until(taxel(3), |finger| finger.lit[3] = 50.0 * CODES * noise(&mut finger.random));
        finger.lit[3] = 0.0;
        let left = (0..500).filter(|_| finger.next() != Health::SOUND).count();
        assert!(left <= usize::from(QUIET) + 4, "{left}");
    }

    #[test]
    fn step_of_one_reading_is_named_at_once_and_lasts() {
        for k in 0..TAXELS {
            let mut finger = Fingertip::new();
            let scans = finger.until(taxel(k), |finger| finger.lit[k] = 800.0);
            assert!(scans <= usize::from(TURN), "taxel {k}: {scans}");
            for scan in 0..1000 {
                assert_eq!(finger.next(), taxel(k), "scan {scan}");
            }
        }
    }

    #[test]
    fn step_back_ends_the_doubt_in_a_touch() {
        let mut finger = Fingertip::new();
        finger.touched = true;
        finger.lit.iter_mut().for_each(|lit| *lit = 3_000.0);
        finger.dark.iter_mut().for_each(|dark| *dark = 3_000.0);
        finger.until(taxel(9), |finger| finger.lit[9] = 4_000.0);
        assert!((0..500).all(|_| finger.next() == taxel(9)));
        finger.lit[9] = 3_000.0;
        let left = (0..500).filter(|_| finger.next() != Health::SOUND).count();
        assert!((60..70).contains(&left), "{left}");
    }

    #[test]
    fn neighbours_that_change_places_are_both_named() {
        let mut finger = Fingertip::new();
        let both = Health { dead: 0b110, ..Health::SOUND };
        finger.until(both, |finger| (finger.lit[1], finger.lit[2]) = (700.0, -700.0));
        let mut finger = Fingertip::new();
        (finger.lit[1], finger.lit[2]) = (700.0, 500.0);
        finger.rests(100);
    }

    #[test]
    fn row_or_column_that_jumps_is_named_and_lasts() {
        for line in 0..4 {
            for (taxels, step) in [(0b1111 << (4 * line), 4), (0x1111 << line, 1)] {
                let mut finger = Fingertip::new();
                let lost = Health { dead: taxels, ..Health::SOUND };
                let scans = finger.until(lost, |finger| {
                    let own = |k: &usize| taxels >> k & 1 == 1;
                    (0..TAXELS).filter(own).for_each(|k| finger.lit[k] = -0.05 * LIT);
                });
                assert!(scans <= usize::from(TURN), "line {line}, {step}: {scans}");
                (0..1000).for_each(|_| assert_eq!(finger.next(), lost));
            }
        }
    }

    #[test]
    fn dark_reading_names_its_column() {
        let mut finger = Fingertip::new();
        let column = Health { dead: 0x2222, ..Health::SOUND };
        finger.until(column, |finger| finger.dark[1] = 40.0 * CODES);
    }

    #[test]
    fn light_force_and_a_rippling_supply_are_no_jumps() {
        let mut finger = Fingertip::new();
        for scan in 0..20_000 {
            let swing = f32::sin(scan as f32 * 0.16);
            finger.dark = [1.0, 1.1, 0.9, 1.05].map(|gain| 1_500.0 * gain * swing);
            for (k, lit) in finger.lit.iter_mut().enumerate() {
                // A touch that moves over the pad, up to 300 codes in two scans.
                let touch = f32::sin(scan as f32 * 0.011).max(0.0) * 8_000.0;
                let (x, y) = (f32::sin(scan as f32 * 7e-4), f32::cos(scan as f32 * 5e-4));
                let (dx, dy) = ((k % COLS) as f32 - 1.5 - x, (k / COLS) as f32 - 1.5 - y);
                *lit = touch / (1.0 + dx * dx + dy * dy) + 1_500.0 * swing;
            }
            for (i, arms) in finger.midpoints.iter_mut().enumerate() {
                let (force, ripple) = (6_000.0 * f32::sin(scan as f32 * 0.02), 500.0 * swing);
                let gain = 1.0 - 0.02 * i as f32;
                *arms = [force, -force, 0.5 * force, -0.5 * force].map(|u| gain * (u + ripple));
            }
            assert_eq!(finger.next(), Health::SOUND, "scan {scan}");
        }
    }

    #[test]
    fn sensors_are_not_judged_if_one_is_missing() {
        for sensors in 1..SENSORS {
            let mut finger = Fingertip::new();
            finger.sensors = sensors;
            finger.rests(20_000);
            finger.midpoints[0][0] = 2_000.0;
            finger.rests(100);
        }
    }

    #[test]
    fn wrong_code_in_a_moving_touch_is_forgotten() {
        for sensors in [0, SENSORS] {
            let mut finger = Fingertip::new();
            (finger.sensors, finger.touched) = (sensors, true);
            let light = |scan: usize| 2_000.0 * f32::sin(scan as f32 * 0.03);
            let mut doubted = 0;
            for scan in 0..2_000 {
                for (k, lit) in finger.lit.iter_mut().enumerate() {
                    let (dx, dy) = ((k % COLS) as f32 - 1.5, (k / COLS) as f32 - 1.5);
                    *lit = light(scan) / (1.0 + dx * dx + dy * dy);
                }
                if scan == 1_000 {
                    finger.lit[5] = 9_000.0;
                }
                doubted += usize::from(finger.next() != Health::SOUND);
            }
            assert!((1..=80).contains(&doubted), "{sensors} sensors: {doubted}");
        }
    }

    #[test]
    fn more_noise_than_the_record_knows_is_learned() {
        let mut finger = Fingertip::new().restarted();
        finger.codes = 3.0 * CODES;
        finger.rests(200_000);
        let mut finger = Fingertip::new().restarted();
        finger.louder = [1.0, 3.0, 1.0, 2.0];
        finger.rests(400_000);
    }

    #[test]
    fn finger_with_a_fault_from_the_start_is_judged_like_others() {
        let dead = Health { dead: 1 << 6, ..Health::SOUND };
        let broken = Health { bridge_faults: 1 << 2, ..Health::SOUND };
        for known in [dead, broken] {
            let mut finger = Fingertip::new().restarted();
            finger.known = known;
            finger.rests(20_000);
            let named = Health { dead: known.dead | 1 << 9, ..known };
            finger.until(named, |finger| finger.lit[9] = 800.0);
        }
        // A sensor that is plugged in later.
        let mut finger = Fingertip::new().restarted();
        finger.sensors = SENSORS - 1;
        finger.rests(2_000);
        finger.sensors = SENSORS;
        finger.rests(20_000);
        finger.until(sensor(3), |finger| finger.midpoints[3][0] = 600.0);
    }

    #[test]
    fn scans_that_repeat_are_no_jumps() {
        for repeats in [2, 10, 50] {
            let mut finger = Fingertip::new().restarted();
            finger.repeats = repeats;
            finger.rests(200_000 / repeats);
        }
    }

    #[test]
    fn lasting_step_is_not_forgotten_with_another_jump() {
        let mut finger = Fingertip::new();
        finger.touched = true;
        finger.until(taxel(3), |finger| finger.lit[3] = 1_500.0);
        // A fast touch in which another taxel jumps, so that far more is allowed.
        let both = Health { dead: 1 << 3 | 1 << 12, ..Health::SOUND };
        finger.until(both, |finger| {
            finger.lit[12] += 10_000.0;
            finger.lit[9] += 500.0;
        });
        (finger.lit[9], finger.lit[12]) = (0.0, 0.0);
        let last = (0..500).map(|_| finger.next()).last();
        assert_eq!(last, Some(taxel(3)));
    }

    #[test]
    fn clipping_taxels_are_no_jumps() {
        let mut watch = JumpWatch::default();
        let bias = Bias {
            taxels: Some(TaxelBias { level: [0.0; TAXELS], noise: 1e-4 }),
            ..Bias::default()
        };
        for scan in 0..4_000u32 {
            // All but one are clipped, and that one follows the light.
            let light = if scan % 400 < 200 { 40_000 } else { 60_000 };
            let (mut lit, mut signals) = ([[Code(65_535); COLS]; 4], Signals::default());
            lit[2][1] = Code(light);
            signals.health.saturated = !(1 << 9);
            signals.taxels = Some([0.0; TAXELS]);
            let codes = Codes {
                full_scale: FullScale::BITS_16,
                taxels: Some(TaxelCodes { lit, dark: [Code(9_000); COLS] }),
                bridges: [None; SENSORS],
                reference: None,
                temperature: None,
            };
            watch.update(&codes, &mut signals, &bias, false);
            assert_eq!((signals.health.dead, signals.health.bridge_faults), (0, 0));
        }
    }
}
