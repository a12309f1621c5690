//! Contact gate with hysteresis, a cheap test that decides whether costlier estimators run.
//!
//! A single scan is not enough, because one bad code or a flash of light can cause it. A pattern
//! that neither can cause opens the gate at once ([`unmistakable`]). A tap may reach a third of a
//! newton by its second scan.

use serde::{Deserialize, Serialize};

use crate::scan::{COLS, TAXELS};

/// Factor on the threshold `on` for opening at once by [`unmistakable`] activity.
const AT_ONCE: f32 = 2.0;

/// Contact gate: thresholds on the signals' root mean square, in units of their noise.
///
/// The root mean square of 16 noisy taxels is 1 ± 0.18, so that noise alone does not reach 6. The
/// margin is for drift that is not followed yet, and for fewer samples a reading than when the bias
/// was taken.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gate {
    /// Threshold above which contact begins.
    pub on: f32,
    /// Threshold below which contact ends.
    pub off: f32,
    /// Consecutive scans required to begin a contact.
    pub begin_frames: u8,
    /// Consecutive scans required to end a contact.
    pub end_frames: u8,
}

impl Default for Gate {
    fn default() -> Self {
        Self { on: 6.0, off: 4.0, begin_frames: 2, end_frames: 4 }
    }
}

/// State of the gate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GateState {
    contact: bool,
    streak: u8,
}

impl GateState {
    /// Returns whether the gate is open.
    #[must_use]
    pub fn contact(&self) -> bool {
        self.contact
    }
}

impl Gate {
    /// Returns the threshold of the next scan, squared.
    #[must_use]
    #[inline]
    pub fn threshold(&self, state: &GateState) -> f32 {
        let threshold = if state.contact { self.off } else { self.on };
        threshold * threshold
    }

    /// Processes one scan and returns whether the gate is open. `activity` is the **squared** root
    /// mean square of the signals over the squared noise.
    #[inline]
    pub fn update(&self, state: &mut GateState, activity: f32) -> bool {
        self.step(state, activity > self.threshold(state))
    }

    /// Processes one scan, which is `above` the [`Self::threshold`] or not.
    #[inline]
    fn step(&self, state: &mut GateState, above: bool) -> bool {
        let against = above != state.contact;
        let needed = if state.contact { self.end_frames } else { self.begin_frames };
        state.streak = if against { state.streak.saturating_add(1) } else { 0 };
        if against && state.streak >= needed {
            state.contact = !state.contact;
            state.streak = 0;
        }
        state.contact
    }

    /// Processes one scan, which is `above` the [`Self::threshold`] or not, and opens the gate at
    /// once on unmistakable activity. The closure returns that activity; it is called only if a
    /// contact may begin.
    pub fn update_at_once(
        &self,
        state: &mut GateState,
        above: bool,
        unmistakable: impl FnOnce() -> f32,
    ) -> bool {
        let on = AT_ONCE * self.on;
        if !self.step(state, above) && state.streak > 0 && unmistakable() > on * on {
            *state = GateState { contact: true, streak: 0 };
        }
        state.contact
    }
}

/// Returns the mean square that only a touch can cause, over the squared noise.
///
/// A bad code spoils a taxel, or a whole column if it is a dark code. The column with the largest
/// effect is therefore left out. Ambient light that changes within a scan shifts whole rows,
/// because a row is read at once. The common part of a row's other taxels is therefore subtracted.
/// A touch causes neither.
#[must_use]
#[cold]
#[inline(never)]
pub fn unmistakable(signals: &[f32; TAXELS], noise: f32) -> f32 {
    const FREEDOM: f32 = (TAXELS / COLS * (COLS - 2)) as f32;
    const OTHERS: f32 = (COLS - 1) as f32;
    // Spread of the rows without each of the columns.
    let mut spread = [0.0; COLS];
    for row in signals.as_chunks::<COLS>().0 {
        let (sum, squares) =
            row.iter().fold((0.0, 0.0), |(sum, squares), c| (sum + c, squares + c * c));
        for (spread, c) in spread.iter_mut().zip(row) {
            let others = sum - c;
            *spread += squares - c * c - others * others * (1.0 / OTHERS);
        }
    }
    let least = spread.into_iter().fold(f32::MAX, |least, of| if of < least { of } else { least });
    let noise = FREEDOM * noise * noise;
    if noise > 0.0 { least / noise } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: f32 = 1e-4;

    /// Returns whether the gate opens with the first scan of these signals.
    fn at_once(signals: [f32; TAXELS]) -> bool {
        let square = signals.iter().map(|c| c * c).sum::<f32>() / (16.0 * NOISE * NOISE);
        let gate = Gate::default();
        assert!(square > gate.on * gate.on, "not enough for any frame");
        gate.update_at_once(&mut GateState::default(), true, || unmistakable(&signals, NOISE))
    }

    /// A dent around a position in pitches.
    fn dent(depth: f32, x: f32, y: f32) -> [f32; TAXELS] {
        core::array::from_fn(|k| {
            let (dx, dy) = ((k % COLS) as f32 - x, (k / COLS) as f32 - y);
            -depth / (1.0 + dx * dx + dy * dy)
        })
    }

    #[test]
    fn dent_opens_the_gate_at_once_anywhere() {
        for (x, y) in [(1.5, 1.5), (0.0, 0.0), (3.0, 1.0), (1.0, 2.5)] {
            assert!(at_once(dent(0.02, x, y)), "{x} {y}");
        }
    }

    #[test]
    fn slight_touch_must_last() {
        for depth in [2.5e-3, 6e-3] {
            assert!(!at_once(dent(depth, 1.5, 1.5)), "{depth}");
        }
    }

    #[test]
    fn bad_code_must_last() {
        for k in 0..TAXELS {
            let mut lit = [0.0; TAXELS];
            lit[k] = -1.0;
            assert!(!at_once(lit), "taxel {k}");
        }
        for column in 0..COLS {
            let dark = core::array::from_fn(|k| if k % COLS == column { 1.0 } else { 0.0 });
            assert!(!at_once(dark), "column {column}");
        }
    }

    #[test]
    fn light_step_within_a_scan_must_last() {
        for rows in 1..=TAXELS / COLS {
            let flash = core::array::from_fn(|k| if k / COLS >= rows - 1 { -0.3 } else { 0.0 });
            assert!(!at_once(flash), "{rows}");
        }
    }

    #[test]
    fn one_noisy_scan_is_not_a_contact() {
        let gate = Gate::default();
        let mut state = GateState::default();
        assert!(!gate.update(&mut state, 1e4));
        assert!(!gate.update(&mut state, 1.0));
        assert!(!gate.update(&mut state, 1e4));
        assert!(gate.update(&mut state, 1e4));
    }

    #[test]
    fn signal_between_thresholds_does_not_chatter() {
        let gate = Gate::default();
        let mut state = GateState::default();
        let between = 5.0f32 * 5.0;
        assert!(!(0..100).any(|_| gate.update(&mut state, between)));
        gate.update(&mut state, 1e4);
        gate.update(&mut state, 1e4);
        assert!((0..100).all(|_| gate.update(&mut state, between)));
        let ended: std::vec::Vec<bool> =
            (0..gate.end_frames).map(|_| !gate.update(&mut state, 1.0)).collect();
        assert_eq!(ended, [false, false, false, true]);
    }

    #[test]
    fn activity_is_asked_only_if_contact_may_begin() {
        let gate = Gate::default();
        let mut state = GateState::default();
        let needless = || -> f32 { panic!("a scan without a touch pays for it") };
        assert!(!gate.update_at_once(&mut state, false, needless));
        assert!(gate.update_at_once(&mut state, true, || 1e4));
        let mut open = |above| gate.update_at_once(&mut state, above, needless);
        assert!(open(true));
        assert_eq!([false; 5].map(&mut open), [true, true, true, false, false]);
    }
}
