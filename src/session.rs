//! Session with a host: the same code on USB, UART, a pipe and a pty.
//!
//! ```text
//! Board::scan ──▶ Instrument ──frames──▶ ┌──────┐
//!    rx ──requests──▶   └────replies──▶  │ pipe │ ──▶ tx
//!                                        └──────┘
//! ```
//! A single owner of the instrument takes a scan and a request in turn, so that neither starves the
//! other; a pipe of bytes decouples it from the link. Packets enter the pipe whole or not at all. A
//! slow host therefore loses whole frames, which are counted, and never delays the scan. A request
//! is taken only when the pipe has room for its reply, so that no reply is lost. The writer sends
//! all that the pipe holds at once, so that frames share full USB packets.

use core::future::poll_fn;
use core::pin::pin;
use core::task::Poll;

use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::pipe::Pipe;
use embassy_sync::signal::Signal;
use embassy_sync::waitqueue::GenericAtomicWaker;
use embedded_io_async::{Read, Write};

use crate::crc32::crc32;
use crate::instrument::Instrument;
use crate::scan::{ROWS, Scan, ScanSettings};
use crate::store::{Flash, Store};
use crate::units::FullScale;
use crate::wire::deframer::Deframer;
use crate::wire::message::{BoardHealth, Command, Cost, Message, Refusal, Request, Response};
use crate::wire::{MAX_PACKET, WireError, pack, pack_frame_with};

/// Bytes between instrument and link: about four frames with every field, or twenty with the
/// estimates.
const PIPE: usize = 2048;
/// Bytes read at once: those of a USB packet.
const PACKET: usize = 64;

type Bytes = Pipe<NoopRawMutex, PIPE>;

/// Bytes on their way from the instrument to the link.
///
/// The caller keeps them, because a session is copied over the stack when a task starts.
pub struct Buffers {
    pipe: Bytes,
    /// Wakes the session when the link has taken bytes from the pipe.
    taken: GenericAtomicWaker<NoopRawMutex>,
    /// Bytes that the link is being given.
    chunk: [u8; PIPE / 4],
}

impl Buffers {
    /// Makes empty buffers.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            pipe: Bytes::new(),
            taken: GenericAtomicWaker::new(NoopRawMutex::new()),
            chunk: [0; PIPE / 4],
        }
    }
}

impl Default for Buffers {
    fn default() -> Self {
        Self::new()
    }
}

/// Interface of a board to the session.
#[expect(async_fn_in_trait, reason = "single-threaded executors only: no Send bound is wanted")]
pub trait Board {
    /// Flash of the persistent store.
    type Flash: Flash;

    /// Returns the next scan; `None` after the last. Dropping the future must lose nothing.
    async fn scan(&mut self) -> Option<Scan>;

    /// Returns a free-running counter for [`crate::wire::message::Cost`]; 0 if there is none.
    fn ticks(&self) -> u32;

    /// Returns the CRC-32 of a frame's bytes. A chip with a CRC unit may use it.
    fn crc32(&self, bytes: &[u8]) -> u32 {
        crc32(bytes)
    }

    /// Returns the persistent store. Erasing and programming delay the scan.
    fn store(&mut self) -> &mut Store<Self::Flash>;

    /// Returns the state of the board, as far as it is known.
    fn health(&self) -> BoardHealth {
        BoardHealth::default()
    }

    /// Starts the chip's bootloader as soon as the answer has had time to leave.
    ///
    /// # Errors
    /// [`Refusal::Unsupported`] if the board has none.
    fn bootloader(&mut self) -> Result<(), Refusal> {
        Err(Refusal::Unsupported)
    }

    /// Changes the scan settings and returns the codes' full scale.
    ///
    /// # Errors
    /// The setting that cannot be met; the scan then continues unchanged.
    fn set_scan(&mut self, _: &ScanSettings) -> Result<FullScale, Refusal> {
        Err(Refusal::Unsupported)
    }

    /// Lights LED row `row`, 0 … 3, in every step of the scan; `None` lights each in its own again.
    ///
    /// # Errors
    /// [`Refusal::Unsupported`] if the board cannot.
    fn hold_row(&mut self, _: Option<u8>) -> Result<(), Refusal> {
        Err(Refusal::Unsupported)
    }
}

/// Flow control between scans and link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Scans come at their own pace; a full link loses frames. A second passes between two
    /// erasures of flash, so that no host wears it out or stops the scan by them.
    Live,
    /// For replays: scans wait until the stream is on and the link has room.
    Lossless,
}

/// Reasons for the regular end of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// There are no more scans, and all due frames have been sent.
    Scans,
    /// The host closed the link.
    Closed,
}

/// Reasons for a failed session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionError<R, W> {
    /// Reading from the link failed.
    Read(R),
    /// Writing to the link failed.
    Write(W),
}

/// Runs until the scans end, the host closes the link, or the link fails. The instrument keeps its
/// settings for the next session.
///
/// # Errors
/// The error of the link.
pub async fn run_session<R: Read, W: Write>(
    rx: R,
    mut tx: W,
    board: &mut impl Board,
    instrument: &mut Instrument,
    buffers: &mut Buffers,
    pace: Pace,
) -> Result<End, SessionError<R::Error, W::Error>> {
    let Buffers { pipe, taken, chunk } = buffers;
    // Drops what the last session left.
    *pipe = Bytes::new();
    let done = Signal::<NoopRawMutex, ()>::new();
    let mut transmit = pin!(transmit(&mut tx, pipe, taken, chunk, &done));
    // The last session may have been dropped.
    release_host(board, instrument);
    let converse = converse(rx, board, instrument, pipe, taken, pace);
    let first = select(converse, transmit.as_mut()).await;
    release_host(board, instrument);
    let ended = match first {
        Either::First(ended) => ended.map_err(SessionError::Read)?,
        // The writer returns by itself only when the link fails.
        Either::Second(stopped) => {
            return stopped.map(|()| End::Closed).map_err(SessionError::Write);
        }
    };
    if ended == End::Scans {
        done.signal(());
        transmit.await.map_err(SessionError::Write)?;
    }
    Ok(ended)
}

async fn transmit<W: Write>(
    tx: &mut W,
    pipe: &Bytes,
    taken: &GenericAtomicWaker<NoopRawMutex>,
    chunk: &mut [u8],
    done: &Signal<NoopRawMutex, ()>,
) -> Result<(), W::Error> {
    loop {
        // In this order, so that the rest of the pipe is sent before `done` is checked.
        let length = match select(pipe.read(chunk), done.wait()).await {
            Either::First(length) => length,
            Either::Second(()) => return Ok(()),
        };
        taken.wake();
        tx.write_all(chunk.get(..length).unwrap_or_default()).await?;
        if pipe.is_empty() {
            tx.flush().await?;
        }
    }
}

/// Ends a bias, a self-test and a held row of the last host.
#[inline(never)]
fn release_host(board: &mut impl Board, instrument: &mut Instrument) {
    instrument.forget_host();
    if instrument.row_held() {
        // A board that could hold a row can let it go.
        let _ = board.hold_row(None);
        instrument.set_row_held(false);
    }
}

async fn converse<R: Read>(
    mut rx: R,
    board: &mut impl Board,
    instrument: &mut Instrument,
    pipe: &Bytes,
    taken: &GenericAtomicWaker<NoopRawMutex>,
    pace: Pace,
) -> Result<End, R::Error> {
    let mut deframer = Deframer::<MAX_PACKET>::default();
    let mut packet = [0; PACKET];
    // Positions of the packet's bytes that are still to be deframed.
    let mut unread = 0..0;
    let mut buffer = [0; MAX_PACKET];
    let mut sending = Cost::default();
    // Whether the last turn was a scan's, and whether none has come since the scan was restarted.
    let (mut scanned, mut restarted) = (false, false);
    loop {
        let scanning = pace == Pace::Live || instrument.streaming();
        let reserve = if pace == Pace::Live { reply_reserve(instrument) } else { 0 };
        let waiting = !unread.is_empty();
        let mut scan = None;
        let turn = {
            let (mut scans, mut read) = (pin!(board.scan()), pin!(rx.read(&mut packet)));
            // The one that did not have the last turn is asked first. The scan is left where it is
            // read, because as a part of the turn it would be copied three times.
            poll_fn(|context| {
                for host in [scanned, !scanned] {
                    if !host {
                        if scanning && let Poll::Ready(next) = scans.as_mut().poll(context) {
                            scan = next;
                            return Poll::Ready(Either::First(()));
                        }
                        continue;
                    }
                    if restarted && scanning {
                        continue;
                    }
                    if pipe.free_capacity() < reserve {
                        taken.register(context.waker());
                        continue;
                    }
                    if waiting {
                        return Poll::Ready(Either::Second(None));
                    }
                    if let Poll::Ready(length) = read.as_mut().poll(context) {
                        return Poll::Ready(Either::Second(Some(length)));
                    }
                }
                Poll::Pending
            })
            .await
        };
        match turn {
            Either::First(()) => {
                let Some(scan) = &scan else { return Ok(End::Scans) };
                (scanned, restarted) = (true, false);
                let before = board.ticks();
                let outcome = instrument.scan(scan);
                let late = if outcome.reply { instrument.take_reply() } else { None };
                instrument.note_cost(board.ticks().wrapping_sub(before));
                reply(&late, &mut buffer, pipe, instrument, pace).await;
                if outcome.frame {
                    let before = board.ticks();
                    let crc = |bytes: &[u8]| board.crc32(bytes);
                    let packed = pack_frame_with(instrument.frame(scan), &mut buffer, crc);
                    if !offer(packed, reply_reserve(instrument), pipe, pace).await {
                        let counters = instrument.counters();
                        counters.lost = counters.lost.wrapping_add(1);
                    }
                    sending.note(board.ticks().wrapping_sub(before));
                }
            }
            Either::Second(received) => {
                scanned = false;
                match received.transpose()? {
                    None => {}
                    Some(0) => return Ok(End::Closed),
                    Some(length) => unread = 0..length,
                }
                let mut bytes = unread.by_ref().filter_map(|at| packet.get(at));
                let answer = match bytes.find_map(|byte| deframer.push::<Request>(*byte)) {
                    None => None,
                    Some(Ok(request)) => {
                        // A host that restarts the scan again and again would stop it.
                        restarted = matches!(
                            request.command,
                            Command::SetScan(_) | Command::HoldRow { .. }
                        );
                        answer(&request, board, instrument, pace, sending)
                    }
                    Some(Err(_)) => {
                        let counters = instrument.counters();
                        counters.bad_packets = counters.bad_packets.wrapping_add(1);
                        None
                    }
                };
                reply(&answer, &mut buffer, pipe, instrument, pace).await;
            }
        }
        // Scans and requests that are always ready would never let the link run.
        yield_now().await;
    }
}

/// Returns the bytes of the pipe that frames leave to replies: to that of the next request, and to
/// one that comes with a scan.
fn reply_reserve(instrument: &Instrument) -> usize {
    if instrument.busy() { 2 * MAX_PACKET } else { MAX_PACKET }
}

/// Passes board commands to the board and all others to the instrument.
#[inline(never)]
fn answer(
    request: &Request,
    board: &mut impl Board,
    instrument: &mut Instrument,
    pace: Pace,
    sending: Cost,
) -> Option<Message> {
    let result = match &request.command {
        Command::Health => {
            let erasures = Some(board.store().erasures());
            Ok(Response::Health(BoardHealth { sending: Some(sending), erasures, ..board.health() }))
        }
        Command::Bootloader => board.bootloader().map(|()| Response::Done),
        Command::SetScan(_) if instrument.busy() => Err(Refusal::Busy),
        Command::SetScan(settings) => board.set_scan(settings).map(|full_scale| {
            instrument.rescanned(settings, full_scale);
            Response::Done
        }),
        Command::HoldRow { .. } if instrument.busy() => Err(Refusal::Busy),
        Command::HoldRow { row: Some(row) } if usize::from(*row) >= ROWS => {
            Err(Refusal::OutOfRange { low: 0, high: ROWS as u32 - 1 })
        }
        Command::HoldRow { row } => board.hold_row(*row).map(|()| {
            instrument.set_row_held(row.is_some());
            Response::Done
        }),
        Command::CalibrationBegin { .. } | Command::SaveSettings | Command::SaveBias
            if pace == Pace::Live && instrument.erased_lately() =>
        {
            Err(Refusal::Busy)
        }
        _ => {
            let before = board.store().erasures();
            let answer = instrument.handle(request, board.store());
            if board.store().erasures() != before {
                instrument.note_erasure();
            }
            return answer;
        }
    };
    Some(Message::Reply { tag: request.tag, result })
}

/// Sends a reply, if any. The answer is passed by reference, because it has half a kilobyte and
/// nearly every scan has none.
async fn reply(
    answer: &Option<Message>,
    buffer: &mut [u8; MAX_PACKET],
    pipe: &Bytes,
    instrument: &mut Instrument,
    pace: Pace,
) {
    let Some(message) = answer else { return };
    if !offer(pack(message, buffer), 0, pipe, pace).await {
        let counters = instrument.counters();
        counters.lost_replies = counters.lost_replies.wrapping_add(1);
    }
}

/// Puts a whole packet into the pipe, or nothing if less than `reserve` bytes would remain free.
async fn offer(packed: Result<&[u8], WireError>, reserve: usize, pipe: &Bytes, pace: Pace) -> bool {
    // No message is too long for the buffer (tested); it would count as lost.
    let Ok(packet) = packed else { return false };
    if pace == Pace::Live && pipe.free_capacity() < packet.len() + reserve {
        return false;
    }
    pipe.write_all(packet).await;
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::message::Identity;

    /// No host makes a finger lose a reply, so the pipe is filled by hand.
    #[test]
    fn lost_replies_are_counted_past_the_wrap() {
        let mut instrument = Instrument::new(Identity {
            board: "test".try_into().unwrap(),
            serial: "0001".try_into().unwrap(),
            build: "none".try_into().unwrap(),
            scan_hz: 1000,
            full_scale: FullScale::BITS_16,
            tick_hz: 0,
        });
        instrument.counters().lost_replies = u32::MAX - 1;
        let pipe = Bytes::new();
        pipe.try_write(&[1; PIPE]).unwrap();
        let answer = Some(Message::Reply { tag: 1, result: Ok(Response::Done) });
        let mut buffer = [0; MAX_PACKET];
        for expected in [u32::MAX, 0, 1] {
            let sent = reply(&answer, &mut buffer, &pipe, &mut instrument, Pace::Live);
            embassy_futures::block_on(sent);
            assert_eq!(instrument.counters().lost_replies, expected);
        }
    }
}
