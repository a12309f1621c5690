//! Filters of a finger's signals against lag and drift.
//!
//! In contact every signal is compensated in every scan. While nothing touches no estimate needs
//! that: the filters then only follow, a part of the signals a scan.

use crate::calibration::Calibration;
use crate::condition::{
    Bias, Drift, DriftCompensation, Health, LAG_PARTS, LagCompensation, LagState, LowPassState,
    Signals, TaxelLevels,
};
use crate::frame::Status;
use crate::scan::ROWS;
use crate::units::Micros;

/// Scans in which a part of the lag and a row of the drift have their turn; the third has none.
const STRIDE: u8 = 3;
/// Scans until each part and each row has had its turn.
const TURNS: u8 = STRIDE * LAG_PARTS as u8;
const _: () = assert!(LAG_PARTS == ROWS);

/// State of the filters, which forget the signals when the bias changes.
#[derive(Clone, Debug, Default)]
pub(super) struct Filters {
    pub(super) drift: Drift,
    pub(super) lag: LagState,
    pub(super) smooth: LowPassState,
    /// Part whose turn it is to be followed.
    turn: u8,
}

impl Filters {
    /// Follows signals while nothing touches, `passed` microseconds after the last scan.
    #[inline(never)]
    pub(super) fn follow(
        &mut self,
        record: &Calibration,
        drifts: Option<&DriftCompensation>,
        (signals, bias): (&Signals, &Bias),
        passed: u32,
    ) {
        let turn = self.turn;
        self.turn = if turn + 1 < TURNS { turn + 1 } else { 0 };
        let (part, step) = (usize::from(turn / STRIDE), turn % STRIDE);
        if let Some(lag) = record.lag() {
            lag.listen(&mut self.lag, passed, signals, (step == 0).then_some(part));
        }
        if step == 1
            && let (Some(drifts), Some(c), Some(bias)) = (drifts, &signals.taxels, &bias.taxels)
        {
            let passed = passed.saturating_mul(TURNS.into());
            drifts.follow(&mut self.drift, part, c, bias, passed);
        }
    }

    /// Freezes the drift in contact.
    pub(super) fn freeze(&mut self, now: Micros) {
        self.drift.freeze(now);
        self.turn = 0;
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
    let sound = signals.health == Health::SOUND && signals.taxels.is_some();
    record?.drift().filter(|_| sound)
}

/// Takes a drift of the light off the signals. Returns the taxels' signals as they were, whether
/// the others exceed the threshold, and whether the drift is small enough for one. A separate
/// function, because few scans need it.
#[cold]
#[inline(never)]
pub(super) fn without_drift(
    drifts: &DriftCompensation,
    drift: &Drift,
    (signals, bias): (&mut Signals, &Bias),
    factor2: f32,
    now: Micros,
) -> (Option<TaxelLevels>, bool, bool) {
    let whole = signals.taxels;
    let (Some(c), Some(taxels)) = (&mut signals.taxels, &bias.taxels) else {
        return (whole, true, false);
    };
    let possible = drifts.remove(drift, c, taxels, factor2, now);
    (whole, bias.exceeded(signals, factor2), possible)
}

/// Returns a time between scans in steps of 5 µs. A microsecond of rounding in the times of a board
/// must not change a bit of a frame.
pub(super) fn steady(passed: u32) -> u32 {
    passed.saturating_add(2) / 5 * 5
}
