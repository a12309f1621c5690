//! Filters of a finger's signals against lag and drift.
//!
//! In contact every signal is compensated in every scan. While nothing touches no estimate needs
//! that: the filters then only follow, a part of the signals a scan.

use crate::calibration::Calibration;
use crate::condition::{
    Bias, Drift, DriftCompensation, Health, LAG_PARTS, LagCompensation, LagState, LowPassState,
    Signals,
};
use crate::frame::Status;
use crate::scan::ROWS;

/// Scans in which a part of the lag, a row of the drift and, once, the bias have their turn.
const STRIDE: u8 = 3;
/// Scans until each part and each row has had its turn.
const TURNS: u8 = STRIDE * LAG_PARTS as u8;
const _: () = assert!(LAG_PARTS == ROWS);
/// Time in microseconds in which the bias follows a drift.
const SLOWLY: u32 = 2_000_000;
/// Time in microseconds after a contact from which the bias follows. Until then the skin recovers.
const RESTED: u32 = 1_500_000;

/// State of the filters, which forget the signals when the bias changes.
#[derive(Clone, Debug, Default)]
pub(super) struct Filters {
    pub(super) drift: Drift,
    pub(super) lag: LagState,
    pub(super) smooth: LowPassState,
    /// Part whose turn it is to be followed.
    turn: u8,
    /// Microseconds since the last contact.
    rest: u32,
}

impl Filters {
    /// Follows signals while nothing touches, `passed` microseconds after the last scan.
    #[inline(never)]
    pub(super) fn follow(
        &mut self,
        record: &Calibration,
        drifts: Option<&DriftCompensation>,
        (signals, bias): (&Signals, &mut Bias),
        passed: u32,
    ) {
        let turn = self.turn;
        self.turn = if turn + 1 < TURNS { turn + 1 } else { 0 };
        let (part, step) = (usize::from(turn / STRIDE), turn % STRIDE);
        if let Some(lag) = record.lag() {
            lag.listen(&mut self.lag, passed, signals, (step == 0).then_some(part));
        }
        if step != 1 && turn != TURNS - 1 {
            return;
        }
        let Some(drifts) = drifts else { return };
        let passed = passed.saturating_mul(TURNS.into()).min(SLOWLY);
        if turn == TURNS - 1 {
            if self.rest < RESTED {
                self.rest += passed;
            } else {
                let share = passed as f32 * (1.0 / SLOWLY as f32);
                bias.follow(signals, share);
                self.drift.followed(share);
            }
        } else if let (Some(c), Some(bias)) = (&signals.taxels, &bias.taxels) {
            drifts.follow(&mut self.drift, part, c, bias, passed);
        }
    }

    /// Freezes the drift in contact.
    pub(super) fn freeze(&mut self) {
        self.drift.freeze();
        (self.turn, self.rest) = (0, 0);
    }

    /// Compensates the lag of the signals, `passed` microseconds after the last scan, or not if
    /// they are not `needed`.
    #[inline(always)]
    pub(super) fn compensate(
        &mut self,
        record: &Calibration,
        signals: &mut Signals,
        passed: u32,
        needed: bool,
        status: &mut Status,
    ) {
        self.drift.hold(passed);
        if let Some(lag) = record.lag()
            && (needed || !LagCompensation::skip(&mut self.lag, passed))
        {
            lag.advance(&mut self.lag, passed, signals);
            status.insert(Status::RAN_LAG);
        }
    }
}

/// Returns the compensation of the drift if all channels are sound.
pub(super) fn drifts<'c>(
    record: Option<&'c Calibration>,
    signals: &Signals,
) -> Option<&'c DriftCompensation> {
    record?.drift().filter(|_| signals.health == Health::SOUND)
}

/// Judges signals above the threshold without a drift of the light, unless a force sensor alone
/// exceeds it. Returns whether a signal still exceeds the threshold, and whether the drift is small
/// enough for one. A separate function, because few scans need it.
#[cold]
#[inline(never)]
pub(super) fn without_drift(
    drifts: &DriftCompensation,
    drift: &Drift,
    signals: &Signals,
    bias: &Bias,
    factor2: f32,
) -> (bool, bool) {
    let drifted = drift.of_sensors();
    if bias.sensor_exceeded(signals, factor2, drifted * drifted) {
        return (true, true);
    }
    let (Some(mut c), Some(taxels)) = (signals.taxels, &bias.taxels) else {
        return (false, true);
    };
    let deny = signals.bridges.iter().any(Option::is_some);
    let possible = drifts.remove(&mut c, taxels, factor2, drifts.most(drift, deny));
    (taxels.exceeded(&c, 0, factor2), possible)
}

/// Returns a time between scans in steps of 5 µs. A microsecond of rounding in the times of a board
/// must not change a bit of a frame.
pub(super) fn steady(passed: u32) -> u32 {
    passed.saturating_add(2) / 5 * 5
}
