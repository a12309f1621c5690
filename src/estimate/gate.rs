//! Contact gate with hysteresis: the cheap question that decides whether anything dearer runs.

use serde::{Deserialize, Serialize};

/// Thresholds on the signals' root mean square, in units of their noise.
///
/// Of 16 noisy taxels the root mean square is 1 ± 0.18, so that 8 is no noise at all; what the margin
/// pays for is slow drift. On the reference fingertip 8 corresponds to about 6 mN.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gate {
    /// Contact begins above this.
    pub on: f32,
    /// Contact ends below this.
    pub off: f32,
    /// Frames in a row that it takes to begin.
    pub begin_frames: u8,
    /// Frames in a row that it takes to end.
    pub end_frames: u8,
}

impl Default for Gate {
    fn default() -> Self {
        Self { on: 8.0, off: 5.0, begin_frames: 2, end_frames: 4 }
    }
}

/// What the gate remembers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GateState {
    contact: bool,
    streak: u8,
}

impl GateState {
    /// The last verdict.
    #[must_use]
    pub fn contact(&self) -> bool {
        self.contact
    }
}

impl Gate {
    /// One frame. `activity` is the **squared** root mean square of the signals over the squared noise.
    pub fn update(&self, state: &mut GateState, activity: f32) -> bool {
        let (against, needed) = if state.contact {
            (activity < self.off * self.off, self.end_frames)
        } else {
            (activity > self.on * self.on, self.begin_frames)
        };
        state.streak = if against { state.streak.saturating_add(1) } else { 0 };
        if against && state.streak >= needed {
            state.contact = !state.contact;
            state.streak = 0;
        }
        state.contact
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_noisy_frame_is_no_contact() {
        let gate = Gate::default();
        let mut state = GateState::default();
        assert!(!gate.update(&mut state, 1e4));
        assert!(!gate.update(&mut state, 1.0));
        assert!(!gate.update(&mut state, 1e4));
        assert!(gate.update(&mut state, 1e4));
    }

    #[test]
    fn a_signal_between_the_thresholds_does_not_chatter() {
        let gate = Gate::default();
        let mut state = GateState::default();
        let between = 6.5f32 * 6.5;
        assert!(!(0..100).any(|_| gate.update(&mut state, between)));
        gate.update(&mut state, 1e4);
        gate.update(&mut state, 1e4);
        assert!((0..100).all(|_| gate.update(&mut state, between)));
        let ended: std::vec::Vec<bool> =
            (0..gate.end_frames).map(|_| !gate.update(&mut state, 1.0)).collect();
        assert_eq!(ended, [false, false, false, true]);
    }
}
