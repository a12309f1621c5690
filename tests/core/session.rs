//! Sessions over in-memory links: the host's view of a finger over any transport.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

use crate::common;
use crate::common::{calibration, identity, store, unloaded};
use embassy_futures::block_on;
use embassy_futures::join::join;
use taxel::calibration::MAX_BYTES;
use taxel::frame::{Fields, Frame, Status};
use taxel::instrument::Instrument;
use taxel::measured::NoValue;
use taxel::scan::{Codes, Scan, ScanSetting, ScanSettings, TaxelCodes};
use taxel::self_test::Channel;
use taxel::session::{Board, Buffers, End, Pace, run_session};
use taxel::store::{RamFlash, Store};
use taxel::units::{Code, FullScale};
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{
    BoardHealth, Command, Info, Message, PROTOCOL, Refusal, Request, Reset, Response,
};
use taxel::wire::{MAX_PACKET, pack};

/// One direction of a link: a bounded buffer that blocks if its reader stops.
#[derive(Default)]
pub struct Wire {
    bytes: VecDeque<u8>,
    capacity: usize,
    closed: bool,
    wakers: Vec<Waker>,
}

#[derive(Clone)]
pub struct HalfLink(Rc<RefCell<Wire>>);

impl HalfLink {
    fn new(capacity: usize) -> Self {
        Self(Rc::new(RefCell::new(Wire { capacity, ..Wire::default() })))
    }

    fn wake(wire: &mut Wire) {
        wire.wakers.drain(..).for_each(Waker::wake);
    }

    fn close(&self) {
        let mut wire = self.0.borrow_mut();
        wire.closed = true;
        Self::wake(&mut wire);
    }
}

impl embedded_io_async::ErrorType for HalfLink {
    type Error = Infallible;
}

impl embedded_io_async::Read for HalfLink {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|context| {
            let mut wire = self.0.borrow_mut();
            if wire.bytes.is_empty() && !wire.closed {
                wire.wakers.push(context.waker().clone());
                return Poll::Pending;
            }
            let length = buffer.len().min(wire.bytes.len());
            for (slot, byte) in buffer.iter_mut().zip(wire.bytes.drain(..length)) {
                *slot = byte;
            }
            Self::wake(&mut wire);
            Poll::Ready(Ok(length))
        })
        .await
    }
}

impl embedded_io_async::Write for HalfLink {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        poll_fn(|context| {
            let mut wire = self.0.borrow_mut();
            let room = wire.capacity - wire.bytes.len();
            if room == 0 {
                wire.wakers.push(context.waker().clone());
                return Poll::Pending;
            }
            let length = room.min(bytes.len());
            wire.bytes.extend(&bytes[..length]);
            Self::wake(&mut wire);
            Poll::Ready(Ok(length))
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Extras of the board.
#[derive(PartialEq)]
pub enum Desk {
    Bare,
    WithBootloader,
}

/// A board with a list of scans, which are always ready: only the session yields.
pub struct Scans {
    scans: VecDeque<Scan>,
    desk: Desk,
    store: Store<RamFlash<Vec<u8>>>,
    held: Option<u8>,
}

impl Board for Scans {
    type Flash = RamFlash<Vec<u8>>;

    async fn scan(&mut self) -> Option<Scan> {
        let scan = self.scans.pop_front()?;
        let Some((row, mut taxels)) = self.held.zip(scan.codes.taxels) else { return Some(scan) };
        taxels.hold(row);
        Some(Scan { codes: Codes { taxels: Some(taxels), ..scan.codes }, ..scan })
    }

    fn ticks(&self) -> u32 {
        0
    }

    fn store(&mut self) -> &mut Store<Self::Flash> {
        &mut self.store
    }

    fn health(&self) -> BoardHealth {
        BoardHealth { reset: Reset::Watchdog, ..BoardHealth::default() }
    }

    fn bootloader(&mut self) -> Result<(), Refusal> {
        if self.desk == Desk::Bare { Err(Refusal::Unsupported) } else { Ok(()) }
    }

    fn set_scan(&mut self, settings: &ScanSettings) -> Result<FullScale, Refusal> {
        if settings.scan_hz > 8000 {
            return Err(Refusal::Scan { setting: ScanSetting::ScanHz, low: 1, high: 8000 });
        }
        Ok(FullScale::BITS_16)
    }

    fn hold_row(&mut self, row: Option<u8>) -> Result<(), Refusal> {
        if self.desk == Desk::Bare {
            return Err(Refusal::Unsupported);
        }
        self.held = row;
        Ok(())
    }
}

/// A minimal client.
pub struct Host {
    pub to: HalfLink,
    from: HalfLink,
    deframer: Deframer,
    pub frames: Vec<Frame>,
    tag: u8,
}

impl Host {
    async fn send(&mut self, command: Command) {
        use embedded_io_async::Write;
        self.tag = self.tag.wrapping_add(1);
        let mut buffer = [0; MAX_PACKET];
        let packet = pack(&Request { tag: self.tag, command }, &mut buffer).unwrap();
        self.to.write_all(packet).await.unwrap();
    }

    pub async fn message(&mut self) -> Option<Message> {
        use embedded_io_async::Read;
        loop {
            let mut byte = [0];
            if self.from.read(&mut byte).await.unwrap() == 0 {
                return None;
            }
            if let Some(message) = self.deframer.push(byte[0]) {
                return Some(message.unwrap());
            }
        }
    }

    /// Sends a command and waits for the reply with its tag; stores frames that come before it.
    pub async fn ask(&mut self, command: Command) -> Result<Response, Refusal> {
        self.send(command).await;
        loop {
            match self.message().await.unwrap() {
                Message::Reply { tag, result } if tag == self.tag => return result,
                Message::Frame(frame) => self.frames.push(frame),
                other => panic!("{other:?}"),
            }
        }
    }

    pub async fn info(&mut self) -> Info {
        match self.ask(Command::Info).await {
            Ok(Response::Info(info)) => info,
            other => panic!("{other:?}"),
        }
    }
}

pub fn scans(count: u64) -> Scans {
    let scans = (0..count).map(|i| unloaded(250 * i)).collect();
    Scans { scans, desk: Desk::Bare, store: store(), held: None }
}

/// Runs `host` against a session, then closes the link; returns the instrument and the session's
/// end.
pub fn run(
    mut instrument: Instrument,
    mut board: Scans,
    pace: Pace,
    capacity: usize,
    host: impl AsyncFnOnce(&mut Host),
) -> (Instrument, End) {
    let (to, from) = (HalfLink::new(4096), HalfLink::new(capacity));
    let mut client = Host {
        to: to.clone(),
        from: from.clone(),
        deframer: Deframer::default(),
        frames: vec![],
        tag: 0,
    };
    let ended = block_on(async {
        let finger = async {
            let end = run_session(
                to.clone(),
                from.clone(),
                &mut board,
                &mut instrument,
                &mut Buffers::new(),
                pace,
            )
            .await;
            from.close();
            end.unwrap()
        };
        let host = async {
            host(&mut client).await;
            to.close();
        };
        // Each may end first: the host still reads what the link holds.
        join(finger, host).await.0
    });
    (instrument, ended)
}

pub fn fresh() -> Instrument {
    Instrument::new(identity())
}

#[test]
fn info_identifies_the_finger() {
    let (_, end) = run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        host.send(Command::Version).await;
        let answer = host.message().await;
        assert!(
            matches!(answer, Some(Message::Version { tag: 1, protocol: PROTOCOL, .. })),
            "{answer:?}"
        );
        let info = host.info().await;
        assert_eq!(info.identity, identity());
        assert_eq!(info.rate_millihertz, 1_000_000);
        assert_eq!(info.calibration, None);
    });
    assert_eq!(end, End::Closed);
}

#[test]
fn stream_is_off_until_requested() {
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        host.info().await;
        assert!(host.frames.is_empty());
        host.ask(Command::Stream(true)).await.unwrap();
        while host.frames.len() < 100 {
            let Some(Message::Frame(frame)) = host.message().await else { panic!() };
            host.frames.push(frame);
        }
        for (seq, pair) in host.frames.windows(2).enumerate() {
            assert_eq!(pair[0].seq as usize, seq);
            // The scan runs at 4 kHz, the stream at 1 kHz.
            assert_eq!(pair[1].time.0 - pair[0].time.0, 1000);
        }
    });
}

#[test]
fn rate_filter_and_fields_outlive_the_connection() {
    let (instrument, _) = run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        let rate = host.ask(Command::SetRate { hz: 333 }).await.unwrap();
        // The reply states the true rate, 4000 / 12, instead of the requested one.
        assert_eq!(rate, Response::Rate { millihertz: 333_333 });
        host.ask(Command::SetFilter { hz: 50 }).await.unwrap();
        host.ask(Command::SetFields(Fields::FORCE)).await.unwrap();
        host.ask(Command::Stream(true)).await.unwrap();
    });
    run(instrument, scans(1_000_000), Pace::Live, 4096, async |host| {
        let info = host.info().await;
        assert_eq!((info.rate_millihertz, info.fields), (333_333, Fields::FORCE));
        assert_eq!(info.filter_hz, 50);
        let Some(Message::Frame(frame)) = host.message().await else { panic!() };
        assert!(frame.force.is_some() && frame.point.is_none() && frame.codes.is_none());
    });
}

#[test]
fn value_out_of_range_returns_the_range() {
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        for hz in [0, 4001] {
            assert_eq!(
                host.ask(Command::SetRate { hz }).await,
                Err(Refusal::OutOfRange { low: 1, high: 4000 })
            );
        }
        let refused = host.ask(Command::SetFilter { hz: 1001 }).await;
        assert_eq!(refused, Err(Refusal::OutOfRange { low: 0, high: 1000 }));
        let refused = host.ask(Command::SetFields(Fields(0x8000))).await;
        assert_eq!(refused, Err(Refusal::OutOfRange { low: 0, high: 511 }));
        assert!(host.ask(Command::TakeBias { scans: 1 }).await.is_err());
    });
}

#[test]
fn bias_replies_when_done_and_rejects_a_second() {
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        host.send(Command::TakeBias { scans: 2000 }).await;
        assert_eq!(host.ask(Command::TakeBias { scans: 10 }).await, Err(Refusal::Busy));
        let Some(Message::Reply { tag: 1, result }) = host.message().await else { panic!() };
        let Ok(Response::Bias { bias, on_command, in_contact }) = result else { panic!() };
        assert!(on_command && !in_contact && bias.taxels.is_some());
        assert!(host.info().await.biased);
        host.ask(Command::ClearBias).await.unwrap();
        assert!(!host.info().await.biased);
    });
}

/// Scans of a board that can hold a row, each row with codes of its own.
fn holdable() -> Scans {
    let mut board = Scans { desk: Desk::WithBootloader, ..scans(1_000_000) };
    for taxels in board.scans.iter_mut().filter_map(|scan| scan.codes.taxels.as_mut()) {
        for (lit, offset) in taxels.lit.iter_mut().zip(0..) {
            *lit = lit.map(|code| Code(code.0 + 100 * offset));
        }
    }
    board
}

/// Receives `count` more frames.
async fn stream(host: &mut Host, count: usize) -> Vec<Frame> {
    host.frames.clear();
    host.ask(Command::SetFields(Fields::ALL)).await.unwrap();
    host.ask(Command::Stream(true)).await.unwrap();
    while host.frames.len() < count {
        let Some(Message::Frame(frame)) = host.message().await else { panic!() };
        host.frames.push(frame);
    }
    host.ask(Command::Stream(false)).await.unwrap();
    std::mem::take(&mut host.frames)
}

#[test]
fn held_row_streams_its_codes_and_no_estimate() {
    let mut instrument = fresh();
    let mut record = [0; MAX_BYTES];
    let record = calibration().to_bytes(&mut record).unwrap();
    instrument.install(record, &mut store()).unwrap();
    let lit = holdable().scans[0].codes.taxels.unwrap().lit;
    run(instrument, holdable(), Pace::Live, 4096, async |host| {
        let [first, ..] = stream(host, 1).await[..] else { panic!() };
        assert_eq!(first.codes.unwrap().taxels.unwrap().lit, lit);
        assert!(first.force.unwrap().z.is_ok() && !first.status.contains(Status::ROW_HELD));
        host.ask(Command::HoldRow { row: Some(2) }).await.unwrap();
        for frame in stream(host, 10).await {
            let held = TaxelCodes { lit: [lit[2]; 4], dark: lit[2] };
            assert_eq!(frame.codes.unwrap().taxels, Some(held));
            assert_eq!(frame.status, Status::ROW_HELD);
            let none = NoValue::NotEstimated;
            let Frame { force, sensors, point, slip, torsion, .. } = frame;
            let forces = sensors.unwrap().into_iter().chain(force);
            assert!(forces.flat_map(|f| [f.x, f.y, f.z]).all(|component| component == Err(none)));
            assert_eq!((point, slip, torsion), (Some(Err(none)), Some(Err(none)), Some(Err(none))));
            assert_eq!((frame.contacts, frame.uncertainty), (Some(Err(none)), Some(Err(none))));
            let signals = frame.signals.unwrap();
            assert!(signals.taxels.is_none() && signals.bridges == [None; 4]);
        }
        host.ask(Command::HoldRow { row: None }).await.unwrap();
        let [last, ..] = stream(host, 1).await[..] else { panic!() };
        assert_eq!((last.codes, last.force, last.status), (first.codes, first.force, first.status));
    });
}

#[test]
fn held_row_ends_with_the_session() {
    let (instrument, _) = run(fresh(), holdable(), Pace::Live, 4096, async |host| {
        host.ask(Command::HoldRow { row: Some(0) }).await.unwrap();
        assert!(stream(host, 1).await[0].status.contains(Status::ROW_HELD));
    });
    assert!(!instrument.row_held());
    run(instrument, holdable(), Pace::Live, 4096, async |host| {
        assert!(!stream(host, 1).await[0].status.contains(Status::ROW_HELD));
    });
}

#[test]
fn held_row_excludes_bias_and_self_test() {
    run(fresh(), holdable(), Pace::Live, 4096, async |host| {
        let refused = host.ask(Command::HoldRow { row: Some(4) }).await;
        assert_eq!(refused, Err(Refusal::OutOfRange { low: 0, high: 3 }));
        host.ask(Command::HoldRow { row: Some(3) }).await.unwrap();
        for command in [Command::TakeBias { scans: 10 }, Command::SelfTest { scans: 10 }] {
            assert_eq!(host.ask(command).await, Err(Refusal::Busy));
        }
        host.ask(Command::HoldRow { row: None }).await.unwrap();
        host.send(Command::SelfTest { scans: 4000 }).await;
        assert_eq!(host.ask(Command::HoldRow { row: Some(3) }).await, Err(Refusal::Busy));
    });
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        let refused = host.ask(Command::HoldRow { row: Some(1) }).await;
        assert_eq!(refused, Err(Refusal::Unsupported));
    });
}

#[test]
fn self_test_reports_channels_and_record() {
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        host.send(Command::SelfTest { scans: 500 }).await;
        assert_eq!(host.ask(Command::TakeBias { scans: 10 }).await, Err(Refusal::Busy));
        assert_eq!(host.ask(Command::SelfTest { scans: 10 }).await, Err(Refusal::Busy));
        let Some(Message::Reply { tag: 1, result }) = host.message().await else { panic!() };
        let Ok(Response::SelfTest(test)) = result else { panic!("{result:?}") };
        assert_eq!((test.scans, test.record_intact), (500, None));
        let quiet = |code: u16| Some(Channel { mean: code.into(), noise: 0.0 });
        assert_eq!(test.channels.lit, [[quiet(common::LIT); 4]; 4]);
        assert_eq!(test.channels.dark, [quiet(common::DARK); 4]);
        assert_eq!(
            test.channels.bridges,
            [[quiet(common::MIDPOINT); 4], [None; 4], [None; 4], [None; 4]]
        );
        let range = Err(Refusal::OutOfRange { low: 2, high: 4096 });
        assert_eq!(host.ask(Command::SelfTest { scans: 4097 }).await, range);
    });
}

#[test]
fn board_gives_health_bootloader_and_scan() {
    let board = Scans { desk: Desk::WithBootloader, ..scans(1_000_000) };
    run(fresh(), board, Pace::Live, 4096, async |host| {
        let Ok(Response::Health(health)) = host.ask(Command::Health).await else { panic!() };
        assert_eq!(health.reset, Reset::Watchdog);
        assert!(health.sending.is_some());
        assert_eq!(host.ask(Command::Bootloader).await, Ok(Response::Done));

        let slower = ScanSettings { scan_hz: 500, oversampling: 16, settle_ns: 30_000 };
        host.send(Command::TakeBias { scans: 100 }).await;
        assert_eq!(host.ask(Command::SetScan(slower)).await, Err(Refusal::Busy));
        host.message().await;
        assert_eq!(host.ask(Command::SetScan(slower)).await, Ok(Response::Done));
        let info = host.info().await;
        assert_eq!((info.identity.scan_hz, info.rate_millihertz), (500, 500_000));
        assert_eq!(info.identity.full_scale, FullScale::BITS_16);
        assert!(!info.biased, "a bias of the old codes");
        let faster = ScanSettings { scan_hz: 9000, ..slower };
        let refusal = Refusal::Scan { setting: ScanSetting::ScanHz, low: 1, high: 8000 };
        assert_eq!(host.ask(Command::SetScan(faster)).await, Err(refusal));
        assert_eq!(host.info().await.identity.scan_hz, 500);
    });
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        assert_eq!(host.ask(Command::Bootloader).await, Err(Refusal::Unsupported));
    });
}

#[test]
fn bias_taken_in_contact_is_reported() {
    let mut instrument = fresh();
    let mut buffer = [0; MAX_BYTES];
    let scans = (0..100_000).map(|i| common::pressed(250 * i, 5, 3_000)).collect();
    let mut board = Scans { scans, desk: Desk::Bare, store: store(), held: None };
    instrument.install(calibration().to_bytes(&mut buffer).unwrap(), board.store()).unwrap();
    run(instrument, board, Pace::Live, 4096, async |host| {
        let taken = host.ask(Command::TakeBias { scans: 50 }).await;
        let Ok(Response::Bias { in_contact, on_command, .. }) = taken else { panic!("{taken:?}") };
        assert!(in_contact && on_command);
        let mut buffer = [0; MAX_BYTES];
        let record = calibration().to_bytes(&mut buffer).unwrap().to_vec();
        crate::uploads::upload(host, &record).await.unwrap();
        let read = host.ask(Command::ReadBias).await;
        let Ok(Response::Bias { in_contact, on_command, .. }) = read else { panic!("{read:?}") };
        assert!(!in_contact && !on_command, "a new calibration brings its own bias");
    });
}

#[test]
fn bias_and_self_test_end_with_their_host() {
    for long in [Command::TakeBias { scans: u16::MAX }, Command::SelfTest { scans: 4096 }] {
        let gone = async |host: &mut Host| {
            host.send(long.clone()).await;
            host.info().await;
        };
        let (instrument, _) = run(fresh(), scans(1_000_000), Pace::Live, 4096, gone);
        assert!(!instrument.busy());
        run(instrument, scans(1_000_000), Pace::Live, 4096, async |host| {
            // The next host's requests have the same tags.
            let taken = host.ask(Command::TakeBias { scans: 2 }).await;
            assert!(matches!(taken, Ok(Response::Bias { on_command: true, .. })), "{taken:?}");
            let tested = host.ask(Command::SelfTest { scans: 3 }).await;
            let Ok(Response::SelfTest(test)) = tested else { panic!("{tested:?}") };
            assert_eq!(test.scans, 3);
        });
    }
}

#[test]
fn slow_host_loses_whole_counted_frames() {
    let (mut instrument, end) = run(fresh(), scans(20_000), Pace::Live, 256, async |host| {
        host.ask(Command::SetRate { hz: 4000 }).await.unwrap();
        host.ask(Command::SetFields(Fields::ALL)).await.unwrap();
        host.ask(Command::Stream(true)).await.unwrap();
        for _ in 0..10_000 {
            embassy_futures::yield_now().await;
        }
        // The host reads again: every found frame is whole, and the gap in the sequence equals the
        // loss.
        let mut seen: Vec<u32> = vec![];
        while let Some(Message::Frame(frame)) = host.message().await {
            seen.push(frame.seq);
            if seen.len() == 40 {
                break;
            }
        }
        let gap = seen.windows(2).map(|pair| pair[1] - pair[0] - 1).sum::<u32>();
        assert!(gap > 1000, "{seen:?}");
        let counters = host.info().await.counters;
        assert!(counters.lost >= gap, "{counters:?}");
        assert_eq!(counters.lost_replies, 0);
    });
    assert_eq!(end, End::Closed);
    let counters = *instrument.counters();
    assert!(counters.scans > 10_000, "{counters:?}");
}

#[test]
fn lossless_replay_waits_and_sends_everything() {
    let (mut instrument, end) = run(fresh(), scans(500), Pace::Lossless, 64, async |host| {
        host.ask(Command::SetRate { hz: 4000 }).await.unwrap();
        host.ask(Command::SetFields(Fields::ALL)).await.unwrap();
        // The board takes no scan before the stream is on.
        assert_eq!(host.info().await.counters.scans, 0);
        host.ask(Command::Stream(true)).await.unwrap();
        while let Some(Message::Frame(frame)) = host.message().await {
            host.frames.push(frame);
        }
        let seqs: Vec<u32> = host.frames.iter().map(|frame| frame.seq).collect();
        assert_eq!(seqs, (0..500).collect::<Vec<_>>());
    });
    assert_eq!(end, End::Scans);
    assert_eq!(instrument.counters().lost, 0);
}

#[test]
fn garbage_is_counted_and_next_request_answered() {
    run(fresh(), scans(1_000_000), Pace::Live, 4096, async |host| {
        use embedded_io_async::Write;
        host.to.write_all(&[0, 0, 1, 2, 3, 0xff, 0, 9, 9, 0]).await.unwrap();
        let info = host.info().await;
        assert_eq!(info.counters.bad_packets, 2);
    });
}
