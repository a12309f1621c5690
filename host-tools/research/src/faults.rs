//! Faults of single channels, of groups of channels and of whole scans, injected into codes.
//!
//! A fault changes the codes of a sound finger. The change is a function of the scan's number and
//! codes, so that a sound and a faulty run differ by the fault alone.

mod codes;
mod kinds;

pub(crate) use codes::{CHANNELS, Flat, brighten, flat, shift, unflat};
pub(crate) use kinds::{Change, Class, KINDS, Kind, Place};

use codes::{ARMS, DARK, REFERENCE};
use taxel::scan::{COLS, ROWS, SENSORS, TAXELS};

/// Step of a floating input's random walk in one scan, as a share of full scale.
const WALK: f64 = 0.005;
/// Length in scans of the bursts of an intermittent fault, and the share of them that are faulty.
const BURST: usize = 8;
const BURST_SHARE: f64 = 0.25;
/// Scans a second.
pub(crate) const RATE_HZ: f64 = 4000.0;

/// Sound codes of a finger, from which a fault starts.
#[derive(Clone, Debug)]
pub(crate) struct Sound {
    /// Codes of the scan in which the fault starts.
    pub held: Flat,
    /// Standard deviation of each channel at rest, in codes.
    pub sigma: [f64; CHANNELS],
    /// Highest code.
    pub top: u16,
}

/// One fault at one place from one scan on.
#[derive(Clone, Debug)]
pub(crate) struct Fault {
    kind: Kind,
    /// Channels of the place, and those of its neighbour.
    own: Vec<usize>,
    other: Vec<usize>,
    onset: usize,
    sound: Sound,
    /// Levels of a floating input, a value a scan.
    walk: Vec<f64>,
}

impl Fault {
    /// Creates the fault at place `index`, from scan `onset` on, for `scans` scans.
    pub fn new(kind: Kind, index: usize, [onset, scans]: [usize; 2], sound: Sound) -> Self {
        let own = kind.place.channels(index);
        let other = kind.place.channels(kind.neighbour(index));
        let first = own.first().copied().unwrap_or_default();
        let top = f64::from(sound.top);
        let mut level = f64::from(sound.held[first]);
        let floats = kind.change == Change::Floating;
        let walk = (0..if floats { scans } else { 0 }).map(|n| {
            level += WALK * top * normal(first, n);
            // The rails reflect it.
            level = (top - (top - level.abs()).abs()).clamp(0.0, top);
            level
        });
        let walk = walk.collect();
        Self { kind, own, other, onset, sound, walk }
    }

    /// Returns the codes of scan `n` with the fault.
    pub fn apply(&self, n: usize, codes: &Flat) -> Flat {
        let mut faulty = *codes;
        let Some(since) = n.checked_sub(self.onset) else { return faulty };
        match self.kind.change {
            Change::Swapped | Change::Across => {
                for (own, other) in self.own.iter().zip(&self.other) {
                    (faulty[*own], faulty[*other]) = (codes[*other], codes[*own]);
                }
            }
            Change::Copied => {
                for (own, other) in self.own.iter().zip(&self.other) {
                    faulty[*own] = codes[*other];
                }
            }
            Change::AlwaysOn => self.always_on(codes, &mut faulty),
            Change::ShiftedChannels => faulty[..REFERENCE].rotate_right(1),
            Change::ShiftedRows => faulty[..TAXELS].rotate_right(COLS),
            change => {
                for k in &self.own {
                    faulty[*k] = self.one(change, *k, since, codes);
                }
            }
        }
        faulty
    }

    /// Returns the faulty code of channel `k`, which depends on that channel and its dark code
    /// alone.
    fn one(&self, change: Change, k: usize, since: usize, codes: &Flat) -> u16 {
        let (code, top) = (codes[k], f64::from(self.sound.top));
        let sigma = self.sound.sigma[k];
        let now = f64::from(code);
        let zero = zero(k, codes, top);
        let level = match change {
            Change::Held => f64::from(self.sound.held[k]),
            Change::At(share) => (share * top).round(),
            Change::Bit(bit, true) => f64::from(code | 1 << bit),
            Change::Bit(bit, false) => f64::from(code & !(1 << bit)),
            Change::Noise(times) => {
                now + (times * times - 1.0).max(0.0).sqrt() * sigma * normal(k, since)
            }
            Change::Floating => self.walk.get(since).copied().unwrap_or(now),
            Change::Offset(share) => now + share * top,
            Change::Gain(gain) => zero + gain * (now - zero),
            Change::Drift(share) => zero + (1.0 + share * since as f64 / RATE_HZ) * (now - zero),
            Change::Slide(share) => now + share * top * since as f64 / RATE_HZ,
            Change::Intermittent => {
                if uniform(k, since / BURST) < BURST_SHARE {
                    0.0
                } else {
                    now
                }
            }
            Change::Dark => zero,
            _ => now,
        };
        level.round().clamp(0.0, top) as u16
    }

    /// Adds the light of this row to every other step of its columns.
    fn always_on(&self, codes: &Flat, faulty: &mut Flat) {
        for (column, own) in self.own.iter().enumerate() {
            let light = codes[*own].saturating_sub(codes[DARK + column]);
            let steps = (0..ROWS).map(|row| row * COLS + column).chain([DARK + column]);
            for k in steps.filter(|k| k != own) {
                faulty[k] = codes[k].saturating_add(light).min(self.sound.top);
            }
        }
    }

    /// Bits of the channels that a right report names: 16 taxels, then the sensors.
    pub fn allowed(&self) -> u32 {
        let swaps = matches!(self.kind.change, Change::Swapped | Change::Across);
        self.own.iter().chain(self.other.iter().filter(|_| swaps)).fold(0, |b, k| b | bits(*k))
    }

    /// Number of channels that a right report names at least: half of those of one place.
    pub fn needed(&self) -> u32 {
        let own = self.own.iter().fold(0, |all, k| all | bits(*k));
        own.count_ones().div_ceil(2)
    }

    /// Returns whether the thermometer is the faulty channel, which a flag of its own names.
    pub fn of_thermometer(&self) -> bool {
        self.kind.place == Place::Thermometer
    }
}

/// Reading of channel `k` without its signal: the dark code, or half the supply.
fn zero(k: usize, codes: &Flat, top: f64) -> f64 {
    match k {
        0..ARMS => f64::from(codes[DARK + k % COLS]),
        ARMS..REFERENCE => top / 2.0,
        _ => 0.0,
    }
}

/// Bits by which a report names channel `k`.
fn bits(k: usize) -> u32 {
    const COLUMN: u32 = 0x1111;
    match k {
        0..DARK => 1 << k,
        DARK..ARMS => COLUMN << (k - DARK),
        ARMS..REFERENCE => 1 << (TAXELS + (k - ARMS) / SENSORS),
        _ => 0,
    }
}

/// Number in 0..1 that depends on channel and scan alone.
fn uniform(channel: usize, n: usize) -> f64 {
    // SplitMix64.
    let mut z = ((channel as u64) << 40 | n as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
}

/// Normally distributed number that depends on channel and scan alone.
fn normal(channel: usize, n: usize) -> f64 {
    let [one, other] = [2 * n, 2 * n + 1].map(|n| uniform(channel + CHANNELS, n));
    (-2.0 * (1.0 - one).ln()).sqrt() * (core::f64::consts::TAU * other).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOP: u16 = 8 * 4095;

    /// Codes that are all different and move through every bit that a fault may hold.
    fn codes(n: usize) -> Flat {
        core::array::from_fn(|k| {
            let (base, span) = match k {
                0..DARK => (4_000 + 137 * k, 6_000),
                DARK..ARMS => (3_000 + 50 * (k - DARK), 5),
                _ => (15_000 + 91 * k, 6_000),
            };
            (base + (n * 997 + k) % span) as u16
        })
    }

    fn fault(kind: Kind, index: usize) -> Fault {
        let sound = Sound { held: codes(10), sigma: [1.5; CHANNELS], top: TOP };
        Fault::new(kind, index, [10, 400], sound)
    }

    /// Channels that the fault changes in 400 scans.
    fn changed(fault: &Fault) -> Vec<usize> {
        let differs = |k: &usize| (10..410).any(|n| fault.apply(n, &codes(n))[*k] != codes(n)[*k]);
        (0..CHANNELS).filter(differs).collect()
    }

    #[test]
    fn every_kind_changes_only_its_channels() {
        for kind in KINDS.iter().copied() {
            for index in 0..kind.place.count() {
                let fault = fault(kind, index);
                assert_eq!(fault.apply(9, &codes(9)), codes(9), "{}: before", kind.name);
                let changed = changed(&fault);
                assert!(!changed.is_empty(), "{} {index} changes nothing", kind.name);
                let own = kind.place.channels(index);
                let other = kind.place.channels(kind.neighbour(index));
                let swaps = matches!(kind.change, Change::Swapped | Change::Across);
                let may = |k: &usize| own.contains(k) || swaps && other.contains(k);
                let spreads = kind.change == Change::AlwaysOn;
                assert!(spreads || changed.iter().all(may), "{} {index}: {changed:?}", kind.name);
            }
        }
    }

    #[test]
    fn names_of_kinds_differ_at_each_place() {
        assert!(KINDS.len() >= 40, "{}", KINDS.len());
        for (i, one) in KINDS.iter().enumerate() {
            let same = |other: &&Kind| other.place == one.place && other.name == one.name;
            assert!(!KINDS[..i].iter().any(|other| same(&other)), "{:?} {}", one.place, one.name);
        }
    }

    fn of(place: Place, change: Change) -> Kind {
        *KINDS.iter().find(|kind| kind.place == place && kind.change == change).unwrap()
    }

    #[test]
    fn held_code_is_that_of_the_onset() {
        let stuck = fault(of(Place::Taxel, Change::Held), 5);
        assert!((10..50).all(|n| stuck.apply(n, &codes(n))[5] == codes(10)[5]));
        let bit = fault(of(Place::Taxel, Change::Bit(10, true)), 5);
        assert_eq!(bit.apply(11, &codes(11))[5], codes(11)[5] | 1 << 10);
    }

    #[test]
    fn noise_has_its_width_and_the_walk_stays_in_range() {
        let noisy = fault(of(Place::Taxel, Change::Noise(10.0)), 2);
        let added = |n| f64::from(noisy.apply(n, &codes(n))[2]) - f64::from(codes(n)[2]);
        let square: f64 = (10..4010).map(|n| added(n) * added(n)).sum::<f64>() / 4000.0;
        assert!((square.sqrt() / 15.0 - 1.0).abs() < 0.05, "{}", square.sqrt());
        let floats = fault(of(Place::Arm, Change::Floating), 3);
        let levels: Vec<u16> = (10..410).map(|n| floats.apply(n, &codes(n))[ARMS + 3]).collect();
        assert!(levels.iter().all(|level| *level <= TOP));
        assert!(levels.windows(2).filter(|two| two[0] != two[1]).count() > 390);
    }

    #[test]
    fn gain_keeps_the_dark_code_as_its_zero() {
        let half = fault(of(Place::Taxel, Change::Gain(0.5)), 0);
        let (before, after) = (codes(20), half.apply(20, &codes(20)));
        let level = |codes: &Flat| f64::from(codes[0]) - f64::from(codes[DARK]);
        assert!((level(&after) - 0.5 * level(&before)).abs() <= 0.5);
    }

    #[test]
    fn row_that_is_always_on_loses_its_light_in_the_difference() {
        let on = fault(of(Place::Row, Change::AlwaysOn), 1);
        let (before, after) = (codes(20), on.apply(20, &codes(20)));
        let level = |codes: &Flat, k: usize| i32::from(codes[k]) - i32::from(codes[DARK + k % 4]);
        assert!((4..8).all(|k| level(&after, k) == 0));
        assert!((0..4).chain(8..16).all(|k| level(&after, k) == level(&before, k)));
    }

    #[test]
    fn right_report_names_the_channels_of_the_place() {
        let allowed = |place, change, index| fault(of(place, change), index).allowed();
        assert_eq!(allowed(Place::Taxel, Change::Held, 6), 1 << 6);
        assert_eq!(allowed(Place::Taxel, Change::Swapped, 6), 1 << 6 | 1 << 7);
        assert_eq!(allowed(Place::Row, Change::Gain(0.95), 2), 0xf00);
        assert_eq!(allowed(Place::Dark, Change::Held, 3), 0x8888);
        assert_eq!(allowed(Place::Arm, Change::Held, 7), 1 << 17);
        assert_eq!(allowed(Place::Arm, Change::Across, 7), 1 << 17 | 1 << 18);
        assert_eq!(fault(of(Place::Row, Change::Gain(0.95)), 2).needed(), 2);
    }
}
