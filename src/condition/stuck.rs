//! Detection of channels whose code does not change while the others' do.
//!
//! A reading that sums several conversions never rests on one code, because its own noise is some
//! codes wide. A channel that keeps one code over a whole window is not being read, however
//! plausible its code. The noise of a single conversion is less than a code, so that a sound
//! channel may rest for a while; its window is longer. Nothing is reported while too few of the
//! others move, as in a recording without noise.

use crate::scan::{COLS, Codes, Midpoints, ROWS, SENSORS};
use crate::units::{Code, FullScale};

/// Four channels compared in the same scan: a row of taxels, or a sensor.
type Group = [Code; COLS];
const GROUPS: usize = ROWS + SENSORS;
/// Mask of a group's channels.
const ALL: u32 = (1 << COLS) - 1;
/// Scans in a window of readings that sum conversions: each group is compared 32 times.
const WINDOW: u16 = 32 * GROUPS as u16;
/// Scans in a window of single conversions: each group is compared 512 times.
///
/// With a noise of a quarter of a code, half that of the worst such converter, a channel in the
/// middle of its code moves in one of 22 scans.
const LONG_WINDOW: u16 = 16 * WINDOW;

/// State of the detector. Each scan compares one group: four comparisons.
#[derive(Clone, Debug)]
pub struct StuckWatch {
    seen: u16,
    first: [Option<Group>; GROUPS],
    /// Bits of the channels, taxels first, then the midpoints.
    moved: u32,
    present: u32,
    stuck: u32,
}

impl Default for StuckWatch {
    fn default() -> Self {
        Self { seen: 0, first: [None; GROUPS], moved: 0, present: 0, stuck: 0 }
    }
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
    /// Processes one scan and returns the stuck channels of the last full window.
    pub fn update(&mut self, codes: &Codes) -> Stuck {
        let single = codes.full_scale.top() <= FullScale::BITS_12.top();
        let window = if single { LONG_WINDOW } else { WINDOW };
        let group = usize::from(self.seen) % GROUPS;
        // A group that has moved as a whole, as a sound one does at once, needs no more
        // comparisons.
        if self.moved >> (COLS * group) & ALL != ALL {
            self.compare(codes, group);
        }
        self.seen += 1;
        if self.seen >= window {
            const TAXELS: u32 = 0xffff;
            let stuck = self.judged(TAXELS) | self.judged(!TAXELS);
            *self = Self { stuck, ..Self::default() };
        }
        if self.stuck == 0 {
            return Stuck::default();
        }
        let [low, high, midpoints @ ..] = self.stuck.to_le_bytes();
        let mut bridges = 0;
        for (i, midpoints) in midpoints.iter().flat_map(|two| [two & 15, two >> 4]).enumerate() {
            bridges |= u8::from(midpoints != 0) << i;
        }
        Stuck { taxels: u16::from_le_bytes([low, high]), bridges }
    }

    fn compare(&mut self, codes: &Codes, group: usize) {
        let (Some(now), Some(first)) = (read(codes, group), self.first.get_mut(group)) else {
            return;
        };
        let first = *first.get_or_insert(now);
        let highest = u32::from(codes.full_scale.clipped().0) - 1;
        let mut moved = 0;
        for (i, (now, first)) in now.into_iter().zip(first).enumerate() {
            let [now, first] = [now, first].map(|code| u32::from(code.0));
            // A code at a rail may rest there, because other flags report it. Each comparison
            // yields a sign bit.
            let signs =
                (now ^ first).wrapping_neg() | now.wrapping_sub(1) | highest.wrapping_sub(now);
            moved |= signs >> 31 << i;
        }
        self.present |= ALL << (COLS * group);
        self.moved |= moved << (COLS * group);
    }

    /// Returns the stuck channels in `kind`. If fewer than three quarters moved, it only clears
    /// those that did.
    fn judged(&self, kind: u32) -> u32 {
        let (present, moved) = (self.present & kind, self.moved & kind);
        let suspects = if 4 * moved.count_ones() >= 3 * present.count_ones() {
            present
        } else {
            self.stuck & kind
        };
        suspects & !moved
    }
}

fn read(codes: &Codes, group: usize) -> Option<Group> {
    if group < ROWS {
        return codes.taxels.as_ref()?.lit.get(group).copied();
    }
    let Midpoints { a, b, c, d } = codes.bridges.get(group - ROWS).copied().flatten()?;
    Some([a, b, c, d])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::TaxelCodes;

    /// Codes of scan `t` of a finger; all alternate but those in `still`.
    fn codes(t: usize, still: &[usize]) -> Codes {
        let code = |k: usize| {
            let wobble = if still.contains(&k) { 0 } else { (t / GROUPS + k) as u16 % 3 };
            Code(20_000 + 100 * k as u16 + wobble)
        };
        let lit = core::array::from_fn(|r| core::array::from_fn(|c| code(COLS * r + c)));
        let bridges = core::array::from_fn(|s| {
            let [a, b, c, d] = core::array::from_fn(|i| code(16 + 4 * s + i));
            Some(Midpoints { a, b, c, d })
        });
        Codes {
            full_scale: FullScale::BITS_16,
            taxels: Some(TaxelCodes { lit, dark: [Code(900); COLS] }),
            bridges,
            reference: None,
            temperature: None,
        }
    }

    fn after(scans: usize, codes: impl Fn(usize) -> Codes) -> Stuck {
        let mut watch = StuckWatch::default();
        (0..scans).fold(Stuck::default(), |_, t| watch.update(&codes(t)))
    }

    #[test]
    fn resting_channel_is_stuck_after_one_window() {
        let stuck = Stuck { taxels: 1 << 6, bridges: 1 << 2 };
        let window = usize::from(WINDOW);
        assert_eq!(after(window, |t| codes(t, &[6, 16 + 4 * 2 + 3])), stuck);
        assert_eq!(after(window - 1, |t| codes(t, &[6])), Stuck::default());
    }

    #[test]
    fn moving_channel_is_cleared_after_one_window() {
        let window = usize::from(WINDOW);
        let freed = |t| codes(t, if t < window { &[6] } else { &[] });
        assert_eq!(after(2 * window - 1, freed).taxels, 1 << 6);
        assert_eq!(after(2 * window, freed), Stuck::default());
    }

    #[test]
    fn finger_at_rest_is_not_stuck() {
        let all: [usize; 32] = core::array::from_fn(|k| k);
        assert_eq!(after(2000, |t| codes(t, &all)), Stuck::default());
        // A pause does not clear a stuck channel either.
        let window = usize::from(WINDOW);
        let rests = |t| codes(t, if t < window { &[6][..] } else { &all });
        assert_eq!(after(3 * window, rests).taxels, 1 << 6);
    }

    #[test]
    fn single_conversion_must_rest_for_longer() {
        let twelve = |t| {
            let mut codes = Codes { full_scale: FullScale::BITS_12, ..codes(t, &[6]) };
            for code in codes.taxels.iter_mut().flat_map(|taxels| taxels.lit.as_flattened_mut()) {
                code.0 -= 19_000;
            }
            codes
        };
        let window = usize::from(LONG_WINDOW);
        assert_eq!(after(window - 1, twelve), Stuck::default());
        assert_eq!(after(window, twelve).taxels, 1 << 6);
        // A sum of eight has a window of the usual length.
        let eight = FullScale::new(8 * 4095).unwrap();
        let eight = |t| Codes { full_scale: eight, ..codes(t, &[6]) };
        assert_eq!(after(usize::from(WINDOW), eight).taxels, 1 << 6);
    }

    #[test]
    fn rail_codes_are_not_stuck() {
        let railed = |t| {
            let mut codes = codes(t, &[]);
            if let Some(taxels) = &mut codes.taxels {
                taxels.lit[1][1] = Code(65_535);
                taxels.lit[2][1] = Code(0);
            }
            codes
        };
        assert_eq!(after(2000, railed), Stuck::default());
    }
}
