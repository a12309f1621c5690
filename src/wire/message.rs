//! Messages between host and finger.
//!
//! Discriminants are positions in the enums, so **variants are appended, never moved**. Request 0
//! asks for the protocol version and message 0 answers, whatever the version: both are frozen
//! forever.

use heapless::{String, Vec};
use serde::ser::{Error, SerializeTuple};
use serde::{Deserialize, Serialize, Serializer};

use super::MAX_PACKET;
use crate::calibration::CalibrationError;
use crate::condition::Bias;
use crate::estimate::contact_point::PointMethod;
use crate::frame::{Fields, Frame, Status};
use crate::scan::{ScanSetting, ScanSettings};
use crate::self_test::SelfTest;
use crate::units::FullScale;

/// Version of the protocol except the version query. The version changes when an old client would
/// misread.
pub const PROTOCOL: u16 = 2;

/// Largest number of bytes of a calibration record in one message.
pub const CHUNK: usize = 128;

/// Request from host to finger.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// Any number; the reply returns it.
    pub tag: u8,
    /// The command.
    pub command: Command,
}

/// Commands of the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Command {
    /// 0, frozen: protocol and firmware version.
    Version,
    /// 1: identity and state of this finger.
    Info,
    /// 2: start or stop the stream.
    Stream(bool),
    /// 3: sets the frames a second; the reply has the actual rate.
    SetRate {
        /// Requested rate in hertz.
        hz: u16,
    },
    /// 4: sets the fields of the frames.
    SetFields(Fields),
    /// 5: sets the method of the contact point.
    SetPointMethod(PointMethod),
    /// 6: averages so many scans into a new bias; answered when it is complete.
    TakeBias {
        /// Scans to average, 2 … 65535.
        scans: u16,
    },
    /// 7: reads the active bias.
    ReadBias,
    /// 8: returns to the calibration's own bias.
    ClearBias,
    /// 9: begins the upload of a calibration. Erases the slot that does not hold the active one.
    CalibrationBegin {
        /// Length of the whole record in bytes, version and CRC included.
        length: u16,
    },
    /// 10: the next bytes of the record.
    CalibrationChunk {
        /// Offset in the record; must be the end of the previous chunk.
        offset: u16,
        /// The bytes: a multiple of 8 of them in all chunks but the last.
        data: Vec<u8, CHUNK>,
    },
    /// 11: ends the upload: checks the record, activates and keeps it.
    CalibrationCommit,
    /// 12: reads the active calibration from `offset` on; fewer than [`CHUNK`] bytes are the last.
    CalibrationRead {
        /// Offset in the record.
        offset: u16,
    },
    /// 13: saves scan, rate, filter, fields and contact point method for the next power-ups.
    SaveSettings,
    /// 14: saves the active bias, taken on command or the calibration's own, for the next
    /// power-ups.
    SaveBias,
    /// 15: reads the state of the board itself.
    Health,
    /// 16: measures mean and noise of every channel; answered when it is complete.
    SelfTest {
        /// Scans to take, 2 … [`MOST_SCANS`](crate::self_test::MOST_SCANS).
        scans: u16,
    },
    /// 17: starts the chip's own bootloader. The answer is sent before.
    Bootloader,
    /// 18: changes the scan until the next power-up. The host must set the stream's rate again.
    SetScan(ScanSettings),
    /// 19: sets the low-pass filter of the signals, independently of the rate.
    SetFilter {
        /// −3 dB frequency of a second-order low-pass, in hertz; 0 for none. The range is 1 to a
        /// quarter of the scans a second.
        hz: u16,
    },
    /// 20: holds an LED row on in every step until the session ends, to test the wiring. Frames
    /// then carry codes and no estimate.
    HoldRow {
        /// The row, 0 … 3; `None` scans again.
        row: Option<u8>,
    },
}

/// Message from finger to host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// 0, frozen: the answer to the version query.
    Version {
        /// Tag of the request.
        tag: u8,
        /// Version of the protocol except this message.
        protocol: u16,
        /// Firmware major, minor, patch.
        firmware: [u8; 3],
    },
    /// 1: the answer to any other request.
    Reply {
        /// Tag of the request.
        tag: u8,
        /// Result of the request.
        result: Result<Response, Refusal>,
    },
    /// 2: a frame of the stream.
    Frame(#[serde(serialize_with = "frame")] Frame),
}

/// Serializes a frame with its own serializer instead of serde's. For the same bytes serde's code
/// takes 1.7 KB of flash, and a finger never sends frames through it.
#[inline(never)]
pub(super) fn frame<S: Serializer>(frame: &Frame, serializer: S) -> Result<S::Ok, S::Error> {
    let mut bytes = [0; MAX_PACKET];
    let length = super::frame::serialize(&frame.into(), &mut bytes);
    // The serializer has already written the discriminant.
    let frame = length.and_then(|length| bytes.get(1..length));
    let frame = frame.ok_or_else(|| S::Error::custom("frame longer than the longest packet"))?;
    let mut out = serializer.serialize_tuple(frame.len())?;
    frame.iter().try_for_each(|byte| out.serialize_element(byte))?;
    out.end()
}

/// Successful results of requests.
#[expect(clippy::large_enum_variant, reason = "there is no heap for the large variants")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Response {
    /// 0: done.
    Done,
    /// 1: to `Info`.
    Info(Info),
    /// 2: to `SetRate`: the actual rate.
    Rate {
        /// Frames a second in millihertz, as the scan's divider gives it.
        millihertz: u32,
    },
    /// 3: to `TakeBias` and `ReadBias`.
    Bias {
        /// The active bias.
        bias: Bias,
        /// Whether the bias was taken on command.
        on_command: bool,
        /// Whether the gate was open during the average: the finger may have been under load.
        in_contact: bool,
    },
    /// 4: to `CalibrationRead`.
    Calibration {
        /// Offset of the bytes in the record.
        offset: u16,
        /// The bytes; empty past the end.
        data: Vec<u8, CHUNK>,
    },
    /// 5: to `Health`.
    Health(BoardHealth),
    /// 6: to `SelfTest`.
    SelfTest(SelfTest),
}

/// Reasons for refusing a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// 0: the value must lie in this range.
    OutOfRange {
        /// Least allowed.
        low: u32,
        /// Most allowed.
        high: u32,
    },
    /// 1: the finger moved while its bias was being taken; the old bias stays.
    NotStill,
    /// 2: another bias or a self-test is in progress, or a row is held on.
    Busy,
    /// 3: a calibration chunk where none was expected, or after a gap.
    OutOfOrder,
    /// 4: the uploaded record is not a calibration; the old one stays.
    Calibration(CalibrationError),
    /// 5: there is no calibration to read.
    Uncalibrated,
    /// 6: a taxel is clipped, so that its bias cannot be known; the old bias stays.
    Saturated,
    /// 7: the flash failed; what was stored before stays.
    Storage,
    /// 8: this board does not support the command.
    Unsupported,
    /// 9: this scan setting cannot be combined with the other ones; the scan continues unchanged.
    Scan {
        /// The setting that cannot be met.
        setting: ScanSetting,
        /// Least possible value.
        low: u32,
        /// Greatest possible value.
        high: u32,
    },
}

/// Identity and state of a finger.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Info {
    /// Properties of the board, its build and its scan.
    pub identity: Identity,
    /// Actual frames a second, in millihertz.
    pub rate_millihertz: u32,
    /// Fields of the frames.
    pub fields: Fields,
    /// Whether the stream is on.
    pub streaming: bool,
    /// Method of the contact point.
    pub point_method: PointMethod,
    /// Whether a bias taken on command is active.
    pub biased: bool,
    /// The active calibration, if there is one.
    pub calibration: Option<CalibrationId>,
    /// Counters since power-up.
    pub counters: Counters,
    /// Cost of processing a scan.
    pub cost: Cost,
    /// Estimators of this firmware: the bits that a frame's status sets when they run.
    pub estimators: Status,
    /// Corner of the low-pass over the signals in hertz; 0 for none.
    pub filter_hz: u16,
}

/// Properties of the board, its build and its scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// The board's name, as in `boards/`.
    pub board: String<24>,
    /// The board's own serial number.
    pub serial: String<32>,
    /// Build of the firmware.
    pub build: String<24>,
    /// Scans a second.
    pub scan_hz: u16,
    /// Full scale of the codes.
    pub full_scale: FullScale,
    /// Frequency of the ticks of [`Cost`], in hertz.
    pub tick_hz: u32,
}

/// State of the board itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BoardHealth {
    /// Cause of the last start.
    pub reset: Reset,
    /// Place of the last panic, or the fault, if one caused the start.
    pub panic: Option<String<96>>,
    /// Cost of reading a scan out of the converters' buffers, in the identity's ticks.
    pub reading: Option<Cost>,
    /// Cost of packing a frame and handing it to the link, in the identity's ticks.
    pub sending: Option<Cost>,
    /// Most bytes of stack used since power-up, and the bytes available.
    pub stack: Option<(u32, u32)>,
    /// Settings of the scan.
    pub scan: Option<ScanSettings>,
    /// Wear of the flash, if the finger has a store.
    pub erasures: Option<Erasures>,
}

/// Erasures of the flash over its life, at least. Two areas share each number.
///
/// A chip's data sheet says how many an area endures. An upload that breaks off counts only if a
/// later one is completed before the power goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Erasures {
    /// Erasures of the calibration's two areas.
    pub calibration: u32,
    /// Erasures of the two areas of settings and bias.
    pub settings: u32,
}

/// Cause of a board's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Reset {
    /// 0: unknown.
    #[default]
    Unknown,
    /// 1: power-up or low supply voltage.
    Power,
    /// 2: the reset pin.
    Pin,
    /// 3: requested by the firmware, after a panic, too.
    Software,
    /// 4: watchdog: no scan came through for too long.
    Watchdog,
    /// 5: option bytes or a low-power mode.
    Other,
}

/// Identity of the active calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationId {
    /// Serial number of the finger it was made for.
    pub serial: String<32>,
    /// Date in seconds since 1970-01-01 UTC.
    pub date: u64,
    /// CRC-32 of the record.
    pub crc: u32,
}

/// Event counters since power-up; they wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Scans processed.
    pub scans: u32,
    /// Frames due to the stream.
    pub frames: u32,
    /// Frames of the stream dropped because the link was full.
    pub lost: u32,
    /// Scans that were lost before they could be processed.
    pub overruns: u32,
    /// Packets from the host that could not be read.
    pub bad_packets: u32,
    /// Replies dropped because the link was full.
    pub lost_replies: u32,
}

/// Cost of processing one scan, in the identity's ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Cost {
    /// Cost of the last scan.
    pub last: u32,
    /// Highest cost since power-up.
    pub worst: u32,
}

impl Cost {
    /// Records the cost of one scan.
    pub fn note(&mut self, ticks: u32) {
        *self = Self { last: ticks, worst: self.worst.max(ticks) };
    }
}
