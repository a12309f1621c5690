//! Detection of channels whose code does not change, and of scans that repeat.
//!
//! How long a sound channel rests on one code depends on its noise, which no one knows beforehand:
//! readings that sum conversions hardly ever rest, single conversions may for dozens of scans. Each
//! group of channels therefore shows it itself. A channel is stuck if it rests three times as long
//! as any of its group did in many earlier visits, while most of its kind move. A scan is frozen if
//! it repeats three times as often as any did earlier. Codes without noise that begin at rest, as
//! those of some recordings, repeat so often that they are not judged.
//!
//! Three limits: a sound channel with less than half a code of noise may be called stuck for a while
//! when a movement or flickering light ends; a loose wire that sticks often, each time too briefly
//! to be judged, teaches more and more patience; and a scan that is frozen from the start is not
//! found.

use core::ops::RangeInclusive;

use crate::scan::{COLS, Codes, Midpoints, ROWS, SENSORS, TaxelCodes};
use crate::units::Code;

/// Four channels that are visited together: a row of taxels, or a sensor.
type Group = [Code; COLS];
const GROUPS: usize = ROWS + SENSORS;
/// Mask of a group's channels.
const ALL: u32 = (1 << COLS) - 1;
/// Mask of the taxels; the other bits are midpoints.
const TAXELS: u32 = 0xffff;

/// Least and most comparisons after which a resting channel is judged.
///
/// With a noise of one code a channel in the middle of its code rests for the least in one of 10¹⁰
/// visits, even if movement hid its noise before. With a quarter of a code it moves in one of 22
/// scans, and rests for the most in one of 10¹⁰.
const JUDGED: RangeInclusive<u16> = 24..=512;
/// Comparisons beyond three times the longest rest.
const MARGIN: u16 = 4;
/// Equal scans in a row that show codes without noise.
const NO_NOISE: u16 = 16;
/// Rounds of visits in a lesson on how long channels rest.
const LESSON: u8 = 128;

/// State of the detector. One group is visited at a time, until all of its channels have moved.
#[derive(Clone, Debug, Default)]
pub struct StuckWatch {
    /// Lit codes of the first row and dark codes of the last scan. No others are kept, because they
    /// show as well as all whether a scan repeats.
    last: [Group; 2],
    /// Repetitions of the last scan, and one more than in the longest runs of them.
    repeats: u16,
    repeated: Longest,
    group: u8,
    /// Codes at the start of the visit, comparisons since then, and the channels that have moved.
    first: Option<Group>,
    compared: u16,
    seen: u32,
    /// Comparisons of the longest visits of each group.
    longest: [Longest; GROUPS],
    /// Rounds of this lesson.
    rounds: u8,
    /// Bits of all channels, taxels first: those compared and moved in the latest visit of their
    /// group, and those that are stuck.
    present: u32,
    moved: u32,
    stuck: u32,
}

/// Channels that are stuck.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stuck {
    /// Bit k: taxel k.
    pub taxels: u16,
    /// Bit i: a midpoint of sensor i.
    pub bridges: u8,
}

impl StuckWatch {
    /// Processes one scan and returns the stuck channels: all, if the scan is frozen. Codes of a
    /// `flooded` matrix, whose taxels clip, have no noise.
    pub fn update(&mut self, codes: &Codes, flooded: bool) -> Stuck {
        if let Some(TaxelCodes { lit: [row, ..], dark }) = &codes.taxels {
            if *row == self.last[0] && *dark == self.last[1] {
                // Channels are not compared: their rest would tell nothing new.
                return self.again(flooded);
            }
            self.last = [*row, *dark];
        }
        if self.repeats > 0 {
            self.ended();
        }
        if let Some(now) = read(codes, self.group()) {
            self.visit(&now, codes.full_scale.clipped().0 - 1);
        } else {
            self.keep(0, 0);
            self.stuck &= self.present;
            self.next();
        }
        stuck(self.stuck)
    }

    /// Processes a scan that equals the last one.
    #[cold]
    #[inline(never)]
    fn again(&mut self, flooded: bool) -> Stuck {
        if !flooded {
            self.repeats = self.repeats.saturating_add(1);
        }
        stuck(if self.is_frozen() { self.present } else { self.stuck })
    }

    /// Learns from a run of equal scans that has ended, unless it was a fault.
    #[cold]
    #[inline(never)]
    fn ended(&mut self) {
        if !self.is_frozen() {
            self.repeated.learn(self.repeats.saturating_add(1));
        }
        self.repeats = 0;
    }

    fn is_frozen(&self) -> bool {
        let longest = self.repeated.known().filter(|longest| *longest < NO_NOISE);
        longest.is_some_and(|longest| self.repeats >= 3 * longest)
    }

    fn group(&self) -> usize {
        usize::from(self.group)
    }

    /// Number of the group's first channel.
    fn shift(&self) -> usize {
        COLS * self.group()
    }

    /// Compares the channels of the group with those at the start of its visit. `highest` is the
    /// highest code below the upper rail.
    fn visit(&mut self, now: &Group, highest: u16) {
        let Some(first) = &self.first else {
            self.first = Some(*now);
            return;
        };
        let mut seen = self.seen;
        for (i, (Code(now), Code(first))) in now.iter().zip(first).enumerate() {
            // A code at a rail may rest there, because other flags report it.
            if now != first || now.wrapping_sub(1) >= highest {
                seen |= 1 << i;
            }
        }
        self.seen = seen;
        self.compared += 1;
        let rested = ALL & !(seen | self.stuck >> self.shift()) != 0;
        if rested && (self.compared < *JUDGED.start() || self.compared < self.most()) {
            return;
        }
        self.keep(ALL, seen);
        self.judge(rested);
        self.next();
    }

    /// Returns the comparisons after which a channel at rest is judged.
    fn most(&self) -> u16 {
        let (least, most) = (*JUDGED.start(), *JUDGED.end());
        // Without noise, a movement that ends lets channels rest one by one.
        let noise = self.repeated.before.max(self.repeated.now) < NO_NOISE;
        let longest = self.longest.get(self.group()).filter(|_| noise);
        let longest = longest.and_then(|longest| longest.known());
        longest.map_or(most, |longest| (3 * longest + MARGIN).clamp(least, most))
    }

    /// Keeps the result of the visit.
    fn keep(&mut self, present: u32, moved: u32) {
        let (shift, others) = (self.shift(), !(ALL << self.shift()));
        self.present = self.present & others | present << shift;
        self.moved = self.moved & others | moved << shift;
    }

    /// Judges the channels of the visited group, some of which may have `rested` all the time. If
    /// fewer than three quarters of the sound ones of their kind moved, it only clears those that
    /// did.
    fn judge(&mut self, rested: bool) {
        let (group, shift) = (self.group(), self.shift());
        let most_moved = !rested || {
            let kind = if group < ROWS { TAXELS } else { !TAXELS } & !self.stuck;
            4 * (self.moved & kind).count_ones() >= 3 * (self.present & kind).count_ones()
        };
        let Some(longest) = self.longest.get_mut(group) else { return };
        let mut rest = self.compared;
        if rested && most_moved {
            self.stuck |= ALL << shift;
            // It may have been none.
            rest /= 2;
        }
        self.stuck &= !self.moved;
        // A rest of all channels tells nothing of their noise.
        if most_moved || longest.known().is_none() {
            longest.learn(rest);
        }
    }

    fn next(&mut self) {
        self.group += 1;
        (self.first, self.compared, self.seen) = (None, 0, 0);
        if self.group() < GROUPS {
            return;
        }
        self.group = 0;
        self.rounds += 1;
        if self.rounds == LESSON {
            self.rounds = 0;
            self.repeated.learn(1);
            self.repeated.turn();
            self.longest.iter_mut().for_each(Longest::turn);
        }
    }
}

fn read(codes: &Codes, group: usize) -> Option<Group> {
    if group < ROWS {
        return codes.taxels.as_ref()?.lit.get(group).copied();
    }
    let Midpoints { a, b, c, d } = codes.bridges.get(group - ROWS).copied().flatten()?;
    Some([a, b, c, d])
}

/// Returns the channels with these bits.
fn stuck(bits: u32) -> Stuck {
    if bits == 0 {
        return Stuck::default();
    }
    let [low, high, midpoints @ ..] = bits.to_le_bytes();
    let mut bridges = 0;
    for (i, midpoints) in midpoints.iter().flat_map(|two| [two & 15, two >> 4]).enumerate() {
        bridges |= u8::from(midpoints != 0) << i;
    }
    Stuck { taxels: u16::from_le_bytes([low, high]), bridges }
}

/// Longest rests before this lesson, and in it. Zero stands for none yet.
#[derive(Clone, Copy, Debug, Default)]
struct Longest {
    before: u16,
    now: u16,
}

impl Longest {
    /// Returns the longest rest, once a lesson has ended.
    fn known(self) -> Option<u16> {
        (self.before != 0).then(|| self.before.max(self.now))
    }

    fn learn(&mut self, rest: u16) {
        self.now = self.now.max(rest);
    }

    /// Ends a lesson. Longer rests of earlier ones are forgotten by halves.
    fn turn(&mut self) {
        *self = Self { before: self.now.max(self.before / 2), now: 0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::random::noise;
    use crate::scan::TAXELS;
    use crate::units::FullScale;

    const CHANNELS: usize = TAXELS + COLS * SENSORS;

    /// A finger whose converter has `noise` codes of noise.
    struct Fingertip {
        noise: f32,
        random: u32,
        watch: StuckWatch,
        scans: u32,
        /// Codes at which channels stick.
        held: [Option<Code>; CHANNELS],
        last: Codes,
    }

    impl Fingertip {
        fn new(noise: f32, random: u32) -> Self {
            let last = Codes {
                full_scale: FullScale::new(8 * 4095).unwrap(),
                taxels: Some(TaxelCodes::default()),
                bridges: [Some(Midpoints::default()); SENSORS],
                reference: None,
                temperature: None,
            };
            let held = [None; CHANNELS];
            Self { noise, random, watch: StuckWatch::default(), scans: 0, held, last }
        }

        /// Code of a channel that moved by `by` codes.
        fn code(&mut self, channel: usize, by: f32) -> Code {
            let rest = 9_000.0 + 101.37 * channel as f32;
            let read = rest + by + self.noise * noise(&mut self.random);
            self.held[channel].unwrap_or(Code((read + 0.5) as u16))
        }

        /// Channels flagged in the next scan, whose taxels see `light` and all feel `force`.
        fn next(&mut self, light: f32, force: f32) -> Stuck {
            let mut codes = self.last;
            let lit = core::array::from_fn(|k| self.code(k, light + force));
            let taxels = codes.taxels.as_mut().unwrap();
            for (to, from) in taxels.lit.as_flattened_mut().iter_mut().zip::<[Code; TAXELS]>(lit) {
                *to = from;
            }
            for dark in &mut taxels.dark {
                *dark = Code((900.0 + light + self.noise * noise(&mut self.random) + 0.5) as u16);
            }
            for sensor in 0..SENSORS {
                let [a, b, c, d] =
                    core::array::from_fn(|i| self.code(TAXELS + COLS * sensor + i, force));
                codes.bridges[sensor] = Some(Midpoints { a, b, c, d });
            }
            self.give(codes)
        }

        fn give(&mut self, codes: Codes) -> Stuck {
            self.last = codes;
            self.scans += 1;
            let clips = |code: Code| codes.full_scale.clips(code);
            self.watch.update(&codes, clips(codes.taxels.unwrap().lit[0][0]))
        }

        /// Sticks a channel at its last code.
        fn hold(&mut self, channel: usize) {
            let taxels = self.last.taxels.unwrap().lit;
            self.held[channel] = Some(match channel.checked_sub(TAXELS) {
                None => taxels.as_flattened()[channel],
                Some(i) => {
                    let Midpoints { a, b, c, d } = self.last.bridges[i / COLS].unwrap();
                    [a, b, c, d][i % COLS]
                }
            });
        }

        /// Scans until just `expected` is flagged.
        fn until(&mut self, expected: Stuck) -> u32 {
            (1..20_000).find(|_| self.next(0.0, 0.0) == expected).unwrap()
        }

        /// Scans of `count` with a flag.
        fn flagged(&mut self, count: u32, light: impl Fn(u32) -> f32) -> u32 {
            (0..count)
                .map(|_| u32::from(self.next(light(self.scans), 0.0) != Stuck::default()))
                .sum()
        }
    }

    fn stuck(channel: usize) -> Stuck {
        match channel.checked_sub(TAXELS) {
            None => Stuck { taxels: 1 << channel, bridges: 0 },
            Some(i) => Stuck { taxels: 0, bridges: 1 << (i / COLS) },
        }
    }

    /// A finger with the noise of the reference finger, sums of eight conversions, that has scanned
    /// for a while.
    fn sound() -> Fingertip {
        let mut finger = Fingertip::new(1.4, 1);
        assert_eq!(finger.flagged(30_000, |_| 0.0), 0);
        finger
    }

    #[test]
    fn each_stuck_channel_is_flagged_within_60_scans_until_it_moves() {
        for channel in 0..CHANNELS {
            let mut finger = sound();
            // A loose wire, each time judged with more patience.
            for most in [60, 80, 110] {
                finger.hold(channel);
                let scans = finger.until(stuck(channel));
                assert!(scans <= most, "channel {channel}: {scans}");
                finger.held[channel] = None;
                assert!(finger.until(Stuck::default()) <= 60, "channel {channel}");
                assert_eq!(finger.flagged(3_000, |_| 0.0), 0);
            }
        }
    }

    #[test]
    fn stuck_row_column_and_sensor_are_flagged() {
        let row = ([4, 5, 6, 7], Stuck { taxels: 0b1111 << 4, bridges: 0 });
        let column = ([1, 5, 9, 13], Stuck { taxels: 0x2222, bridges: 0 });
        let sensor = ([20, 21, 22, 23], Stuck { taxels: 0, bridges: 0b10 });
        for (channels, expected) in [row, column, sensor] {
            let mut finger = sound();
            channels.iter().for_each(|channel| finger.hold(*channel));
            assert!(finger.until(expected) <= 150);
            assert_eq!(finger.flagged(1000, |_| 0.0), 1000);
        }
    }

    #[test]
    fn channel_that_is_stuck_from_the_start_is_flagged() {
        let mut finger = Fingertip::new(1.4, 1);
        finger.held[6] = Some(Code(9_600));
        assert!(finger.until(stuck(6)) < 600);
    }

    #[test]
    fn sound_finger_is_not_flagged_whatever_its_noise() {
        for noise in [0.3, 0.5, 1.0, 1.4, 5.0] {
            for seed in 1..4 {
                let flagged = Fingertip::new(noise, seed).flagged(50_000, |_| 0.0);
                assert_eq!(flagged, 0, "noise of {noise}");
            }
        }
    }

    #[test]
    fn rest_after_flickering_light_is_no_fault() {
        let flicker = |i: u32| {
            let on = (i / 20_000).is_multiple_of(2);
            if on { 30.0 * (i as f32 * 0.628).sin() } else { 0.0 }
        };
        for noise in [0.5, 1.0, 1.4] {
            let flagged = Fingertip::new(noise, 1).flagged(200_000, flicker);
            assert_eq!(flagged, 0, "noise of {noise}");
        }
    }

    #[test]
    fn scan_is_frozen_at_its_third_repetition_until_the_next_other_one() {
        const ALL: Stuck = Stuck { taxels: u16::MAX, bridges: 0b1111 };
        let mut finger = sound();
        let frozen = finger.last;
        for repeated in 1..1000 {
            let expected = if repeated < 3 { Stuck::default() } else { ALL };
            assert_eq!(finger.give(frozen), expected, "{repeated}");
        }
        assert_eq!(finger.flagged(1000, |_| 0.0), 0);
        // Channels that a finger does not have are not stuck.
        let still = Codes { bridges: [None; SENSORS], ..finger.last };
        let flags = (0..500u16).map(|i| {
            let mut codes = still;
            codes.taxels.iter_mut().for_each(|taxels| taxels.dark[0].0 += i.min(400));
            finger.give(codes)
        });
        assert_eq!(flags.last(), Some(Stuck { bridges: 0, ..ALL }));
    }

    #[test]
    fn held_rows_and_recordings_without_noise_are_not_flagged() {
        // Each scan given ten times.
        let mut finger = Fingertip::new(1.4, 1);
        for _ in 0..10_000 {
            assert_eq!(finger.next(0.0, 0.0), Stuck::default());
            let held = finger.last;
            (0..9).for_each(|_| assert_eq!(finger.give(held), Stuck::default()));
        }
        // Half a second of rest, then presses and holds of a second.
        let mut finger = Fingertip::new(0.0, 1);
        for i in 0..20_000u32 {
            let t = i as f32 * 1e-3;
            let force = if t < 0.5 || i / 1000 % 2 == 0 { 0.0 } else { 900.0 * (3.0 * t).sin() };
            assert_eq!(finger.next(0.0, force), Stuck::default(), "{i}");
        }
    }

    #[test]
    fn repetitions_and_faults_at_the_start_do_not_blind_the_watch() {
        let mut finger = Fingertip::new(1.4, 1);
        let dark = finger.last;
        (0..20).for_each(|_| assert_eq!(finger.give(dark), Stuck::default()));
        finger.held[6] = Some(Code(9_600));
        assert!(finger.until(stuck(6)) < 600);
        finger.hold(5);
        assert!(finger.until(Stuck { taxels: 0b110_0000, bridges: 0 }) < 2000);
        finger.held = [None; CHANNELS];
        finger.until(Stuck::default());
        assert_eq!(finger.flagged(100_000, |_| 0.0), 0);
        finger.hold(5);
        assert!(finger.until(stuck(5)) <= 60);
    }

    #[test]
    fn code_at_a_rail_is_not_stuck() {
        let mut finger = Fingertip::new(1.4, 1);
        finger.held[6] = Some(Code(0));
        finger.held[9] = Some(Code(8 * 4095));
        assert_eq!(finger.flagged(20_000, |_| 0.0), 0);
        // Nor is a scan frozen in which light clips all taxels of a finger without sensors.
        let codes = Codes { bridges: [None; SENSORS], ..finger.last };
        let lit = [[Code(8 * 4095); COLS]; ROWS];
        let flooded = Codes { taxels: Some(TaxelCodes { lit, dark: lit[0] }), ..codes };
        for _ in 0..1000 {
            assert_eq!(finger.give(flooded), Stuck::default());
        }
    }
}
