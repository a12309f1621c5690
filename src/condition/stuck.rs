//! Detection of channels whose code does not change, and of scans that repeat.
//!
//! How long a sound channel rests on one code depends on its noise, which no one knows beforehand:
//! readings that sum conversions hardly ever rest, single conversions may for dozens of scans. Each
//! group of channels therefore shows it itself. A channel is stuck if it rests three times as long
//! as any of its group did in many earlier visits, while most of its kind move. A scan is frozen if
//! it repeats three times as often as any did earlier. Codes without noise that begin at rest, as
//! those of some recordings, repeat so often that they are not judged.
//!
//! Five limits: a sound channel with less than half a code of noise may be called stuck for a while
//! when a movement or flickering light ends; a loose wire that sticks often, each time too briefly
//! to be judged, teaches more and more patience; a scan that is frozen from the start is not found;
//! one of a finger without sensors may be found four scans late; and with half a code of noise and
//! few channels a sound scan that happens to repeat may be taken for frozen.

use super::{Bias, Health};
use crate::scan::{COLS, Codes, Midpoints, ROWS, SENSORS};
use crate::units::{Code, FullScale};

/// Codes of four channels that are visited together, two in a word: a row of taxels, or a sensor.
type Group = [u32; 2];
const GROUPS: usize = ROWS + SENSORS;
/// Mask of a group's channels.
const ALL: u32 = (1 << COLS) - 1;
/// Mask of the taxels; the other bits are midpoints.
const TAXELS: u32 = 0xffff;

/// Least comparisons after which a resting channel is judged: with little noise, and with
/// [`LOUD`] codes of it.
///
/// With a noise of one code, or of two, a channel in the middle of its code rests for so long in
/// one of 10¹⁰ visits, even if movement hid its noise before.
const LEAST: [u32; 2] = [24, 14];
const LOUD: f32 = 2.0;
/// Noise of a signal over that of its codes, at most: √2 in a taxel's, of two codes; √2⅔ in a
/// bridge's three, of two, two and four.
const CODES_OF_A_SIGNAL: f32 = 1.65;
/// Most codes that a converter tells apart: sums of eight conversions of 12 bits. Codes of a larger
/// scale may have been made larger.
const FINEST: u16 = 8 * 4095;
/// Most comparisons after which a resting channel is judged. With a noise of a quarter of a code it
/// moves in one of 22 scans, and rests for so long in one of 10¹⁰ visits.
const MOST: u32 = 512;
/// Comparisons beyond three times the longest rest.
const MARGIN: u32 = 4;
/// Equal scans in a row that show codes without noise.
const NO_NOISE: u32 = 16;
/// Comparisons of a short visit. It teaches nothing, nor does one comparison more, the first after
/// which a channel at a rail is noticed.
const SHORT: u32 = 3;
/// Visits in a lesson on how long channels rest.
const LESSON: u32 = 128 * GROUPS as u32;

/// State of the detector. One group is visited at a time, until all of its channels have moved.
#[derive(Clone, Debug, Default)]
pub struct StuckWatch {
    /// Visits before this one; a later lesson counts on from [`GROUPS`], because only the first
    /// round differs. The lowest bits are the visited group.
    visits: u32,
    /// Comparisons of this visit until the next that takes longer than usual, and their number by
    /// then. There are none left before a visit.
    left: u32,
    until: u32,
    /// Codes of the group in the last scan, and bits that have changed in the visit.
    last: Group,
    changed: Group,
    /// Rests in the longest visits of each group, beyond [`SHORT`] + 1.
    longest: [Longest; GROUPS],
    /// Mix of other codes in the last scan in which the group rested, and its number in the visit.
    mix: u32,
    rested_at: u32,
    /// Repetitions of that scan.
    repeats: u32,
    /// One more than in the longest runs of repetitions.
    repeated: Longest,
    /// Whether a lesson has ended.
    taught: bool,
    /// Bits of all channels, taxels first: those that moved in the latest visit of their group, lie
    /// at a rail or do not exist; and those of the others that are stuck.
    moved: u32,
    stuck: u32,
}

impl StuckWatch {
    /// Processes one scan, adds the stuck channels to its `health` and returns whether there are
    /// any. All are if the scan is frozen. Codes of a `flooded` matrix, whose taxels clip, have no
    /// noise; that of a finger at rest is the bias's.
    ///
    /// Whatever is rare is done in functions of its own, so that a usual scan takes little time.
    pub fn update(
        &mut self,
        codes: &Codes,
        flooded: bool,
        bias: &Bias,
        health: &mut Health,
    ) -> bool {
        match read(codes, self.group()) {
            Some(now) if self.left == 0 => self.begin(now),
            Some(now) => {
                if self.visit(now, codes, flooded, bias) {
                    mark(health, present(codes));
                    return true;
                }
            }
            // The finger does not have it.
            None => self.end(ALL, 0, codes),
        }
        if self.stuck != 0 {
            mark(health, self.stuck);
        }
        self.stuck != 0
    }

    fn group(&self) -> usize {
        self.visits as usize % GROUPS
    }

    /// Number of the group's first channel.
    fn shift(&self) -> usize {
        COLS * self.group()
    }

    /// Begins a visit.
    fn begin(&mut self, now: Group) {
        let longest = self.longest.get(self.group()).map_or(0, |longest| longest.now.into());
        // Channels that are stuck do not move: there is nothing to wait for.
        let usual = if self.stuck != 0 { 0 } else { SHORT + longest };
        (self.left, self.until) = (usual + 1, usual + 1);
        (self.last, self.changed) = (now, [0; 2]);
    }

    /// Compares the channels of the group with their last codes. Returns true if the scan is
    /// frozen.
    fn visit(&mut self, now: Group, codes: &Codes, flooded: bool, bias: &Bias) -> bool {
        let [one, other] = core::mem::replace(&mut self.last, now);
        let new = [now[0] ^ one, now[1] ^ other];
        self.changed[0] |= new[0];
        self.changed[1] |= new[1];
        self.left -= 1;
        let rests = new[0] | new[1] == 0;
        if rests || self.left == 0 {
            return self.visit_slowly(rests, codes, flooded, bias);
        }
        if self.changed.iter().all(|two| two << 16 != 0 && two >> 16 != 0) {
            if self.moved == u32::MAX {
                self.next();
            } else {
                self.end(ALL, 0, codes);
            }
        }
        false
    }

    /// The rare rest of a visit: of a group whose channels rest as a whole, or for longer than
    /// usual.
    #[cold]
    #[inline(never)]
    fn visit_slowly(&mut self, rests: bool, codes: &Codes, flooded: bool, bias: &Bias) -> bool {
        let compared = self.until - self.left;
        if self.left == 0 {
            // The next comparison takes longer than usual, too.
            (self.left, self.until) = (1, compared + 1);
        }
        if rests && !flooded {
            let mix = mixed(codes, self.group());
            if mix == self.mix && compared == self.rested_at + 1 {
                // The rest of channels tells nothing new.
                self.left += 1;
                self.repeats = (self.repeats + 1).min(MOST);
                return self.is_frozen();
            }
            self.learn_repeats();
            (self.mix, self.rested_at) = (mix, compared);
            if compared < self.least(codes, bias) {
                return false;
            }
        }
        let (clipped, mut moved) = (codes.full_scale.clipped().0, 0);
        for i in 0..COLS {
            let code =
                |[one, other]: Group| (if i < 2 { one } else { other } >> (i % 2 * 16)) as u16;
            let last = code(self.last);
            // A code at a rail may rest there, because other flags report it.
            let moves = code(self.changed) != 0 || last == 0 || last >= clipped;
            moved |= u32::from(moves) << i;
        }
        let rested = ALL & !(moved | self.stuck >> self.shift()) != 0;
        if rested && compared < self.judged(codes, bias) {
            return false;
        }
        self.end(moved, compared, codes);
        false
    }

    /// Learns from a run of repetitions that has ended, unless it was a fault.
    fn learn_repeats(&mut self) {
        if self.repeats > 0 && !self.is_frozen() {
            self.repeated.learn(self.repeats + 2);
        }
        self.repeats = 0;
    }

    // Inlined each use would take 60 bytes of flash.
    #[inline(never)]
    fn is_frozen(&self) -> bool {
        let longest = self.repeated.of_all().max(1);
        // The group rested before the repetitions, and the visit's first scan may be one as well.
        let likely = if self.rested_at == 1 { 2 } else { 1 };
        self.taught && longest < NO_NOISE && self.repeats + likely >= 3 * longest
    }

    /// Returns the comparisons after which a channel at rest is judged.
    fn judged(&self, codes: &Codes, bias: &Bias) -> u32 {
        let least = self.least(codes, bias);
        if self.visits < GROUPS as u32 {
            // It is not known yet whether most move.
            return least;
        }
        let longest = self.longest.get(self.group()).copied().unwrap_or_default().of_all();
        // Without noise, a movement that ends lets channels rest one by one.
        let judged = self.taught && self.repeated.of_all() < NO_NOISE;
        if judged { (3 * (SHORT + longest) + MARGIN).clamp(least, MOST) } else { MOST }
    }

    /// Returns the least of these comparisons, which the noise of the group's codes decides.
    #[inline(never)]
    fn least(&self, codes: &Codes, bias: &Bias) -> u32 {
        let [quiet, loud] = LEAST;
        let noise = match self.group().checked_sub(ROWS) {
            None => bias.taxels.as_ref().map(|taxels| taxels.noise),
            Some(sensor) => bias.bridges.get(sensor).and_then(Option::as_ref).map(|of| of.noise),
        };
        if noise.is_some_and(|noise| is_loud(noise, codes.full_scale)) { loud } else { quiet }
    }

    /// Ends a visit in which these channels `moved`. If three quarters of the sound ones of their
    /// kind did, the others are stuck.
    #[cold]
    #[inline(never)]
    fn end(&mut self, moved: u32, compared: u32, codes: &Codes) {
        let (group, all) = (self.group(), ALL << self.shift());
        self.moved = self.moved & !all | moved << self.shift();
        let rested = all & !(self.moved | self.stuck);
        self.stuck &= !self.moved;
        let most_moved = rested == 0
            || self.visits >= GROUPS as u32 && {
                let kind = if group < ROWS { TAXELS } else { !TAXELS };
                let kind = kind & present(codes) & !self.stuck;
                4 * ones(self.moved & kind) >= 3 * ones(kind)
            };
        let mut rest = compared;
        if rested != 0 && most_moved {
            self.stuck |= rested;
            // It may have been none.
            rest /= 2;
        }
        // A rest of all channels tells nothing of their noise.
        if (most_moved || !self.taught)
            && let Some(longest) = self.longest.get_mut(group)
        {
            longest.learn(rest.saturating_sub(SHORT + 1));
        }
        self.next();
    }

    fn next(&mut self) {
        self.left = 0;
        self.visits += 1;
        if self.visits == LESSON + GROUPS as u32 {
            self.turn();
        }
    }

    #[cold]
    #[inline(never)]
    fn turn(&mut self) {
        self.visits = GROUPS as u32;
        self.taught = true;
        self.repeated.turn();
        self.longest.iter_mut().for_each(Longest::turn);
    }
}

/// Returns whether codes have [`LOUD`] codes of noise or more, from the noise of their signals.
#[inline(never)]
pub(super) fn is_loud(noise: f32, full_scale: FullScale) -> bool {
    noise * f32::from(full_scale.top().0.min(FINEST)) >= LOUD * CODES_OF_A_SIGNAL
}

/// Marks channels as faulty, a bit each as in [`StuckWatch::stuck`].
#[cold]
#[inline(never)]
fn mark(health: &mut Health, faulty: u32) {
    // The lowest bit of each four, then these side by side.
    let two = faulty >> 16 | faulty >> 17;
    let four = (two | two >> 2) & 0x1111;
    let bridges = (four | four >> 3 | four >> 6 | four >> 9) & 0b1111;
    health.dead |= faulty as u16;
    health.bridge_faults |= bridges as u8;
}

/// Mixes the codes of two other groups, one of them of the other kind. With the visited one they
/// show as well as all whether a scan repeats.
fn mixed(codes: &Codes, group: usize) -> u32 {
    let mut mixed = 0u32;
    for other in [group ^ 1, group ^ ROWS] {
        for two in read(codes, other).unwrap_or_default() {
            mixed = mixed.rotate_left(7) ^ two;
        }
    }
    mixed
}

/// Reads the codes of a group; `None` if the finger does not have it.
#[inline(always)]
fn read(codes: &Codes, group: usize) -> Option<Group> {
    let two = |low: Code, high: Code| u32::from(low.0) | u32::from(high.0) << 16;
    Some(match group.checked_sub(ROWS) {
        None => {
            let [a, b, c, d] = codes.taxels.as_ref()?.lit.get(group)?;
            [two(*a, *b), two(*c, *d)]
        }
        Some(sensor) => {
            let Midpoints { a, b, c, d } = codes.bridges.get(sensor)?.as_ref()?;
            [two(*a, *b), two(*c, *d)]
        }
    })
}

/// Returns the bits of the channels that a finger has.
fn present(codes: &Codes) -> u32 {
    let rows = if codes.taxels.is_some() { TAXELS } else { 0 };
    let sensors = codes.bridges.iter().enumerate().filter(|(_, sensor)| sensor.is_some());
    sensors.fold(rows, |present, (i, _)| present | ALL << (COLS * (ROWS + i)))
}

/// Returns the number of ones. Inlined each use would take 40 bytes of flash.
#[inline(never)]
fn ones(bits: u32) -> u32 {
    bits.count_ones()
}

/// Longest rests before this lesson, and in it.
#[derive(Clone, Copy, Debug, Default)]
struct Longest {
    before: u16,
    now: u16,
}

impl Longest {
    fn of_all(self) -> u32 {
        self.before.max(self.now).into()
    }

    fn learn(&mut self, rest: u32) {
        self.now = self.now.max(rest as u16);
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
    use crate::condition::{BridgeBias, NOISE_FLOOR, TaxelBias};
    use crate::scan::{TAXELS, TaxelCodes};

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
        bias: Bias,
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
            let of_codes = |codes: f32| (noise * codes.sqrt() / 32_760.0).max(NOISE_FLOOR);
            let taxels = TaxelBias { level: [0.0; TAXELS], noise: of_codes(2.0) };
            let sensor = BridgeBias { level: [0.0; 3], noise: of_codes(2.67) };
            let bias = Bias { taxels: Some(taxels), bridges: [Some(sensor); SENSORS] };
            Self { bias, noise, random, watch: StuckWatch::default(), scans: 0, held, last }
        }

        /// Code of a channel that moved by `by` codes.
        fn code(&mut self, channel: usize, by: f32) -> Code {
            let rest = 9_000.0 + 101.37 * channel as f32;
            let read = rest + by + self.noise * noise(&mut self.random);
            self.held[channel].unwrap_or(Code((read + 0.5) as u16))
        }

        /// Health found in the next scan, whose taxels see `light` and all feel `force`.
        fn next(&mut self, light: f32, force: f32) -> Health {
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

        fn give(&mut self, codes: Codes) -> Health {
            self.last = codes;
            self.scans += 1;
            let clips = |code: Code| codes.full_scale.clips(code);
            let mut health = Health::SOUND;
            let flooded = clips(codes.taxels.unwrap().lit[0][0]);
            self.watch.update(&codes, flooded, &self.bias, &mut health);
            health
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
        fn until(&mut self, expected: Health) -> u32 {
            (1..20_000).find(|_| self.next(0.0, 0.0) == expected).unwrap()
        }

        /// Scans of `count` with a flag.
        fn flagged(&mut self, count: u32, light: impl Fn(u32) -> f32) -> u32 {
            (0..count).map(|_| u32::from(self.next(light(self.scans), 0.0) != Health::SOUND)).sum()
        }
    }

    fn stuck(channel: usize) -> Health {
        match channel.checked_sub(TAXELS) {
            None => Health { dead: 1 << channel, ..Health::SOUND },
            Some(i) => Health { bridge_faults: 1 << (i / COLS), ..Health::SOUND },
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
                assert!(finger.until(Health::SOUND) <= 60, "channel {channel}");
                assert_eq!(finger.flagged(3_000, |_| 0.0), 0);
            }
        }
    }

    #[test]
    fn stuck_channel_of_a_loud_finger_is_flagged_in_40_scans() {
        for noise in [2.4, 4.0, 6.0] {
            let mut late = 0;
            for channel in 0..CHANNELS {
                let mut finger = Fingertip::new(noise, 1 + channel as u32);
                assert_eq!(finger.flagged(30_000, |_| 0.0), 0);
                finger.hold(channel);
                late += usize::from(finger.until(stuck(channel)) > 40);
            }
            assert!(late <= 1, "noise of {noise}: {late} of {CHANNELS}");
        }
    }

    #[test]
    fn stuck_row_column_and_sensor_are_flagged() {
        let row = ([4, 5, 6, 7], Health { dead: 0b1111 << 4, ..Health::SOUND });
        let column = ([1, 5, 9, 13], Health { dead: 0x2222, ..Health::SOUND });
        let sensor = ([20, 21, 22, 23], Health { bridge_faults: 0b10, ..Health::SOUND });
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
        for noise in [0.3, 0.5, 1.0, 1.4, 2.0, 2.4, 5.0] {
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
        for noise in [0.5, 1.0, 1.4, 2.0, 2.4] {
            let flagged = Fingertip::new(noise, 1).flagged(200_000, flicker);
            assert_eq!(flagged, 0, "noise of {noise}");
        }
    }

    #[test]
    fn third_repetition_freezes_scan_until_another_comes() {
        const ALL: Health = Health { dead: u16::MAX, bridge_faults: 0b1111, ..Health::SOUND };
        let mut finger = sound();
        let frozen = finger.last;
        for repeated in 1..1000 {
            let expected = if repeated < 3 { Health::SOUND } else { ALL };
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
        assert_eq!(flags.last(), Some(Health { bridge_faults: 0, ..ALL }));
    }

    #[test]
    fn held_rows_and_recordings_without_noise_are_not_flagged() {
        // Each scan given ten times.
        let mut finger = Fingertip::new(1.4, 1);
        for _ in 0..10_000 {
            assert_eq!(finger.next(0.0, 0.0), Health::SOUND);
            let held = finger.last;
            (0..9).for_each(|_| assert_eq!(finger.give(held), Health::SOUND));
        }
        // Half a second of rest, then presses and holds of a second.
        let mut finger = Fingertip::new(0.0, 1);
        for i in 0..20_000u32 {
            let t = i as f32 * 1e-3;
            let force = if t < 0.5 || i / 1000 % 2 == 0 { 0.0 } else { 900.0 * (3.0 * t).sin() };
            assert_eq!(finger.next(0.0, force), Health::SOUND, "{i}");
        }
    }

    #[test]
    fn repetitions_and_faults_at_the_start_do_not_blind_the_watch() {
        let mut finger = Fingertip::new(1.4, 1);
        let dark = finger.last;
        (0..20).for_each(|_| assert_eq!(finger.give(dark), Health::SOUND));
        finger.held[6] = Some(Code(9_600));
        assert!(finger.until(stuck(6)) < 600);
        finger.hold(5);
        assert!(finger.until(Health { dead: 0b110_0000, ..Health::SOUND }) < 2000);
        finger.held = [None; CHANNELS];
        finger.until(Health::SOUND);
        assert_eq!(finger.flagged(100_000, |_| 0.0), 0);
        finger.hold(5);
        assert!(finger.until(stuck(5)) <= 60);
    }

    #[test]
    fn channel_at_a_rail_or_stuck_does_not_hide_its_neighbours() {
        for code in [0, 9_600, 8 * 4095] {
            let mut finger = sound();
            finger.held[6] = Some(Code(code));
            (0..40_000).for_each(|_| _ = finger.next(0.0, 0.0));
            let known = finger.next(0.0, 0.0).dead;
            for neighbour in [5, 9] {
                finger.hold(neighbour);
                let both = Health { dead: known | 1 << neighbour, ..Health::SOUND };
                assert!(finger.until(both) <= 60, "{code}: {neighbour}");
                finger.held[neighbour] = None;
                finger.until(Health { dead: known, ..Health::SOUND });
            }
        }
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
            assert_eq!(finger.give(flooded), Health::SOUND);
        }
    }

    #[test]
    fn matrix_or_sensors_at_rest_together_are_sound() {
        for at_rest in [0..TAXELS, TAXELS..CHANNELS] {
            let mut finger = Fingertip::new(1.4, 1);
            finger.held[at_rest.clone()].fill(Some(Code(9_600)));
            assert_eq!(finger.flagged(20_000, |_| 0.0), 0, "channels {at_rest:?}");
        }
    }
}
