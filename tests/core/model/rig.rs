//! The real session on a link in memory, byte for byte next to the [`Model`].

use std::cell::RefCell;
use std::convert::Infallible;
use std::future::poll_fn;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use embedded_io_async::{ErrorType, Read, Write};
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::frame::{Fields, Status};
use taxel::instrument::Instrument;
use taxel::scan::{Scan, ScanSetting, ScanSettings};
use taxel::session::{Board, Buffers, End, Pace, run_session};
use taxel::store::{RamFlash, Store};
use taxel::units::{Code, FullScale, Micros};
use taxel::wire::message::Refusal;

use super::wire::{self, LONGEST};
use super::{FASTEST, Facts, Model};
use crate::common::{calibration, everything, identity, pressed, store, unloaded};

/// Turns of the session after which an answer is missing; a bias takes 65 535 scans at most.
const PATIENCE: u32 = 100_000;

/// Planted faults, each at the reply or bad packet of this number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    DropReply(u64),
    RepeatReply(u64),
    /// Two replies change places.
    SwapReplies(u64),
    CountTwice(u64),
}

/// Board whose scans are always ready: mostly still, at times moving or saturated.
struct Desk {
    store: Store<RamFlash<Vec<u8>>>,
    equipped: bool,
    scans: u64,
    still: Scan,
    moving: [Scan; 2],
    saturated: Scan,
}

impl Desk {
    fn new(equipped: bool) -> Self {
        let mut saturated = unloaded(0);
        saturated.codes.taxels.iter_mut().for_each(|taxels| taxels.lit[1][2] = Code(u16::MAX));
        let moving = [pressed(0, 5, 9000), pressed(0, 6, 3000)];
        Self { store: store(), equipped, scans: 0, still: unloaded(0), moving, saturated }
    }
}

impl Board for Desk {
    type Flash = RamFlash<Vec<u8>>;

    async fn scan(&mut self) -> Option<Scan> {
        let scan = match self.scans / 256 % 8 {
            3 => &self.moving[usize::from(self.scans.is_multiple_of(2))],
            5 => &self.saturated,
            _ => &self.still,
        };
        let time = Micros(250 * self.scans);
        self.scans += 1;
        Some(Scan { time, ..*scan })
    }

    fn ticks(&self) -> u32 {
        0
    }

    fn store(&mut self) -> &mut Store<Self::Flash> {
        &mut self.store
    }

    fn bootloader(&mut self) -> Result<(), Refusal> {
        if self.equipped { Ok(()) } else { Err(Refusal::Unsupported) }
    }

    fn set_scan(&mut self, settings: &ScanSettings) -> Result<FullScale, Refusal> {
        if (1..=FASTEST).contains(&u64::from(settings.scan_hz)) {
            return Ok(FullScale::BITS_16);
        }
        Err(Refusal::Scan { setting: ScanSetting::ScanHz, low: 1, high: FASTEST as u32 })
    }

    fn hold_row(&mut self, _: Option<u8>) -> Result<(), Refusal> {
        if self.equipped { Ok(()) } else { Err(Refusal::Unsupported) }
    }
}

/// Both directions of a link, and the model that sees all their bytes.
struct Link<'l> {
    /// Bytes that the host still has to send.
    bytes: &'l [u8],
    model: &'l mut Model,
    fault: Option<Fault>,
    /// State of the generator of lengths.
    luck: u32,
    /// Whether the host takes bytes late at times, and turns until it takes the next ones.
    slow: bool,
    stall: usize,
    closed: bool,
    /// Begin of the finger's next packet.
    packet: Vec<u8>,
    /// Reply that a fault holds back.
    held_back: Option<Vec<u8>>,
    /// Scans that the board has given when the message came.
    scans: u64,
    wrong: Option<String>,
}

impl Link<'_> {
    fn luck(&mut self, below: usize) -> usize {
        self.luck ^= self.luck << 13;
        self.luck ^= self.luck >> 17;
        self.luck ^= self.luck << 5;
        self.luck as usize % below
    }

    /// Whether the host takes nothing in this turn. Some pauses are so long that the link fills.
    fn stalls(&mut self) -> bool {
        if self.stall == 0 {
            let longest = if self.luck(32) == 0 { 200 } else { 8 };
            self.stall = self.luck(longest);
        } else {
            self.stall -= 1;
        }
        self.stall > 0
    }

    /// Sends the next bytes: in half of the cases all that fit.
    fn send(&mut self, buffer: &mut [u8]) -> usize {
        let most = if self.luck(2) == 0 { buffer.len() } else { 1 + self.luck(buffer.len()) };
        let mut length = most.min(self.bytes.len());
        if let Some(Fault::CountTwice(number)) = self.fault
            && self.model.bad >= number
        {
            if self.model.between_packets() {
                buffer[..2].copy_from_slice(&[7, 0]);
                self.fault = None;
                return 2;
            }
            let end = self.bytes.iter().take(length).position(|byte| *byte == 0);
            length = end.map_or(length, |end| end + 1);
        }
        let (now, later) = self.bytes.split_at(length);
        buffer[..length].copy_from_slice(now);
        self.model.receive(now);
        self.bytes = later;
        length
    }

    fn take(&mut self, bytes: &[u8]) {
        for byte in bytes {
            if *byte != 0 {
                self.packet.push(*byte);
                continue;
            }
            let packet = std::mem::take(&mut self.packet);
            match wire::message(&packet).filter(|_| packet.len() < LONGEST) {
                Some(message) => self.pass(message),
                None => self.note(Err(format!(
                    "byte {}: expected a whole packet, found {packet:02x?}",
                    self.model.at
                ))),
            }
        }
    }

    /// Passes a message to the model unless a fault is in the way.
    fn pass(&mut self, message: Vec<u8>) {
        let number = self.model.compared.replies + 1;
        let is_reply = message.first() != Some(&2);
        if is_reply && let Some(first) = self.held_back.take() {
            self.compare(&message);
            return self.compare(&first);
        }
        match self.fault.filter(|_| is_reply) {
            Some(Fault::DropReply(at)) if at == number => self.fault = None,
            Some(Fault::RepeatReply(at)) if at == number => {
                self.fault = None;
                self.compare(&message);
                self.compare(&message);
            }
            Some(Fault::SwapReplies(at)) if at == number => {
                self.fault = None;
                self.held_back = Some(message);
            }
            _ => self.compare(&message),
        }
    }

    fn compare(&mut self, message: &[u8]) {
        let compared = self.model.compare(message, self.scans);
        self.note(compared);
    }

    fn note(&mut self, compared: Result<(), String>) {
        self.wrong = self.wrong.take().or(compared.err());
    }
}

struct Host<'l, 'm>(&'l RefCell<Link<'m>>);

impl ErrorType for Host<'_, '_> {
    type Error = Infallible;
}

impl Read for Host<'_, '_> {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            let mut link = self.0.borrow_mut();
            match link.bytes.is_empty() && !link.closed {
                true => Poll::Pending,
                false => Poll::Ready(Ok(if link.closed { 0 } else { link.send(buffer) })),
            }
        })
        .await
    }
}

impl Write for Host<'_, '_> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            let mut link = self.0.borrow_mut();
            if link.slow && link.stalls() {
                return Poll::Pending;
            }
            let length = if link.luck(2) == 0 { bytes.len() } else { 1 + link.luck(bytes.len()) };
            link.take(&bytes[..length]);
            Poll::Ready(Ok(length))
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// A finger and its model, from power-up on.
pub struct Rig {
    instrument: Instrument,
    board: Desk,
    buffers: Buffers,
    pub model: Model,
    /// Fault that has not happened yet.
    fault: Option<Fault>,
    luck: u32,
}

impl Rig {
    pub fn new(equipped: bool, fault: Option<Fault>, luck: u32) -> Self {
        let facts = Facts {
            firmware: [0, 1, 0],
            names: ["test", "0001", "none"],
            scan_hz: 4000,
            full_scale: u16::MAX,
            tick_hz: 1_000_000,
            fields: u64::from(Fields::ESTIMATES.0),
            estimators: u64::from(Status::BUILT.0),
            equipped,
            records: records(),
        };
        Self {
            instrument: Instrument::new(identity()),
            board: Desk::new(equipped),
            buffers: Buffers::new(),
            model: Model::new(facts),
            fault,
            // The generator stays at zero.
            luck: luck.max(1),
        }
    }

    /// Takes the power away and gives it back; the flash stays as it is.
    pub fn restart(&mut self) {
        let Self { instrument, board, model, .. } = self;
        let flash = std::mem::replace(&mut board.store, store()).into_flash();
        *instrument = Instrument::new(identity());
        let (mut stored, scans) = (Store::new(flash), board.scans);
        *board = Desk { scans, ..Desk::new(board.equipped) };
        instrument.restore(&mut stored, |settings| board.set_scan(settings));
        board.store = stored;
        model.restart();
    }

    /// Runs a session with a host that sends `bytes` and leaves when all is answered.
    ///
    /// # Errors
    /// The position of the first difference from the model, and what was expected and found.
    pub fn session(&mut self, bytes: &[u8], pace: Pace) -> Result<(), String> {
        self.model.connect(pace == Pace::Lossless);
        let link = RefCell::new(Link {
            bytes,
            model: &mut self.model,
            fault: self.fault,
            luck: self.luck,
            slow: pace == Pace::Live,
            stall: 0,
            closed: false,
            packet: vec![],
            held_back: None,
            scans: 0,
            wrong: None,
        });
        let Self { instrument, board, buffers, .. } = self;
        // An upper bound: the instrument never takes more scans than one a turn.
        let mut scans = board.scans;
        let (rx, tx) = (Host(&link), Host(&link));
        let mut session = pin!(run_session(rx, tx, board, instrument, buffers, pace));
        let mut idle = 0;
        loop {
            scans += 1;
            link.borrow_mut().scans = scans;
            let turn = session.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            let mut link = link.borrow_mut();
            if let Some(wrong) = link.wrong.take() {
                return Err(wrong);
            }
            match turn {
                Poll::Ready(Ok(End::Closed)) if link.closed => break,
                Poll::Ready(end) => {
                    let at = link.model.at;
                    return Err(format!("byte {at}: expected more of the session, found {end:?}"));
                }
                Poll::Pending => {}
            }
            if !link.bytes.is_empty() {
                continue;
            }
            idle += 1;
            let Model { at, .. } = *link.model;
            let owed = link.model.owed();
            // Without scans, a bias or a self-test stays under way.
            let scanning = pace == Pace::Live || link.model.streaming();
            let waits = owed > 0 || (scanning && link.model.busy());
            link.closed = !waits && idle > 8;
            if idle > PATIENCE {
                return Err(format!(
                    "byte {at}: expected {owed} more replies or a late one, found none"
                ));
            }
        }
        let link = link.borrow();
        (self.fault, self.luck) = (link.fault, link.luck);
        Ok(())
    }
}

/// Replays the input of a fuzzer: settings, and parts of a stream with their lengths.
///
/// # Errors
/// Those of [`Rig::session`].
pub fn replay(input: &[u8]) -> Result<(), String> {
    let Some((settings, mut rest)) = input.split_first() else { return Ok(()) };
    // The CRC rejects most inputs, so parts of them are packed; the others are sent as they are.
    let mut sent = vec![];
    while let Some((head, tail)) = rest.split_first() {
        let (part, tail) = tail.split_at(usize::from(head & 127).min(tail.len()));
        if *head < 128 {
            sent.extend(wire::packet(part))
        } else {
            sent.extend(part)
        }
        rest = tail;
    }
    let mut rig = Rig::new(settings & 1 == 1, None, u32::from(*settings));
    let pace = if settings & 2 == 2 { Pace::Live } else { Pace::Lossless };
    // The second session begins with what the first one left, or saved.
    for _ in 0..2 {
        rig.session(&sent, pace)?;
        if settings & 4 == 4 {
            rig.restart();
        }
    }
    Ok(())
}

/// Records that a finger accepts: some sections, every section, and none.
pub fn records() -> Vec<Vec<u8>> {
    let bytes = |record: &Calibration| {
        record.to_bytes(&mut [0; MAX_BYTES]).expect("the records of the tests are valid").to_vec()
    };
    [calibration(), everything(), Calibration::EMPTY].iter().map(bytes).collect()
}
