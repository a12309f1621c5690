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
    /// Longest time without a scan outside an erasure, microseconds.
    longest_gap: Cell<u64>,
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
        self.longest_gap.set(self.longest_gap.get().max(gap));
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

/// Planted fault, of the scan or reply [`PLANTED`].
#[derive(Clone, Copy, Debug, PartialEq)]
enum Plant {
    None,
    /// The link loses the reply.
    LostReply,
    /// The link delivers the reply twice.
    DoubledReply,
    /// The session hangs for 3 ms in the scan.
    Pause,
    /// The board counts no scans as lost.
    UncountedScans,
}

/// Number of the scan or reply with a planted fault.
const PLANTED: u64 = 100;

/// A board whose scans are due in simulated time.
struct Due<'w> {
    world: &'w World,
    store: Store<SlowFlash<'w>>,
    /// Microseconds that the session works for a scan.
    work: u64,
    plant: Plant,
}

impl<'w> Board for Due<'w> {
    type Flash = SlowFlash<'w>;

    async fn scan(&mut self) -> Option<Scan> {
        let World { now, erasing, begun, unreported, scans, last_scan, .. } = self.world;
        let waiting = || self.world.waiting();
        poll_fn(|_| if waiting() == 0 { Poll::Pending } else { Poll::Ready(()) }).await;
        let late = waiting().saturating_sub(QUEUE);
        begun.set((begun.get().0, begun.get().1 + late + 1));
        let (first, lost) = (scans.get(), late + unreported.take());
        scans.set(first + lost + 1);
        last_scan.set((now.get(), erasing.get()));
        let pauses = self.plant == Plant::Pause && (first..=first + lost).contains(&PLANTED);
        self.world.pass(if pauses { 3_000 } else { self.work });
        let reported = if self.plant == Plant::UncountedScans { 0 } else { lost as u32 };
        Some(Scan { lost: reported, ..unloaded(scans.get() * PERIOD) })
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
    replies: u64,
    plant: Plant,
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
                Message::Frame(_) => {
                    frames.set(frames.get() + 1);
                    continue;
                }
                Message::Reply { tag, .. } | Message::Version { tag, .. } => {
                    last_traffic.set(now.get());
                    &replies[usize::from(tag)]
                }
            };
            let times = match self.plant {
                Plant::LostReply if self.replies == PLANTED => 0,
                Plant::DoubledReply if self.replies == PLANTED => 2,
                _ => 1,
            };
            self.replies += 1;
            count.set(count.get() + times);
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
///
/// Fails if a scan comes late, or a scan or a frame is not accounted for.
fn run(bytes: impl Iterator<Item = u8>, from: u64, work: u64) -> Result<Outcome, String> {
    run_with(Plant::None, bytes, from, work)
}

fn run_with(
    plant: Plant,
    bytes: impl Iterator<Item = u8>,
    from: u64,
    work: u64,
) -> Result<Outcome, String> {
    let world = World {
        now: Cell::new(0),
        erasing: Cell::new(0),
        begun: Cell::new((0, 0)),
        unreported: Cell::new(0),
        scans: Cell::new(0),
        last_scan: Cell::new((0, 0)),
        longest_gap: Cell::new(0),
        last_traffic: Cell::new(0),
        frames: Cell::new(0),
        replies: [const { Cell::new(0) }; 256],
    };
    let mut instrument = Instrument::new(identity());
    let store = Store::new(SlowFlash(store().into_flash(), &world));
    let mut board = Due { world: &world, store, work, plant };
    let tx = Taker { world: &world, from, deframer: Deframer::default(), replies: 0, plant };
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
    if (due - accounted).abs() > late {
        return Err(format!("{accounted} of {due} scans"));
    }
    let gap = world.longest_gap.get();
    if gap > LONGEST_GAP {
        return Err(format!("no scan for {gap} µs"));
    }
    // Some frames are still on their way.
    let (sent, frames) = (counters.frames - counters.lost, world.frames.get());
    if !(0..40).contains(&sent.wrapping_sub(frames)) {
        return Err(format!("{frames} of {sent} frames"));
    }
    let replies = world.replies.iter().map(Cell::get).collect();
    Ok(Outcome { counters, replies, took: world.last_traffic.get() })
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

impl Outcome {
    /// Fails unless each reply of `sent` requests with the tags 1, 2 … 255, 1 … came once.
    fn all_answered(self, sent: u32) -> Result<Self, String> {
        for (tag, replies) in (1..).zip(&self.replies[1..]) {
            let requests = sent / 255 + u32::from(tag <= sent % 255);
            if *replies != requests {
                return Err(format!("{replies} of {requests} replies with tag {tag}"));
            }
        }
        Ok(self)
    }
}

/// Sends the command `times` times without pause; fails unless each is answered once.
fn pipelined(plant: Plant, command: &Command, times: u32) -> Result<(), String> {
    let requests = (0..times).flat_map(|i| packet((i % 255 + 1) as u8, command.clone()));
    let outcome = run_with(plant, full_stream().into_iter().chain(requests), 0, 100)?;
    let Counters { bad_packets, lost_replies, .. } = outcome.all_answered(times)?.counters;
    let counted = [bad_packets, lost_replies];
    if counted == [0; 2] { Ok(()) } else { Err(format!("{counted:?} bad packets and replies")) }
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
    for command in commands() {
        pipelined(Plant::None, &command, 10_000).unwrap_or_else(|e| panic!("{command:?}: {e}"));
    }
}

#[test]
fn lost_reply_and_late_scan_are_noticed() {
    for (plant, noticed) in [
        (Plant::LostReply, "replies with tag"),
        (Plant::DoubledReply, "replies with tag"),
        (Plant::Pause, "no scan for 3"),
        (Plant::UncountedScans, "scans"),
    ] {
        // Restarts of the scan lose some scans.
        let found = pipelined(plant, &Command::HoldRow { row: None }, 1000).unwrap_err();
        assert!(found.contains(noticed), "{plant:?}: {found}");
    }
    assert_eq!(pipelined(Plant::None, &Command::HoldRow { row: None }, 1000), Ok(()));
}

#[test]
fn zeros_and_garbage_delay_no_scan() {
    const BYTES: usize = 10_000_000;
    let bytes = std::iter::repeat_n(0, BYTES).chain(packet(1, Command::Info));
    let zeros = run(bytes, 0, 100).unwrap();
    assert_eq!((zeros.counters.bad_packets, zeros.replies[1]), (0, 1));
    // A linear congruential generator; a zero ends the garbage.
    let mut state = 1_u32;
    let garbage = (0..BYTES).map(|_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    });
    let bytes = full_stream().into_iter().chain(garbage).chain([0]).chain(packet(1, Command::Info));
    let garbage = run(bytes, 0, 100).unwrap();
    assert!(garbage.counters.bad_packets > 30_000);
    assert_eq!(garbage.replies[1], 1);
}

#[test]
fn host_that_reads_late_gets_every_reply() {
    let requests = (0..1000).flat_map(|i| packet((i % 255 + 1) as u8, Command::Info));
    let outcome = run(full_stream().into_iter().chain(requests), 3_000_000, 100);
    let outcome = outcome.unwrap().all_answered(1000).unwrap();
    assert_eq!(outcome.counters.lost_replies, 0);
}

#[test]
fn scans_that_never_wait_delay_no_reply() {
    let requests = (0..1000).flat_map(|i| packet((i % 255 + 1) as u8, Command::ClearBias));
    // The session takes longer for a scan than the next one takes to come.
    let outcome = run(requests, 0, 300).unwrap().all_answered(1000).unwrap();
    assert!(outcome.took < 1000 * 400, "{} µs", outcome.took);
}
