//! Model of a finger's session: the reply that any stream of bytes must get, after
//! `docs/protocol.md` and without the core.
//!
//! The model takes the bytes that the host sends, and then each message of the finger in its order.
//! The model knows the kind alone of a reply that depends on the scans.
#![allow(dead_code, reason = "the fuzz target and the tests each use a part")]

mod answer;
mod flash;
pub mod rig;
pub mod wire;

use std::collections::VecDeque;

use answer::{Expected, Upload};
use flash::Flash;
use wire::{LONGEST, Reader, Request, put};

/// Highest rate of a scan on the board of the [`rig`], in hertz.
pub const FASTEST: u64 = 8000;
/// Status bit of a frame while a row is held.
const ROW_HELD: u64 = 1 << 15;
/// Most frames that the end of a session can drop: those between finger and link.
const DROPPED: u64 = 300;

/// Properties of a finger that never change.
#[derive(Clone)]
pub struct Facts {
    /// Firmware's version.
    pub firmware: [u8; 3],
    /// Names of the board, its serial number and its build.
    pub names: [&'static str; 3],
    pub scan_hz: u64,
    pub full_scale: u16,
    pub tick_hz: u64,
    /// Fields of the frames at power-up.
    pub fields: u64,
    /// Bits of the estimators that the firmware has.
    pub estimators: u64,
    /// Whether the board has a bootloader and holds rows.
    pub equipped: bool,
    /// Records that the finger accepts.
    pub records: Vec<Vec<u8>>,
}

/// Request that a later scan answers.
struct Late {
    at: u64,
    tag: u8,
    /// Scans and whether a record is stored, for a self-test; `None` for a bias.
    test: Option<(u64, bool)>,
}

/// Request without a reply so far.
struct Asked {
    /// Position of the packet's end in the stream.
    at: u64,
    /// Bad packets before it.
    bad: u64,
    request: Request,
}

/// Settings and bias that a finger keeps without power.
#[derive(Clone, Default)]
struct Saved {
    /// Rate, filter, fields, method, and the rate of the scan if the host set it.
    settings: Option<([u64; 4], Option<u64>)>,
    /// CRC of the calibration under which a bias was taken; `None` for the calibration's own bias.
    bias: Option<[u8; 4]>,
}

/// State of a finger as a host knows it.
pub struct Model {
    facts: Facts,
    /// Bytes since the last zero; no more than show that there are too many.
    packet: Vec<u8>,
    /// Bytes received.
    pub at: u64,
    /// Bad packets received.
    pub bad: u64,
    asked: VecDeque<Asked>,
    late: Option<Late>,
    streaming: bool,
    scan_hz: u64,
    hz: u64,
    filter: u64,
    fields: u64,
    method: u64,
    biased: bool,
    held: bool,
    record: Option<Vec<u8>>,
    upload: Option<Upload>,
    /// Rate of the scan that the host set.
    scan: Option<u64>,
    saved: Saved,
    flash: Flash,
    /// Scans of the last Info.
    scans: u64,
    /// Least number of the next frame.
    seq: u64,
    /// Frames of all sessions, and those lost according to the last Info.
    frames: [u64; 2],
    /// Frames that the ends of sessions dropped, and whether an Info of this session counts them.
    dropped: u64,
    counted: bool,
    /// Number of the next frame, which is unknown when a session begins.
    due: Option<u64>,
    /// Whether the session waits for the link instead of losing frames.
    lossless: bool,
    /// Counts of what was compared.
    pub compared: Compared,
}

/// Counts of compared messages.
#[derive(Clone, Debug, Default)]
pub struct Compared {
    pub requests: u64,
    pub replies: u64,
    pub frames: u64,
    /// Requests for a bias or a self-test that ended with their session.
    pub ended: u64,
    /// Accepted requests by command.
    pub done: [u64; 21],
    /// Refusals by number.
    pub refused: [u64; 10],
}

impl Compared {
    /// Adds the counts of another finger.
    pub fn add(&mut self, other: &Self) {
        let Self { requests, replies, frames, ended, done, refused } = other;
        self.requests += requests;
        self.replies += replies;
        self.frames += frames;
        self.ended += ended;
        self.done.iter_mut().zip(done).for_each(|(sum, more)| *sum += more);
        self.refused.iter_mut().zip(refused).for_each(|(sum, more)| *sum += more);
    }
}

impl Model {
    /// Finger after power-up.
    pub fn new(facts: Facts) -> Self {
        Self {
            packet: vec![],
            at: 0,
            bad: 0,
            asked: VecDeque::new(),
            late: None,
            streaming: false,
            scan_hz: facts.scan_hz,
            hz: facts.scan_hz.min(1000),
            filter: 0,
            fields: facts.fields,
            method: 2,
            biased: false,
            held: false,
            record: None,
            upload: None,
            scan: None,
            saved: Saved::default(),
            flash: Flash::default(),
            scans: 0,
            seq: 0,
            frames: [0; 2],
            dropped: 0,
            counted: false,
            due: None,
            lossless: false,
            compared: Compared::default(),
            facts,
        }
    }

    /// Begins a session: the settings stay; a held row, half a packet, and a bias or a self-test
    /// under way do not.
    pub fn connect(&mut self, lossless: bool) {
        self.lossless = lossless;
        self.packet.clear();
        self.held = false;
        self.leave();
        // The end of the session before may have dropped frames.
        (self.due, self.counted) = (None, false);
    }

    /// Ends the session: a bias or a self-test under way gets no reply.
    pub fn leave(&mut self) {
        self.compared.ended += u64::from(self.late.take().is_some());
    }

    /// Takes the power away and gives it back: what was saved remains.
    pub fn restart(&mut self) {
        self.leave();
        let (at, compared) = (self.at, std::mem::take(&mut self.compared));
        let (record, saved) = (self.record.take(), std::mem::take(&mut self.saved));
        let mut flash = std::mem::take(&mut self.flash);
        flash.restart();
        *self = Self { at, compared, record, flash, ..Self::new(self.facts.clone()) };
        if let Some((settings, scan)) = saved.settings {
            self.scan = scan;
            self.scan_hz = scan.unwrap_or(self.scan_hz);
            [self.hz, self.filter, self.fields, self.method] = settings;
        }
        self.biased = saved.bias.is_some_and(|calibration| calibration == self.calibration());
        self.saved = saved;
    }

    /// CRC of the active calibration; 0 without one.
    fn calibration(&self) -> [u8; 4] {
        self.record.as_ref().and_then(|record| record.last_chunk().copied()).unwrap_or_default()
    }

    /// Replies that must come without another scan.
    pub fn owed(&self) -> usize {
        self.asked.len()
    }

    /// Whether a reply comes with a later scan.
    pub fn busy(&self) -> bool {
        self.late.is_some()
    }

    pub fn streaming(&self) -> bool {
        self.streaming
    }

    /// Whether the last byte ended a packet.
    pub fn between_packets(&self) -> bool {
        self.packet.is_empty()
    }

    /// Takes bytes from the host.
    pub fn receive(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.at += 1;
            if *byte != 0 {
                if self.packet.len() < LONGEST {
                    self.packet.push(*byte);
                }
                continue;
            }
            if self.packet.is_empty() {
                continue;
            }
            let fits = self.packet.len() < LONGEST;
            let message = if fits { wire::message(&self.packet) } else { None };
            self.packet.clear();
            match message.and_then(|message| Request::read(&message)) {
                None => self.bad += 1,
                Some(request) => {
                    self.compared.requests += 1;
                    self.asked.push_back(Asked { at: self.at, bad: self.bad, request });
                    self.postpone();
                }
            }
        }
    }

    /// Compares a message of the finger, which has taken so many scans at most.
    ///
    /// # Errors
    /// The position of the request, and what was expected and found.
    pub fn compare(&mut self, message: &[u8], scans: u64) -> Result<(), String> {
        if message.first() == Some(&2) {
            return self.frame(message).ok_or_else(|| {
                let stream = if self.streaming { "on" } else { "off" };
                let (seq, held, at) = (self.seq, self.held, self.at);
                format!(
                    "byte {at}: expected a frame from {seq} on, row held {held}, only if the stream \
                     is on ({stream}), found {message:02x?}"
                )
            });
        }
        self.compared.replies += 1;
        let Some(Asked { at, bad, request }) = self.asked.front() else {
            if self.finish(message) {
                return Ok(());
            }
            let (at, late) = (self.at, self.late.as_ref().map(|late| late.tag));
            return Err(format!(
                "byte {at}: expected no reply but the late one to {late:?}, found {message:02x?}"
            ));
        };
        let (at, expected) = (*at, self.answer(request, *bad, scans));
        let Request { tag, command, .. } = *request;
        // Before the late reply: where a bias could be either, both come one after the other.
        if self.matches(&expected, message, scans) {
            let Some(Asked { request, .. }) = self.asked.pop_front() else { return Ok(()) };
            match message {
                [1, _, 1, refusal, ..] => self.compared.refused[usize::from(*refusal)] += 1,
                _ => {
                    self.compared.done[usize::from(request.command)] += 1;
                    self.flash.note(request.command, [self.scans, scans], self.scan_hz);
                    self.apply(request);
                }
            }
            self.postpone();
            return Ok(());
        }
        if self.finish(message) {
            return Ok(());
        }
        let late = self.late.as_ref().map(|late| (late.at, late.tag));
        Err(format!(
            "byte {at}: command {command} with tag {tag}: expected {expected:02x?} or the late reply \
             to {late:?}, found {message:02x?}"
        ))
    }

    /// Begins the next request if a later scan answers it.
    fn postpone(&mut self) {
        let next = self.asked.front().map(|asked| &asked.request);
        let Some(Request { tag, command, fields: [scans, ..], .. }) = next else { return };
        let most = if *command == 6 { 65_535 } else { 4096 };
        let waits = matches!(command, 6 | 16) && (2..=most).contains(scans);
        if !waits || self.held || self.late.is_some() {
            return;
        }
        let test = (*command == 16).then_some((*scans, self.record.is_some()));
        self.late = Some(Late { at: self.asked[0].at, tag: *tag, test });
        self.asked.pop_front();
    }

    /// Takes the late reply, if the message is one.
    fn finish(&mut self, message: &[u8]) -> bool {
        let Some(Late { tag, test, .. }) = self.late else { return false };
        let command = match test {
            Some((scans, record)) => {
                let mut begin = vec![1, tag, 0, 6];
                put(&mut begin, scans);
                begin.extend(self.facts.full_scale.to_le_bytes());
                let end: &[u8] = if record { &[1, 1] } else { &[0] };
                if !message.starts_with(&begin) || !message.ends_with(end) {
                    return false;
                }
                16
            }
            // Not still, or saturated.
            None if [[1, tag, 1, 1], [1, tag, 1, 6]].iter().any(|refusal| refusal == message) => {
                self.compared.refused[usize::from(message[3])] += 1;
                self.late = None;
                self.postpone();
                return true;
            }
            None if is_bias(message, tag, true).is_some() => 6,
            None => return false,
        };
        self.biased |= command == 6;
        self.compared.done[command] += 1;
        self.late = None;
        self.postpone();
        true
    }

    fn frame(&mut self, message: &[u8]) -> Option<()> {
        let mut rest = Reader(message);
        let (_, seq, _time) = (rest.byte()?, rest.number(32)?, rest.number(64)?);
        let held = rest.number(32)? & ROW_HELD != 0;
        let codes = rest.flag()? == (self.fields & 1 == 1);
        let lost = self.lossless && self.due.is_some_and(|due| seq != due);
        if !self.streaming || seq < self.seq || lost || held != self.held || !codes {
            return None;
        }
        (self.seq, self.due) = (seq + 1, Some(seq + 1));
        self.frames[0] += 1;
        self.compared.frames += 1;
        Some(())
    }

    fn matches(&mut self, expected: &Expected, message: &[u8], scans: u64) -> bool {
        let tag = self.asked.front().map_or(0, |asked| asked.request.tag);
        match expected {
            Expected::Message(expected) => message == expected,
            Expected::Either(expected, otherwise) => {
                message == expected || self.matches(otherwise, message, scans)
            }
            Expected::Health(begin) => {
                message.strip_prefix(&begin[..]).is_some_and(|rest| self.flash.agrees(rest))
            }
            Expected::Bias(on_command) => is_bias(message, tag, *on_command).is_some(),
            Expected::Judgement => match message {
                [1, at, 0, 0] => *at == tag,
                [1, at, 1, 4, kind, ..] => *at == tag && *kind >= 3,
                _ => false,
            },
            Expected::Info(begin, end) => {
                let counts =
                    message.strip_prefix(&begin[..]).and_then(|m| m.strip_suffix(&end[..]));
                counts.is_some_and(|counts| self.counts(counts, scans).is_some())
            }
        }
    }

    /// Compares scans, frames and lost frames of an Info, which are more than in the last one.
    fn counts(&mut self, counts: &[u8], most: u64) -> Option<()> {
        let mut rest = Reader(counts);
        let (scans, due, lost) = (rest.number(32)?, rest.number(32)?, rest.number(32)?);
        let [received, lost_before] = self.frames;
        let dropped = due.checked_sub(lost)?.checked_sub(received)?;
        let most_dropped = self.dropped + if self.counted { 0 } else { DROPPED };
        let most_lost = if self.lossless && self.counted { lost_before } else { due };
        if !rest.0.is_empty()
            || !(self.scans..=most).contains(&scans)
            || !(lost_before..=most_lost).contains(&lost)
            || !(self.dropped..=most_dropped).contains(&dropped)
        {
            return None;
        }
        (self.scans, self.frames[1]) = (scans, lost);
        (self.dropped, self.counted) = (dropped, true);
        (self.seq, self.due) = (due, Some(due));
        Some(())
    }
}

/// Whether a message is the reply with a bias; its levels depend on the scans.
fn is_bias(message: &[u8], tag: u8, on_command: bool) -> Option<()> {
    let mut rest = Reader(message.strip_prefix(&[1, tag, 0, 3])?);
    for numbers in [17, 4, 4, 4, 4] {
        if rest.flag()? {
            rest.bytes(4 * numbers)?;
        }
    }
    let same = rest.flag()? == on_command;
    rest.flag()?;
    (same && rest.0.is_empty()).then_some(())
}
