//! The finger as an instrument: settings, counters and commands.
//!
//! The instrument owns everything that survives a reconnect and keeps settings, bias and
//! calibration in a [`Store`]. [`crate::session`] transports the messages.

use core::num::{NonZeroU16, NonZeroU32};

use crate::calibration::{self, bias_fits};
use crate::condition::{BiasRefusal, LowPass};
use crate::crc32::crc32;
use crate::finger::{Estimate, Finger, FingerState, Wanted};
use crate::frame::{Fields, FrameRef, Status};
use crate::scan::{Codes, Scan, ScanSettings};
use crate::self_test::{MOST_SCANS, Running};
use crate::store::{Flash, Settings, Store, StoreError, StoredBias};
use crate::units::FullScale;
use crate::wire::message::{
    CHUNK, CalibrationId, Command, Cost, Counters, Identity, Info, Message, PROTOCOL, Refusal,
    Request, Response,
};

/// A finger with its settings and counters.
pub struct Instrument {
    identity: Identity,
    finger: Finger,
    state: FingerState,
    /// CRC of the active calibration record.
    calibration_crc: u32,
    streaming: bool,
    hz: u16,
    /// Scan settings of the host; `None` for the board's own.
    scan: Option<ScanSettings>,
    /// Corner of the low-pass in hertz; 0 for none.
    filter_hz: u16,
    fields: Fields,
    /// Scans per frame, and scans until the next frame.
    every: NonZeroU16,
    until_due: u16,
    /// Estimate of the last scan.
    estimate: Estimate,
    bias_tag: Option<u8>,
    /// Outcome of the bias that the last scan completed.
    bias_taken: Option<Result<(), BiasRefusal>>,
    /// Whether the gate was open at some time while the active bias was taken.
    bias_in_contact: bool,
    /// Whether the gate has been open since the current bias was begun.
    taking_in_contact: bool,
    counters: Counters,
    cost: Cost,
    /// A self-test under way, and the tag of its request.
    self_test: Option<(u8, Running)>,
    /// Whether the stored record was intact when the test began.
    record_intact: Option<bool>,
    /// Whether the board holds an LED row on, so that codes say nothing about the finger.
    row_held: bool,
    /// Count of scans when flash was last erased.
    erased_at: Option<u32>,
}

/// Results of a scan that the caller must handle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// A frame is due and the stream is on: call [`Instrument::frame`].
    pub frame: bool,
    /// A bias or self-test is complete: call [`Instrument::take_reply`] before the next scan.
    pub reply: bool,
}

impl Instrument {
    /// Frames a second unless the host sets another rate.
    pub const DEFAULT_RATE_HZ: u16 = 1000;

    /// Makes an uncalibrated instrument with the stream off.
    #[must_use]
    pub fn new(identity: Identity) -> Self {
        let hz = Self::DEFAULT_RATE_HZ.min(identity.scan_hz);
        Self {
            every: divider(identity.scan_hz, hz),
            identity,
            // Built in place, because moving a finger copies it over the stack.
            finger: Finger::default(),
            state: FingerState::default(),
            calibration_crc: 0,
            streaming: false,
            hz,
            scan: None,
            filter_hz: 0,
            fields: Fields::ESTIMATES,
            until_due: 0,
            estimate: Estimate::NOTHING,
            bias_tag: None,
            bias_taken: None,
            bias_in_contact: false,
            taking_in_contact: false,
            counters: Counters::default(),
            cost: Cost::default(),
            self_test: None,
            record_intact: None,
            row_held: false,
            erased_at: None,
        }
    }

    /// Restores the content of the store at power-up.
    ///
    /// The call activates the newest calibration that this firmware reads, the settings, and a bias
    /// that belongs to that calibration. `rescan` makes the board scan as it was set, or returns an
    /// error; the board then keeps its own settings.
    pub fn restore(
        &mut self,
        store: &mut Store<impl Flash>,
        rescan: impl FnOnce(&ScanSettings) -> Result<FullScale, Refusal>,
    ) {
        store.open(|record| self.finger.recalibrate(record).is_ok());
        self.begin_anew(store);
        if let Some(Settings { hz, fields, point_method, scan, filter_hz }) = store.settings() {
            if let Some(scan) = scan
                && let Ok(full_scale) = rescan(&scan)
            {
                self.rescanned(&scan, full_scale);
            }
            if (1..=self.identity.scan_hz).contains(&hz) && fields.0 <= Fields::ALL.0 {
                self.set_rate(hz);
                self.fields = fields;
            }
            if point_method.is_built() {
                self.finger.point_method = point_method;
            }
            self.set_filter(filter_hz);
        }
        if let Some(StoredBias { calibration, bias: Some(bias) }) = store.bias()
            && calibration == self.calibration_crc
            && bias_fits(&bias)
        {
            self.finger.restore_bias(&mut self.state, bias);
        }
    }

    /// Stores a calibration record and activates it, as an upload does.
    ///
    /// # Errors
    /// The error of the record or of the flash; the instrument is then unchanged.
    pub fn install(&mut self, record: &[u8], store: &mut Store<impl Flash>) -> Result<(), Refusal> {
        store.begin(record.len())?;
        store.write(0, record)?;
        self.commit(store)
    }

    /// Returns whether the stream is on.
    #[must_use]
    pub fn streaming(&self) -> bool {
        self.streaming
    }

    /// Returns the due frame of `scan`, which must be the last one processed.
    #[must_use]
    #[inline(always)]
    pub fn frame<'s>(&'s self, scan: &'s Scan) -> FrameRef<'s> {
        // The stream's frames are numbered from zero as they are counted.
        self.estimate.frame(&scan.codes, self.counters.frames.wrapping_sub(1), self.fields)
    }

    /// Returns the event counters for reading and updating.
    pub fn counters(&mut self) -> &mut Counters {
        &mut self.counters
    }

    /// Records the cost of processing the last scan, in ticks.
    pub fn note_cost(&mut self, ticks: u32) {
        self.cost.note(ticks);
    }

    /// Processes one scan; a frame is due at the stream's rate.
    pub fn scan(&mut self, scan: &Scan) -> Outcome {
        let wanted = Wanted { fields: self.fields, due: self.streaming && self.until_due == 0 };
        if self.row_held {
            self.estimate.set_row_held(scan);
        } else {
            self.finger.update(&mut self.estimate, &mut self.state, scan, wanted);
        }
        self.counters.scans = self.counters.scans.wrapping_add(1);
        self.counters.overruns = self.counters.overruns.wrapping_add(scan.lost);
        let mut outcome = Outcome::default();
        self.taking_in_contact |= self.estimate.status.contains(Status::CONTACT);
        self.bias_taken = self.estimate.bias;
        if self.bias_taken.is_some() || self.self_test.is_some() {
            outcome.reply = self.finish(&scan.codes);
        }
        if self.streaming {
            if wanted.due {
                self.until_due = self.every.get();
                outcome.frame = true;
                self.counters.frames = self.counters.frames.wrapping_add(1);
            }
            self.until_due = self.until_due.saturating_sub(1);
        }
        outcome
    }

    /// Completes what takes several scans: a bias or a self-test. Returns whether a reply is due.
    #[cold]
    #[inline(never)]
    fn finish(&mut self, codes: &Codes) -> bool {
        if let Some(Ok(())) = self.bias_taken {
            self.bias_in_contact = self.taking_in_contact;
        }
        // A finished self-test is left only if its requester is gone: drop it.
        let _ = self.self_test.take_if(|(_, running)| running.is_over());
        let tested = self.self_test.as_mut().is_some_and(|(_, running)| running.scan(codes));
        tested || (self.bias_taken.is_some() && self.bias_tag.is_some())
    }

    /// Returns the reply to what the last scan completed. The function is separate from
    /// [`Self::scan`], because the reply is large and rare and would be copied with every scan.
    #[cold]
    #[inline(never)]
    pub fn take_reply(&mut self) -> Option<Message> {
        // At most one a scan, because a bias is not taken while a test runs.
        if let Some(taken) = self.bias_taken.take() {
            let tag = self.bias_tag.take()?;
            let result = taken.map(|()| self.bias_response()).map_err(|refusal| match refusal {
                BiasRefusal::NotStill => Refusal::NotStill,
                BiasRefusal::Saturated => Refusal::Saturated,
            });
            return Some(Message::Reply { tag, result });
        }
        let (tag, running) = self.self_test.take_if(|(_, running)| running.is_over())?;
        let test = running.result(self.record_intact);
        Some(Message::Reply { tag, result: Ok(Response::SelfTest(test)) })
    }

    /// Handles one request. Returns `None` if the answer comes later, with a scan.
    pub fn handle(&mut self, request: &Request, store: &mut Store<impl Flash>) -> Option<Message> {
        let tag = request.tag;
        if request.command == Command::Version {
            return Some(Message::Version {
                tag,
                protocol: PROTOCOL,
                firmware: firmware_version(),
            });
        }
        match self.command(tag, &request.command, store) {
            Ok(None) => None,
            Ok(Some(response)) => Some(Message::Reply { tag, result: Ok(response) }),
            Err(refusal) => Some(Message::Reply { tag, result: Err(refusal) }),
        }
    }

    fn command(
        &mut self,
        tag: u8,
        command: &Command,
        store: &mut Store<impl Flash>,
    ) -> Result<Option<Response>, Refusal> {
        match command {
            Command::Version => {}
            Command::Info => return Ok(Some(Response::Info(self.info()))),
            Command::Stream(on) => {
                self.streaming = *on;
                self.until_due = 0;
            }
            Command::SetRate { hz } => {
                in_range(u32::from(*hz), 1, u32::from(self.identity.scan_hz))?;
                self.set_rate(*hz);
                return Ok(Some(Response::Rate { millihertz: self.rate_millihertz() }));
            }
            Command::SetFields(fields) => {
                in_range(u32::from(fields.0), 0, u32::from(Fields::ALL.0))?;
                self.fields = *fields;
            }
            Command::SetFilter { hz } => {
                in_range(u32::from(*hz), 0, u32::from(self.highest_filter()))?;
                self.set_filter(*hz);
            }
            Command::SetPointMethod(method) if !method.is_built() => {
                return Err(Refusal::Unsupported);
            }
            Command::SetPointMethod(method) => self.finger.point_method = *method,
            Command::TakeBias { scans } => {
                in_range(u32::from(*scans), 2, u32::from(u16::MAX))?;
                if self.busy() || self.row_held {
                    return Err(Refusal::Busy);
                }
                self.state.take_bias(*scans);
                self.bias_tag = Some(tag);
                self.taking_in_contact = self.state.contact();
                return Ok(None);
            }
            Command::ReadBias => return Ok(Some(self.bias_response())),
            Command::ClearBias => {
                if self.state.taking_bias() {
                    return Err(Refusal::Busy);
                }
                self.finger.clear_bias(&mut self.state);
                self.bias_in_contact = false;
            }
            Command::CalibrationBegin { length } => {
                in_range(u32::from(*length), 6, calibration::MAX_BYTES as u32)?;
                store.begin(usize::from(*length))?;
            }
            Command::CalibrationChunk { offset, data } => {
                store.write(usize::from(*offset), data)?;
            }
            Command::CalibrationCommit => {
                if self.state.taking_bias() {
                    return Err(Refusal::Busy);
                }
                self.commit(store)?;
            }
            Command::CalibrationRead { offset } => {
                let record = store.record().ok_or(Refusal::Uncalibrated)?;
                let rest = record.get(usize::from(*offset)..).unwrap_or_default();
                let data = rest.iter().copied().take(CHUNK).collect();
                return Ok(Some(Response::Calibration { offset: *offset, data }));
            }
            Command::SaveSettings => {
                let point_method = self.finger.point_method;
                let (hz, fields, scan) = (self.hz, self.fields, self.scan);
                let filter_hz = self.filter_hz;
                store.save_settings(&Settings { hz, fields, point_method, scan, filter_hz })?;
            }
            Command::SaveBias => {
                if self.state.taking_bias() {
                    return Err(Refusal::Busy);
                }
                let bias = self.state.biased().then(|| *self.state.bias());
                store.save_bias(&StoredBias { calibration: self.calibration_crc, bias })?;
            }
            Command::SelfTest { scans } => {
                in_range(u32::from(*scans), 2, u32::from(MOST_SCANS))?;
                if self.busy() || self.row_held {
                    return Err(Refusal::Busy);
                }
                let damaged = store.passed_over().filter(|record| !is_intact(record));
                self.record_intact = damaged.or(store.record()).map(is_intact);
                self.self_test = Some((tag, Running::over(*scans)));
                return Ok(None);
            }
            // The board handles these; the session passes them on to it.
            Command::Health
            | Command::Bootloader
            | Command::SetScan(_)
            | Command::HoldRow { .. } => return Err(Refusal::Unsupported),
        }
        Ok(Some(Response::Done))
    }

    /// Records that flash was erased after the last scan.
    pub fn note_erasure(&mut self) {
        self.erased_at = Some(self.counters.scans);
    }

    /// Returns whether less than a second of scans has passed since flash was erased.
    #[must_use]
    pub fn erased_lately(&self) -> bool {
        let passed = self.erased_at.map(|at| self.counters.scans.wrapping_sub(at));
        passed.is_some_and(|scans| scans < u32::from(self.identity.scan_hz))
    }

    /// Returns whether an answer is still to come with a scan.
    #[must_use]
    pub fn busy(&self) -> bool {
        self.state.taking_bias() || self.self_test.is_some()
    }

    /// Ends a bias and a self-test whose host has gone; the next host gets no reply to them.
    pub fn forget_host(&mut self) {
        self.state.stop_bias();
        (self.bias_tag, self.self_test) = (None, None);
    }

    /// Whether the board holds an LED row on.
    #[must_use]
    pub fn row_held(&self) -> bool {
        self.row_held
    }

    /// Records whether the board holds an LED row on. Bias and state of the finger stay as they
    /// are meanwhile.
    pub fn set_row_held(&mut self, held: bool) {
        self.row_held = held;
    }

    /// Adapts rate, filter and state to new scan settings of the board.
    pub fn rescanned(&mut self, scan: &ScanSettings, full_scale: FullScale) {
        // A second of the new scans, because the old ones' time is unknown.
        if self.erased_lately() {
            self.note_erasure();
        } else {
            self.erased_at = None;
        }
        self.scan = Some(*scan);
        self.identity.scan_hz = scan.scan_hz;
        self.identity.full_scale = full_scale;
        self.set_rate(self.hz.min(scan.scan_hz));
        self.set_filter(self.filter_hz);
        self.forget();
    }

    /// Returns the highest corner of the filter, in hertz: a quarter of the scans a second. A
    /// corner nearer to half of them lets all signals through.
    fn highest_filter(&self) -> u16 {
        self.identity.scan_hz / 4
    }

    fn set_filter(&mut self, hz: u16) {
        self.filter_hz = hz.min(self.highest_filter());
        let filter = LowPass::new(self.filter_hz, self.identity.scan_hz);
        self.finger.filter = (self.filter_hz > 0).then_some(filter);
    }

    /// Resets the state, which is invalid after a change of codes or calibration.
    #[inline(never)]
    fn forget(&mut self) {
        self.finger.restart(&mut self.state);
        self.bias_in_contact = false;
    }

    /// Reads the received record from flash, activates it, and only then makes it the newest. A
    /// refused record therefore costs only the other slot.
    fn commit(&mut self, store: &mut Store<impl Flash>) -> Result<(), Refusal> {
        let read = self.finger.recalibrate(store.written()?).map_err(Refusal::Calibration);
        let done = read.and_then(|()| Ok(store.commit()?));
        if done.is_ok() {
            self.begin_anew(store);
        } else if let Some(old) = store.record() {
            // The record was read before. Bias and gate still belong to it.
            let _ = self.finger.recalibrate(old);
        }
        done
    }

    fn begin_anew(&mut self, store: &Store<impl Flash>) {
        self.forget();
        self.calibration_crc = store.record().map_or(0, record_crc);
    }

    fn bias_response(&self) -> Response {
        Response::Bias {
            bias: *self.state.bias(),
            on_command: self.state.biased(),
            in_contact: self.bias_in_contact,
        }
    }

    #[inline(never)]
    fn set_rate(&mut self, hz: u16) {
        self.hz = hz;
        self.every = divider(self.identity.scan_hz, hz);
        self.until_due = 0;
    }

    fn rate_millihertz(&self) -> u32 {
        u32::from(self.identity.scan_hz) * 1000 / NonZeroU32::from(self.every)
    }

    fn info(&self) -> Info {
        Info {
            identity: self.identity.clone(),
            rate_millihertz: self.rate_millihertz(),
            fields: self.fields,
            streaming: self.streaming,
            point_method: self.finger.point_method,
            biased: self.state.biased(),
            calibration: self.finger.calibration().map(|calibration| CalibrationId {
                serial: calibration.serial.clone(),
                date: calibration.date,
                crc: self.calibration_crc,
            }),
            counters: self.counters,
            cost: self.cost,
            estimators: Status::BUILT,
            filter_hz: self.filter_hz,
        }
    }
}

/// Returns the number of scans per frame, rounded to the nearest.
#[inline(never)]
fn divider(scan_hz: u16, hz: u16) -> NonZeroU16 {
    let (scan_hz, hz) = (u32::from(scan_hz), u32::from(hz.max(1)));
    // 64-bit not needed: the sum stays below 2^17.
    let scans = ((scan_hz + hz / 2) / hz).min(u32::from(u16::MAX)) as u16;
    NonZeroU16::new(scans).unwrap_or(NonZeroU16::MIN)
}

/// Returns whether the record's CRC matches the bytes before it.
fn is_intact(record: &[u8]) -> bool {
    record.split_last_chunk().is_some_and(|(body, crc)| crc32(body) == u32::from_le_bytes(*crc))
}

/// Returns the CRC at the end of a record.
fn record_crc(record: &[u8]) -> u32 {
    record.last_chunk().map_or(0, |crc| u32::from_le_bytes(*crc))
}

impl From<StoreError> for Refusal {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::OutOfOrder => Self::OutOfOrder,
            StoreError::Flash => Self::Storage,
        }
    }
}

fn in_range(value: u32, low: u32, high: u32) -> Result<(), Refusal> {
    if (low..=high).contains(&value) { Ok(()) } else { Err(Refusal::OutOfRange { low, high }) }
}

/// Returns this crate's version from its manifest.
fn firmware_version() -> [u8; 3] {
    const fn number(text: &str) -> u8 {
        let mut value = 0;
        let mut rest = text.as_bytes();
        while let [digit, tail @ ..] = rest {
            value = value * 10 + (*digit - b'0');
            rest = tail;
        }
        value
    }
    const VERSION: [u8; 3] = [
        number(env!("CARGO_PKG_VERSION_MAJOR")),
        number(env!("CARGO_PKG_VERSION_MINOR")),
        number(env!("CARGO_PKG_VERSION_PATCH")),
    ];
    VERSION
}
