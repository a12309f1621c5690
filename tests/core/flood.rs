//! Hosts that send without pause and scans that never wait: neither side starves the other.

use std::cell::Cell;
use std::convert::Infallible;
use std::future::poll_fn;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use crate::common::{identity, store, unloaded};
use embedded_io_async::{ErrorType, Read, Write};
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::Fields;
use taxel::instrument::Instrument;
use taxel::scan::{Scan, ScanSettings};
use taxel::session::{Board, Buffers, Pace, run_session};
use taxel::store::{Area, Flash, FlashError, RamFlash, Store, Word};
use taxel::units::FullScale;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{CHUNK, Command, Counters, Message, Refusal, Request};
use taxel::wire::{MAX_PACKET, pack};

/// Microseconds between scans.
const PERIOD: u64 = 250;
/// Scans that wait for the session, as in the firmware.
const QUEUE: u64 = 4;
/// Microseconds that the link takes for an USB packet.
const PACKET: u64 = 60;
/// Microseconds that an erasure takes.
const ERASURE: u64 = 25_000;
/// Longest time without a scan outside an erasure, microseconds.
const LONGEST_GAP: u64 = 2_000;

/// Simulated time, and how scan and link fare.
struct World {
    /// Microseconds since the start.
    now: Cell<u64>,
    erasing: Cell<u64>,
    /// Time of the scan's last start, and scans since then that were taken or lost.
    begun: Cell<(u64, u64)>,
    /// Lost scans that no later one has reported yet.
    unreported: Cell<u64>,
    /// Scans that were taken or reported as lost.
    scans: Cell<u64>,
    /// Time of the last scan, and of erasures before.
    last_scan: Cell<(u64, u64)>,
    /// Time of the last byte or reply.
    last_traffic: Cell<u64>,
    frames: Cell<u32>,
    /// Replies by tag.
    replies: [Cell<u32>; 256],
}

impl World {
    /// Scans that wait for the session.
    fn waiting(&self) -> u64 {
        let (begun, before) = self.begun.get();
        (self.now.get() - begun) / PERIOD - before
    }

    /// Starts the scan again: those that wait and the one under way are lost.
    fn restart(&self) {
        self.unreported.set(self.unreported.get() + self.waiting() + 1);
        self.begun.set((self.now.get(), 0));
    }

    fn pass(&self, us: u64) {
        self.now.set(self.now.get() + us);
        let (last, erasing) = self.last_scan.get();
        let gap = self.now.get() - last - (self.erasing.get() - erasing);
        assert!(gap <= LONGEST_GAP, "no scan for {gap} µs");
    }
}

/// Memory whose erasures take time.
struct SlowFlash<'w>(RamFlash<Vec<u8>>, &'w World);

impl Flash for SlowFlash<'_> {
    fn bytes(&self, area: Area) -> &[u8] {
        self.0.bytes(area)
    }

    fn erase(&mut self, area: Area) -> Result<(), FlashError> {
        self.1.erasing.set(self.1.erasing.get() + ERASURE);
        self.1.pass(ERASURE);
        self.0.erase(area)
    }

    fn program(&mut self, area: Area, offset: usize, word: Word) -> Result<(), FlashError> {
        self.0.program(area, offset, word)
    }
}

/// A board whose scans are due in simulated time.
struct Due<'w> {
    world: &'w World,
    store: Store<SlowFlash<'w>>,
    /// Microseconds that the session works for a scan.
    work: u64,
}

impl<'w> Board for Due<'w> {
    type Flash = SlowFlash<'w>;

    async fn scan(&mut self) -> Option<Scan> {
        let World { now, erasing, begun, unreported, scans, last_scan, .. } = self.world;
        let waiting = || self.world.waiting();
        poll_fn(|_| if waiting() == 0 { Poll::Pending } else { Poll::Ready(()) }).await;
        let late = waiting().saturating_sub(QUEUE);
        begun.set((begun.get().0, begun.get().1 + late + 1));
        let lost = late + unreported.take();
        scans.set(scans.get() + lost + 1);
        last_scan.set((now.get(), erasing.get()));
        self.world.pass(self.work);
        Some(Scan { lost: lost as u32, ..unloaded(scans.get() * PERIOD) })
    }

    fn ticks(&self) -> u32 {
        0
    }

    fn store(&mut self) -> &mut Store<SlowFlash<'w>> {
        &mut self.store
    }

    fn bootloader(&mut self) -> Result<(), Refusal> {
        Ok(())
    }

    fn set_scan(&mut self, _: &ScanSettings) -> Result<FullScale, Refusal> {
        self.world.restart();
        Ok(FullScale::BITS_16)
    }

    fn hold_row(&mut self, _: Option<u8>) -> Result<(), Refusal> {
        self.world.restart();
        Ok(())
    }
}

/// A host's sending side, whose next packet is always ready until the bytes end.
struct Flood<'w, I>(I, &'w World);

impl<I> ErrorType for Flood<'_, I> {
    type Error = Infallible;
}

impl<I: Iterator<Item = u8>> Read for Flood<'_, I> {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            let slots = buffer.iter_mut();
            let length = slots.zip(&mut self.0).map(|(slot, byte)| *slot = byte).count();
            if length == 0 {
                return Poll::Pending;
            }
            self.1.last_traffic.set(self.1.now.get());
            self.1.pass(5);
            Poll::Ready(Ok(length))
        })
        .await
    }
}

/// A host's receiving side, which takes one packet after the other from some time on.
struct Taker<'w> {
    world: &'w World,
    from: u64,
    deframer: Deframer,
}

impl ErrorType for Taker<'_> {
    type Error = Infallible;
}

impl Write for Taker<'_> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let World { now, last_traffic, replies, frames, .. } = self.world;
        let ready = || now.get() >= self.from;
        poll_fn(|_| if ready() { Poll::Ready(()) } else { Poll::Pending }).await;
        self.from = now.get() + PACKET;
        let packet = &bytes[..bytes.len().min(64)];
        for message in packet.iter().filter_map(|byte| self.deframer.push(*byte)) {
            let count = match message.unwrap() {
                Message::Frame(_) => frames,
                Message::Reply { tag, .. } | Message::Version { tag, .. } => {
                    last_traffic.set(now.get());
                    &replies[usize::from(tag)]
                }
            };
            count.set(count.get() + 1);
        }
        Ok(packet.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Result of a session.
struct Outcome {
    counters: Counters,
    /// Replies by tag.
    replies: Vec<u32>,
    /// Microseconds until the last reply.
    took: u64,
}

/// Runs a session with a host that sends `bytes`, and takes nothing before `from`. The session
/// works `work` for each scan; all are in microseconds.
fn run(bytes: impl Iterator<Item = u8>, from: u64, work: u64) -> Outcome {
    let world = World {
        now: Cell::new(0),
        erasing: Cell::new(0),
        begun: Cell::new((0, 0)),
        unreported: Cell::new(0),
        scans: Cell::new(0),
        last_scan: Cell::new((0, 0)),
        last_traffic: Cell::new(0),
        frames: Cell::new(0),
        replies: [const { Cell::new(0) }; 256],
    };
    let mut instrument = Instrument::new(identity());
    let store = Store::new(SlowFlash(store().into_flash(), &world));
    let mut board = Due { world: &world, store, work };
    let tx = Taker { world: &world, from, deframer: Deframer::default() };
    let (rx, mut buffers) = (Flood(bytes, &world), Buffers::new());
    {
        let mut session =
            pin!(run_session(rx, tx, &mut board, &mut instrument, &mut buffers, Pace::Live));
        // Rests of scans, frames and late replies come soon after the last byte and reply.
        while world.now.get() < world.last_traffic.get().max(from) + 40 * ERASURE {
            assert!(session.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending());
            world.pass(10);
        }
    }
    let counters = *instrument.counters();
    let due = (world.scans.get() + world.unreported.get() + world.waiting()) as i64;
    let accounted = i64::from(counters.scans) + i64::from(counters.overruns);
    let late = if work < PERIOD { 1 } else { QUEUE as i64 };
    assert!((due - accounted).abs() <= late, "{accounted} of {due} scans");
    // Some frames are still on their way.
    let frames = counters.frames - counters.lost;
    assert!((frames - world.frames.get()) < 40, "{} of {frames} frames", world.frames.get());
    let replies = world.replies.iter().map(Cell::get).collect();
    Outcome { counters, replies, took: world.last_traffic.get() }
}

fn packet(tag: u8, command: Command) -> Vec<u8> {
    pack(&Request { tag, command }, &mut [0; MAX_PACKET]).unwrap().to_vec()
}

/// One request of each kind.
fn commands() -> [Command; 21] {
    let data = heapless::Vec::from_slice(&[7; CHUNK]).unwrap();
    [
        Command::Version,
        Command::Info,
        Command::Stream(true),
        Command::SetRate { hz: 4000 },
        Command::SetFields(Fields::ALL),
        Command::SetPointMethod(PointMethod::ArgMin),
        Command::TakeBias { scans: 2 },
        Command::ReadBias,
        Command::ClearBias,
        Command::CalibrationBegin { length: 4000 },
        Command::CalibrationChunk { offset: 0, data },
        Command::CalibrationCommit,
        Command::CalibrationRead { offset: 0 },
        Command::SaveSettings,
        Command::SaveBias,
        Command::Health,
        Command::SelfTest { scans: 2 },
        Command::Bootloader,
        Command::SetScan(ScanSettings { scan_hz: 4000, oversampling: 1, settle_ns: 7000 }),
        Command::SetFilter { hz: 50 },
        Command::HoldRow { row: Some(1) },
    ]
}

/// Requests before all others: the link has more frames than it can carry.
fn full_stream() -> Vec<u8> {
    let requests =
        [Command::SetRate { hz: 4000 }, Command::SetFields(Fields::ALL), Command::Stream(true)];
    requests.into_iter().flat_map(|command| packet(0, command)).collect()
}

/// Each reply of `sent` requests with the tags 1, 2 … 255, 1 … came once.
fn assert_all_answered(replies: &[u32], sent: u32) {
    for (tag, replies) in (1..).zip(&replies[1..]) {
        let requests = sent / 255 + u32::from(tag <= sent % 255);
        assert_eq!(*replies, requests, "replies with tag {tag}");
    }
}

#[test]
fn commands_cover_the_protocol() {
    for (number, command) in commands().into_iter().enumerate() {
        let mut packet = packet(1, command);
        packet.pop();
        cobs::decode_in_place(&mut packet).unwrap();
        assert_eq!(usize::from(packet[1]), number);
    }
}

#[test]
fn pipelined_commands_are_all_answered() {
    const EACH: u32 = 10_000;
    for command in commands() {
        let requests = (0..EACH).flat_map(|i| packet((i % 255 + 1) as u8, command.clone()));
        let outcome = run(full_stream().into_iter().chain(requests), 0, 100);
        assert_all_answered(&outcome.replies, EACH);
        let Counters { bad_packets, lost_replies, .. } = outcome.counters;
        assert_eq!((bad_packets, lost_replies), (0, 0), "{command:?}");
    }
}

#[test]
fn zeros_and_garbage_delay_no_scan() {
    const BYTES: usize = 10_000_000;
    let zeros = run(std::iter::repeat_n(0, BYTES).chain(packet(1, Command::Info)), 0, 100);
    assert_eq!((zeros.counters.bad_packets, zeros.replies[1]), (0, 1));
    // A linear congruential generator; a zero ends the garbage.
    let mut state = 1_u32;
    let garbage = (0..BYTES).map(|_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    });
    let bytes = full_stream().into_iter().chain(garbage).chain([0]).chain(packet(1, Command::Info));
    let garbage = run(bytes, 0, 100);
    assert!(garbage.counters.bad_packets > 30_000);
    assert_eq!(garbage.replies[1], 1);
}

#[test]
fn host_that_reads_late_gets_every_reply() {
    let requests = (0..1000).flat_map(|i| packet((i % 255 + 1) as u8, Command::Info));
    let outcome = run(full_stream().into_iter().chain(requests), 3_000_000, 100);
    assert_all_answered(&outcome.replies, 1000);
    assert_eq!(outcome.counters.lost_replies, 0);
}

#[test]
fn scans_that_never_wait_delay_no_reply() {
    let requests = (0..1000).flat_map(|i| packet((i % 255 + 1) as u8, Command::ClearBias));
    // The session takes longer for a scan than the next one takes to come.
    let outcome = run(requests, 0, 300);
    assert_all_answered(&outcome.replies, 1000);
    assert!(outcome.took < 1000 * 400, "{} µs", outcome.took);
}
