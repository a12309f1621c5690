//! What the two sides say to each other.
//!
//! Discriminants are positions in the enums, so **variants are appended, never moved**. Whatever the
//! protocol version, request 0 asks for it and message 0 answers: those two are frozen forever.

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

/// Version of everything but the version query. It changes when an old client would misread.
pub const PROTOCOL: u16 = 2;

/// Most bytes of a calibration record in one message.
pub const CHUNK: usize = 128;

/// Host to finger.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// Any number; the reply carries it back.
    pub tag: u8,
    /// What is asked for.
    pub command: Command,
}

/// What the host may ask for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Command {
    /// 0, frozen: protocol and firmware version.
    Version,
    /// 1: who this finger is and how it is doing.
    Info,
    /// 2: start or stop the stream.
    Stream(bool),
    /// 3: frames a second; the reply has the rate in force.
    SetRate {
        /// Wanted, in hertz.
        hz: u16,
    },
    /// 4: which fields frames carry.
    SetFields(Fields),
    /// 5: how the contact point is found.
    SetPointMethod(PointMethod),
    /// 6: average so many scans into a new bias; answered when it is done.
    TakeBias {
        /// Scans to average, 2 … 65535.
        scans: u16,
    },
    /// 7: the bias in force.
    ReadBias,
    /// 8: back to the calibration's own bias.
    ClearBias,
    /// 9: a calibration of so many bytes follows. What was in the slot that is not in force is erased.
    CalibrationBegin {
        /// Bytes of the whole record, version and CRC included.
        length: u16,
    },
    /// 10: the next bytes of it.
    CalibrationChunk {
        /// Where they go; must be where the last chunk ended.
        offset: u16,
        /// The bytes: a multiple of 8 of them in all chunks but the last.
        data: Vec<u8, CHUNK>,
    },
    /// 11: that was all; check it, put it in force, and keep it in force from now on.
    CalibrationCommit,
    /// 12: bytes of the calibration in force, from `offset` on; fewer than [`CHUNK`] are the last.
    CalibrationRead {
        /// Where to start.
        offset: u16,
    },
    /// 13: scan, rate, filter, fields and contact point method as they are now, also after the next power-up.
    SaveSettings,
    /// 14: the bias in force, taken on command or the calibration's own, also after the next power-up.
    SaveBias,
    /// 15: how the board itself is doing.
    Health,
    /// 16: mean and noise of every channel; answered when it is done.
    SelfTest {
        /// Scans to take, 2 … [`MOST_SCANS`](crate::self_test::MOST_SCANS).
        scans: u16,
    },
    /// 17: go to the chip's own bootloader. The answer comes before.
    Bootloader,
    /// 18: scan differently until the next power-up. The stream's rate is set again by the host.
    SetScan(ScanSettings),
    /// 19: what smooths the signals, set apart from the rate.
    SetFilter {
        /// −3 dB of a second-order low-pass, 1 … a quarter of the scans a second; 0 for none.
        hz: u16,
    },
}

/// Finger to host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// 0, frozen: the answer to the version query.
    Version {
        /// The request's.
        tag: u8,
        /// Version of everything but this message.
        protocol: u16,
        /// Firmware major, minor, patch.
        firmware: [u8; 3],
    },
    /// 1: the answer to any other request.
    Reply {
        /// The request's.
        tag: u8,
        /// What came of it.
        result: Result<Response, Refusal>,
    },
    /// 2: a frame of the stream.
    Frame(#[serde(serialize_with = "frame")] Frame),
}

/// The bytes that a frame has by itself, instead of serde's code for the same, which is 1.7 KB of flash for what a
/// finger never sends like this.
#[inline(never)]
pub(super) fn frame<S: Serializer>(frame: &Frame, serializer: S) -> Result<S::Ok, S::Error> {
    let mut bytes = [0; MAX_PACKET];
    let length = super::frame::serialize(&frame.into(), &mut bytes);
    // The serializer has said which message it is.
    let frame = length.and_then(|length| bytes.get(1..length));
    let frame = frame.ok_or_else(|| S::Error::custom("longer than any packet"))?;
    let mut out = serializer.serialize_tuple(frame.len())?;
    frame.iter().try_for_each(|byte| out.serialize_element(byte))?;
    out.end()
}

/// What a request can bring.
#[expect(clippy::large_enum_variant, reason = "there is no heap to put the large ones on")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Response {
    /// 0: done.
    Done,
    /// 1: to `Info`.
    Info(Info),
    /// 2: to `SetRate`: the rate in force.
    Rate {
        /// In millihertz, as the scan's divider gives it.
        millihertz: u32,
    },
    /// 3: to `TakeBias` and `ReadBias`.
    Bias {
        /// The bias in force.
        bias: Bias,
        /// It was taken on command.
        on_command: bool,
        /// The gate was open while it was taken: the finger may have been under load.
        in_contact: bool,
    },
    /// 4: to `CalibrationRead`.
    Calibration {
        /// Where these bytes belong.
        offset: u16,
        /// The bytes; empty past the end.
        data: Vec<u8, CHUNK>,
    },
    /// 5: to `Health`.
    Health(BoardHealth),
    /// 6: to `SelfTest`.
    SelfTest(SelfTest),
}

/// Why a request was not carried out.
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
    /// 2: another bias is being taken.
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
    /// 8: this board has no such thing.
    Unsupported,
    /// 9: the scan cannot be had with this setting while the others stay as wished; it goes on as it was.
    Scan {
        /// The setting that is in the way.
        setting: ScanSetting,
        /// Least that would do.
        low: u32,
        /// Most that would do.
        high: u32,
    },
}

/// Who this finger is and how it is doing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Info {
    /// The board and its build.
    pub identity: Identity,
    /// Frames a second in force, in millihertz.
    pub rate_millihertz: u32,
    /// Fields in force.
    pub fields: Fields,
    /// The stream is on.
    pub streaming: bool,
    /// How the contact point is found.
    pub point_method: PointMethod,
    /// A bias taken on command is in force.
    pub biased: bool,
    /// The calibration in force, if there is one.
    pub calibration: Option<CalibrationId>,
    /// What has been counted since power-up.
    pub counters: Counters,
    /// What a scan's processing costs.
    pub cost: Cost,
    /// The estimators that its firmware holds: bits that a frame's status sets when they run.
    pub estimators: Status,
    /// Corner of the low-pass over the signals in hertz; 0 for none.
    pub filter_hz: u16,
}

/// What does not change while the finger runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// The board's name, as in `boards/`.
    pub board: String<24>,
    /// The board's own serial number.
    pub serial: String<32>,
    /// Which build of the firmware this is.
    pub build: String<24>,
    /// Scans a second.
    pub scan_hz: u16,
    /// What the codes are fractions of.
    pub full_scale: FullScale,
    /// Ticks a second of [`Cost`].
    pub tick_hz: u32,
}

/// How the board itself is doing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BoardHealth {
    /// Why it started.
    pub reset: Reset,
    /// Where and why the firmware panicked last, if that is why it started.
    pub panic: Option<String<96>>,
    /// Reading a scan out of the converters' buffers, in the identity's ticks.
    pub reading: Option<Cost>,
    /// Packing a frame and handing it to the link.
    pub sending: Option<Cost>,
    /// The most bytes of stack in use since power-up, of how many.
    pub stack: Option<(u32, u32)>,
    /// How it scans.
    pub scan: Option<ScanSettings>,
}

/// Why a board started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Reset {
    /// 0: it cannot tell.
    #[default]
    Unknown,
    /// 1: the supply came, or was too low.
    Power,
    /// 2: the reset pin.
    Pin,
    /// 3: the firmware asked for it; after a panic, too.
    Software,
    /// 4: no scan came through for too long.
    Watchdog,
    /// 5: option bytes or a low-power mode.
    Other,
}

/// Which calibration is in force.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationId {
    /// Serial number of the finger it was made for.
    pub serial: String<32>,
    /// When, in seconds since 1970-01-01 UTC.
    pub date: u64,
    /// CRC-32 of the record.
    pub crc: u32,
}

/// Counted since power-up, wrapping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Scans processed.
    pub scans: u32,
    /// Frames due to the stream.
    pub frames: u32,
    /// Of those, frames dropped because the link was full.
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
    /// The last scan.
    pub last: u32,
    /// The dearest since power-up.
    pub worst: u32,
}

impl Cost {
    /// One more.
    pub fn note(&mut self, ticks: u32) {
        *self = Self { last: ticks, worst: self.worst.max(ticks) };
    }
}
