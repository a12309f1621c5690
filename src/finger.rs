//! Estimation of one scan: codes → signals → contact gate → the estimators that the scene needs.
//!
//! ```text
//! no contact        the sensors' own forces; vibration detector (learns its noise floor)
//! normal contact    matrix: model of a normal contact     array: wrench, contact
//! shear             matrix: model with shear              … and slip
//! misfit            matrix: two contacts
//! ```
//! Estimates of matrix and array are weighted by their uncertainties. If one of them is faulty, the
//! other gives the result alone. The status names the estimators that ran.
//!
//! Not every scan needs every step ([`Wanted`]). Conditioning but for the lag, gate and vibration
//! detector run in each. Forces and slip run if a frame is due, and slip about once in a
//! millisecond in any case. The matrix then runs if the frames carry a field that needs it, or if
//! the array knows no force.

mod course;
mod filters;
mod fusion;
mod limits;
mod matrix;
mod no_contact;
mod slip;

use crate::calibration::{Calibration, CalibrationError, Range};
use crate::condition::{
    Bias, BiasRefusal, BiasTaker, Health, JumpWatch, Levels, LowPass, NoiseWatch, Signals,
    StuckWatch, Thermometer, Warm,
};
use crate::estimate::contact_point::PointMethod;
use crate::estimate::gate::{Gate, GateState, unmistakable};
use crate::estimate::slip::{Slip, Verdict};
use crate::estimate::{ContactPoint, Force, NormalContact, Uncertainty};
use crate::frame::{Fields, FrameRef, Status};
use crate::math::at_least;
use crate::measured::{Measured, NoValue};
use crate::scan::{Codes, SENSORS, Scan, TAXELS};
use crate::units::{Micros, NewtonMillimetres};
use course::Course;
use filters::{Filters, steady, without_drift};
use fusion::{ArrayEstimate, Fused};
use matrix::{MatrixState, OpticalEstimate, OpticalInput};
pub use matrix::{PLACE_ERROR, SKIN_ERROR, UNSURE_PLACE};
use no_contact::no_contact;
use slip::{Grip, GripState};

/// Coefficients of one finger, constant from scan to scan.
#[derive(Clone, Debug, Default)]
pub struct Finger {
    calibration: Option<Calibration>,
    /// Contact gate: its thresholds and frame counts.
    pub gate: Gate,
    /// Method of the contact point.
    pub point_method: PointMethod,
    /// Optional low-pass filter on the signals, before forces and contact positions.
    pub filter: Option<LowPass>,
}

/// State of one finger, carried from scan to scan.
#[derive(Clone, Debug, Default)]
pub struct FingerState {
    /// Time of the last scan.
    time: Micros,
    bias: Bias,
    biased: bool,
    gate: GateState,
    stuck: StuckWatch,
    jumps: JumpWatch,
    noise: NoiseWatch,
    faults: Faults,
    doubt: Doubt,
    thermometer: Thermometer,
    taker: Option<BiasTaker>,
    filters: Filters,
    matrix: MatrixState,
    course: Course,
    grip: GripState,
}

/// Doubt about slip, whose memories took a change of the faulty channels for a movement.
#[derive(Clone, Copy, Debug, Default)]
struct Doubt {
    /// Microseconds until it ends.
    left: u32,
    /// Whether strong light was or is a reason.
    flooded: bool,
}

impl Doubt {
    fn withhold<T>(self, value: Measured<T>) -> Measured<T> {
        let why = if self.flooded { NoValue::Saturated } else { NoValue::DeadChannel };
        if self.left > 0 { value.and(Err(why)) } else { value }
    }
}

/// Microseconds for which a change of the faulty channels leaves slip in doubt.
const DOUBTED_US: u32 = 50_000;

/// Faults of a scan that disturb slip: dead taxels in the lower half, then four bits of faulty
/// bridges, four of noisy sensors, [`FLOODED`], and the number of jumps. A channel in doubt that
/// jumps back moves its neighbours. A single clipped taxel does not disturb: its signal does not
/// jump.
type Faults = u32;

/// Bit of strong light, which clips half of the taxels or more.
const FLOODED: Faults = 1 << 24;
/// Lowest bit of the number of jumps.
const JUMPS: u32 = 25;

/// All estimates of one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Start of the scan.
    pub time: Micros,
    /// State flags, and the estimators that ran.
    pub status: Status,
    /// Conditioned signals.
    pub signals: Signals,
    /// Force on each sensor, in newtons.
    pub sensors: [Force; SENSORS],
    /// Force on the finger, in newtons.
    pub force: Force,
    /// Contact point, in millimetres from the middle of the pad.
    pub point: Measured<ContactPoint>,
    /// Slip margin, friction and required grip.
    pub slip: Measured<Verdict>,
    /// Moment about the contact's normal, in N·mm.
    pub torsion: Measured<NewtonMillimetres>,
    /// Two contacts, the stronger one first.
    pub contacts: Measured<[NormalContact; 2]>,
    /// Standard deviations of force and point, and the misfit; none without contact.
    pub uncertainty: Measured<Uncertainty>,
    /// Outcome of a requested bias, present in the scan that completes it.
    pub bias: Option<Result<(), BiasRefusal>>,
}

/// Outputs that are wanted of a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// Fields of the stream's frames.
    pub fields: Fields,
    /// Whether a frame of this scan is due.
    pub due: bool,
}

impl Wanted {
    /// A frame with every field.
    pub const ALL: Self = Self { fields: Fields::ALL, due: true };
    /// Fields that need the matrix even if the array knows the force. The matrix sees the slip
    /// annulus.
    const OPTICAL: Fields =
        Fields::POINT.union(Fields::SLIP).union(Fields::CONTACTS).union(Fields::UNCERTAINTY);
}

impl Estimate {
    /// Placeholder before the first scan.
    pub const NOTHING: Self = Self {
        time: Micros(0),
        status: Status(0),
        signals: Signals::NOTHING,
        sensors: [Force::none(NoValue::NotEstimated); SENSORS],
        force: Force::none(NoValue::NotEstimated),
        point: Err(NoValue::NotEstimated),
        slip: Err(NoValue::NotEstimated),
        torsion: Err(NoValue::NotEstimated),
        contacts: Err(NoValue::NotEstimated),
        uncertainty: Err(NoValue::NotEstimated),
        bias: None,
    };

    /// Overwrites all with what is known of a scan that was read with an LED row held on.
    #[cold]
    #[inline(never)]
    pub(crate) fn set_row_held(&mut self, scan: &Scan) {
        *self = Self { time: scan.time, status: Status::ROW_HELD, ..Self::NOTHING };
        flag(&mut self.status, Status::OVERRUN, scan.lost > 0);
    }

    /// Returns the frame of this estimate of `codes`, with the requested fields.
    #[must_use]
    pub fn frame<'e>(&'e self, codes: &'e Codes, seq: u32, fields: Fields) -> FrameRef<'e> {
        macro_rules! frame {
            (
                head {
                    codes: $codes:ty = CODES $bit:tt $about:literal $more:tt
                    $($head:ident: $type:ty = $HEAD:ident $head_bit:tt $meaning:literal $head_about:tt)*
                }
                tail { $($tail:ident: $last:ty = $TAIL:ident $at:tt $last_meaning:literal $last_about:tt)* }
            ) => {
                FrameRef {
                    seq,
                    time: self.time,
                    status: self.status,
                    codes: fields.contains(Fields::CODES).then_some(codes),
                    $($head: fields.contains(Fields::$HEAD).then_some(&self.$head),)*
                    $($tail: fields.contains(Fields::$TAIL).then_some(&self.$tail),)*
                }
            };
        }
        crate::frame_fields!(frame)
    }
}

impl FingerState {
    /// Returns the active bias.
    #[must_use]
    pub fn bias(&self) -> &Bias {
        &self.bias
    }

    /// Returns whether a bias taken on command is active.
    #[must_use]
    pub fn biased(&self) -> bool {
        self.biased
    }

    /// Returns whether the contact gate is open.
    #[must_use]
    pub fn contact(&self) -> bool {
        self.gate.contact()
    }

    /// Begins to average `frames` scans into a new bias. The estimate of the last scan has the
    /// outcome.
    pub fn take_bias(&mut self, frames: u16) {
        self.taker = Some(BiasTaker::new(frames));
    }

    /// Stops taking a bias; the active one stays.
    pub fn stop_bias(&mut self) {
        self.taker = None;
    }

    /// Returns whether a bias is being taken.
    #[must_use]
    pub fn taking_bias(&self) -> bool {
        self.taker.is_some()
    }

    /// Prepares the estimators when the contact gate has opened or closed.
    #[cold]
    #[inline(never)]
    fn contact_changed(&mut self, contact: bool, now: Micros) {
        if contact {
            self.course = Course::begin(now);
            self.grip.begin(now);
            self.filters.freeze();
        } else {
            self.filters.drift.release();
            self.matrix.clear();
            self.grip.release();
        }
    }

    /// Begins to doubt slip, and drops what it remembers; or goes on to doubt it.
    #[cold]
    #[inline(never)]
    fn doubt_slip(&mut self, faults: Faults, passed: u32) {
        self.doubt.left = self.doubt.left.saturating_sub(passed);
        let before = core::mem::replace(&mut self.faults, faults);
        if faults == before {
            return;
        }
        if self.doubt.left == 0 {
            self.grip.release();
        }
        self.doubt = Doubt { left: DOUBTED_US, flooded: (before | faults) & FLOODED != 0 };
    }
}

impl Finger {
    /// Makes a finger with `calibration`, which must be valid, and its initial state.
    #[must_use]
    pub fn new(calibration: Option<Calibration>) -> (Self, FingerState) {
        let finger = Self { calibration, ..Self::default() };
        let state = finger.restarted();
        (finger, state)
    }

    /// Returns the active calibration.
    #[must_use]
    pub fn calibration(&self) -> Option<&Calibration> {
        self.calibration.as_ref()
    }

    /// Reads the calibration in `record` in place and activates it. A state keeps the old bias and
    /// gate until it is replaced by [`Self::restarted`].
    ///
    /// # Errors
    /// The first error of the record; the finger is uncalibrated then.
    pub fn recalibrate(&mut self, record: &[u8]) -> Result<(), CalibrationError> {
        let read = self.calibration.get_or_insert_default().read(record);
        if read.is_err() {
            self.calibration = None;
        }
        read
    }

    /// Returns an initial state with the calibration's own bias.
    #[must_use]
    pub fn restarted(&self) -> FingerState {
        let mut state = FingerState::default();
        self.restart(&mut state);
        state
    }

    /// Makes `state` the initial one with the calibration's own bias.
    ///
    /// Part by part, because a whole new state would be built on the stack.
    pub(crate) fn restart(&self, state: &mut FingerState) {
        let FingerState {
            time,
            bias,
            biased,
            gate,
            stuck,
            jumps,
            noise,
            faults,
            doubt,
            thermometer,
            taker,
            filters,
            matrix,
            // Each contact begins a new one.
            course: _,
            grip,
        } = state;
        // No time has passed before the first scan.
        *time = Micros(u64::MAX);
        *bias = self.own_bias();
        *biased = false;
        *gate = GateState::default();
        *stuck = StuckWatch::default();
        *jumps = JumpWatch::default();
        *noise = NoiseWatch::default();
        *faults = Faults::default();
        *doubt = Doubt::default();
        *thermometer = Thermometer::default();
        *taker = None;
        *filters = Filters::default();
        *matrix = MatrixState::default();
        *grip = GripState::default();
    }

    /// Activates a bias that was taken on command earlier.
    pub fn restore_bias(&self, state: &mut FingerState, bias: Bias) {
        state.bias = bias;
        state.biased = true;
        state.filters = Filters::default();
    }

    /// Drops a bias taken on command and activates the calibration's own.
    pub fn clear_bias(&self, state: &mut FingerState) {
        state.bias = self.own_bias();
        state.biased = false;
        state.taker = None;
        state.filters = Filters::default();
    }

    fn own_bias(&self) -> Bias {
        self.calibration.as_ref().map(Calibration::bias).unwrap_or_default()
    }

    /// Processes one scan and returns its estimate with every field.
    pub fn estimate(&self, state: &mut FingerState, scan: &Scan) -> Estimate {
        let mut estimate = Estimate::NOTHING;
        self.update(&mut estimate, state, scan, Wanted::ALL);
        estimate
    }

    /// Processes one scan into `estimate`.
    ///
    /// Time, contact flag, signals and bias are always those of the scan; the lag is off the
    /// signals in contact if they are needed. If a frame is due, so are the whole status and the
    /// wanted fields. All else is undefined.
    pub fn update(
        &self,
        estimate: &mut Estimate,
        state: &mut FingerState,
        scan: &Scan,
        wanted: Wanted,
    ) {
        let warmth = self.calibration.as_ref().and_then(Calibration::warmth);
        let warm = warmth.and_then(|warmth| Some((warmth, state.thermometer.read(&scan.codes)?)));
        let healthy = self.calibration.as_ref().and_then(|c| c.taxels.as_ref());
        let healthy = healthy.map(|taxels| &taxels.bias.level);
        let signals = &mut estimate.signals;
        let bias =
            if state.taker.is_some() { advance_bias(state, &scan.codes, warm) } else { None };
        let light = state.filters.drift.gain();
        state.bias.direct(&scan.codes, healthy, warm, light, signals);
        let passed = scan.time.since(state.time);
        state.time = scan.time;
        let saturated = signals.health.saturated;
        let flooded = saturated != 0 && saturated.count_ones() >= TAXELS as u32 / 2;
        let stuck = state.stuck.update(&scan.codes, flooded, &state.bias, &mut signals.health);
        if scan.lost > 0 {
            state.jumps.interrupt();
        }
        if scan.lost > 0 || state.grip.slides() {
            state.noise.interrupt();
        }
        state.jumps.update(&scan.codes, signals, &state.bias, state.gate.contact());
        let noisy = state.noise.update(signals, &state.bias);
        let mut status = Status::default();
        let unknown = |(warmth, level): Warm<'_>| warmth.unknown(level);
        flag(&mut status, Status::TEMPERATURE, warm.is_some_and(unknown));
        flag(&mut status, Status::RAN_WARMTH, warm.is_some());
        flag(&mut status, Status::NOISY, noisy != 0);
        flag(&mut status, Status::STUCK_CHANNEL, stuck);
        flag(&mut status, Status::OVERRUN, scan.lost > 0);
        flag(&mut status, Status::BIASED, state.biased);
        flag(&mut status, Status::SATURATED, signals.health.saturated != 0);
        flag(&mut status, Status::DEAD_TAXEL, signals.health.dead != 0);
        flag(&mut status, Status::BRIDGE_FAULT, signals.health.bridge_faults != 0);

        let mut drifts = filters::drifts(self.calibration.as_ref(), signals);
        let factor2 = self.gate.threshold(&state.gate);
        let mut above = state.bias.exceeded(signals, factor2);
        if above && let Some(of) = drifts {
            let possible;
            (above, possible) =
                without_drift(of, &state.filters.drift, signals, &state.bias, factor2);
            drifts = drifts.filter(|_| possible);
        }
        let before = state.gate.contact();
        let contact = self.gate.update_at_once(&mut state.gate, above, || {
            // A faulty channel may read anything.
            let sound = signals.health == Health::SOUND;
            let matrix = signals.taxels.as_ref().zip(state.bias.taxels.as_ref()).filter(|_| sound);
            matrix.map_or(0.0, |(c, bias)| unmistakable(c, bias.noise))
        });
        flag(&mut status, Status::RAN_DRIFT, drifts.is_some());
        flag(&mut status, Status::CONTACT, contact);
        if contact != before {
            state.contact_changed(contact, scan.time);
        }

        // Gate and vibration detector take unfiltered signals: the gate responds at once, and slip
        // vibration lies above any filter's corner.
        let record = self.calibration.as_ref();
        let Health { dead, bridge_faults: bridges, .. } = signals.health;
        let strong = if flooded { FLOODED } else { 0 };
        let faults = Faults::from(dead) | Faults::from(bridges) << 16 | Faults::from(noisy) << 20;
        let faults = faults | strong | Faults::from(state.jumps.jumps()) << JUMPS;
        if faults != state.faults || state.doubt.left > 0 {
            state.doubt_slip(faults, passed);
        }
        let slip = state.grip.listen(record, scan.time, signals);
        let sound = state.doubt.withhold(slip);
        let runs = wanted.due || contact && sound.is_ok() && state.grip.is_due(scan.time);
        if let Some(record) = record {
            let (filters, passed) = (&mut state.filters, steady(passed));
            if contact {
                let needed = runs || self.filter.is_some();
                filters.compensate(record, signals, passed, needed, &mut status);
            } else {
                filters.follow(record, drifts, (signals, &mut state.bias), passed);
            }
        }
        if let Some(filter) = &self.filter {
            filter.smooth(&mut state.filters.smooth, signals);
        }
        estimate.time = scan.time;
        estimate.status = status;
        estimate.bias = bias;
        if runs {
            let sensors = self.sensor_forces(&scan.codes, estimate);
            if contact {
                state.matrix.begin(scan.time, passed / scan.lost.saturating_add(1));
                self.touched(estimate, state, &scan.codes, sensors, sound, wanted.fields);
                if !limits::possible(estimate) {
                    limits::withhold(estimate, state);
                }
            } else {
                no_contact(record, &scan.codes, &sensors, slip.err(), estimate);
            }
            let lacks = |f: &Force| matches!(f.z, Err(NoValue::Uncalibrated | NoValue::Absent));
            let uncalibrated = lacks(&estimate.force) && estimate.sensors.iter().all(lacks);
            flag(&mut estimate.status, Status::UNCALIBRATED, uncalibrated);
        }
    }

    #[inline(never)]
    fn touched(
        &self,
        estimate: &mut Estimate,
        state: &mut FingerState,
        codes: &Codes,
        sensors: SensorForces,
        slip: Measured<(&Slip, bool)>,
        fields: Fields,
    ) {
        let Estimate { time, signals, status, .. } = &mut *estimate;
        let record = self.calibration.as_ref();
        let array = ArrayEstimate::of(record, signals, &sensors, status);
        let needed = fields.intersects(Wanted::OPTICAL) || array.force.is_err();
        let optical = match &signals.taxels {
            None => OpticalEstimate::nothing(missing(codes.taxels.is_some())),
            Some(_) if !needed => OpticalEstimate::nothing(NoValue::NotEstimated),
            Some(c) => {
                let (health, bias, method) = (&signals.health, &state.bias, self.point_method);
                let learns = slip.is_ok() && state.grip.learns(*time);
                let array = &array;
                let input = OpticalInput { record, method, c, health, bias, array, learns };
                input.estimate(&mut state.matrix, status)
            }
        };
        let mut fused = Fused::of(&optical, &array, status);
        let torsion = array.torsion;
        estimate.slip = slip.and_then(|(slip, rubs)| {
            let grip = Grip { time: *time, fused: &fused, torsion, optical: &optical, rubs };
            grip.judge(record, slip, &mut state.grip, status)
        });
        if let Some(lag) = record.and_then(Calibration::lag) {
            let optical = if optical.force[2].is_ok() { lag.taxels } else { 0.0 };
            let lag = if array.force.is_ok() { at_least(lag.sensors, optical) } else { optical };
            state.course.widen(estimate.time, lag, &mut fused.force);
        }
        fused.write(estimate, optical.misfit, fields);
        estimate.torsion = torsion;
        estimate.contacts = optical.contacts;
    }

    #[inline(always)]
    fn sensor_forces(&self, codes: &Codes, estimate: &mut Estimate) -> SensorForces {
        let Estimate { signals, sensors, status, .. } = estimate;
        // Unrolled by hand: the compiler keeps a loop that contains a call, which takes half as
        // long again.
        let [a, b, c, d] = sensors;
        let a = self.sensor_force(0, codes, signals, a, status);
        let b = self.sensor_force(1, codes, signals, b, status);
        let c = self.sensor_force(2, codes, signals, c, status);
        let d = self.sensor_force(3, codes, signals, d, status);
        Ok([a?, b?, c?, d?])
    }

    #[inline(always)]
    fn sensor_force(
        &self,
        i: usize,
        codes: &Codes,
        signals: &Signals,
        force: &mut Force,
        status: &mut Status,
    ) -> Measured<[f32; 3]> {
        let calibration = self.calibration.as_ref().and_then(|c| c.sensors.get(i)?.as_ref());
        let signal = signals.bridges.get(i).and_then(Option::as_ref);
        let (Some(signal), Some(calibration)) = (signal, calibration) else {
            let scanned = codes.bridges.get(i).is_some_and(Option::is_some);
            let none = set_none(force, missing(scanned));
            // A sensor without calibration has no part in the array.
            return if calibration.is_some() { none } else { Ok([0.0; 3]) };
        };
        if signals.health.bridge_faults >> i & 1 == 1 {
            set_none(force, NoValue::DeadChannel)
        } else if within(&calibration.range, signal) {
            let [x, y, z] = calibration.sensitivity.force(*signal);
            if !limits::force_possible([x, y, z]) {
                status.insert(Status::OUT_OF_RANGE);
                return set_none(force, NoValue::OutOfTrainedRange);
            }
            status.insert(Status::RAN_SENSORS);
            *force = Force::known(x, y, z);
            Ok([x, y, z])
        } else {
            status.insert(Status::OUT_OF_RANGE);
            set_none(force, NoValue::OutOfTrainedRange)
        }
    }
}

/// Forces on all calibrated sensors in newtons, or the reason for the first that is missing.
type SensorForces = Measured<[[f32; 3]; SENSORS]>;

/// A separate cold function, so that the path of a known force writes no reason.
#[cold]
#[inline(never)]
fn set_none(force: &mut Force, reason: NoValue) -> Measured<[f32; 3]> {
    *force = Force::none(reason);
    Err(reason)
}

/// A separate cold function: its large, rare result would be copied with every scan.
#[cold]
#[inline(never)]
fn advance_bias(
    state: &mut FingerState,
    codes: &Codes,
    warm: Option<Warm<'_>>,
) -> Option<Result<(), BiasRefusal>> {
    let levels = Levels::at_reference(codes, warm, 1.0);
    let outcome = state.taker.as_mut()?.add(&levels, &state.bias)?;
    state.taker = None;
    Some(outcome.map(|taken| {
        state.bias = taken.bias;
        state.biased = true;
        state.filters = Filters::default();
    }))
}

/// Sets `bit` if `holds`. A branch costs less than converting the `bool` to a bit.
fn flag(status: &mut Status, bit: Status, holds: bool) {
    if holds {
        status.insert(bit);
    }
}

fn missing(scanned: bool) -> NoValue {
    if scanned { NoValue::Uncalibrated } else { NoValue::Absent }
}

fn within(ranges: &[Range], signals: &[f32]) -> bool {
    // The sign bit of each difference marks a violation; OR-ing them needs no branch per signal.
    let outside =
        |[low, high]: &Range, signal: &f32| (signal - low).to_bits() | (high - signal).to_bits();
    let signs =
        ranges.iter().zip(signals).fold(0, |signs, (range, signal)| signs | outside(range, signal));
    signs >> 31 == 0
}
