//! Port of the firmware to a new board, simulated on this machine: `cargo run --example own_board`.
//!
//! [`Board`] is all that a port implements for the session: a source of scans, a cycle counter and
//! a flash. The chip here is made up, and the link is a pipe in memory. A real board has a DMA
//! buffer and a USB endpoint instead and calls the same [`run_session`].
//! `docs/boards/adding-a-board.md` lists the other parts of a real board.

use std::time::Instant;

use embassy_futures::block_on;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::pipe::Pipe;
use taxel::frame::{Fields, Frame};
use taxel::instrument::Instrument;
use taxel::scan::{Codes, Scan, TaxelCodes};
use taxel::session::{Board, Buffers, Pace, run_session};
use taxel::store::{RamFlash, Store};
use taxel::units::{Code, FullScale, Micros};
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{Command, Identity, Message, Request, Response};
use taxel::wire::{MAX_PACKET, pack};

/// Scans a second of the made-up chip.
const SCAN_HZ: u16 = 1000;

/// A chip with a 12-bit converter and an optical matrix, and without force sensors.
struct MadeUpChip {
    start: Instant,
    scans: u64,
    store: Store<RamFlash<Vec<u8>>>,
}

impl Board for MadeUpChip {
    type Flash = RamFlash<Vec<u8>>;

    /// A real board waits for the interrupt of its DMA and copies the codes out of the buffer.
    async fn scan(&mut self) -> Option<Scan> {
        embassy_futures::yield_now().await;
        let time = Micros(self.scans * 1_000_000 / u64::from(SCAN_HZ));
        // The facet over r1c1 comes nearer from the 20th scan on.
        let mut lit = [[Code(1400); 4]; 4];
        lit[1][1] = Code(1400 + 10 * self.scans.saturating_sub(20).min(30) as u16);
        self.scans += 1;
        let codes = Codes {
            full_scale: FullScale::BITS_12,
            taxels: Some(TaxelCodes { lit, dark: [Code(120); 4] }),
            bridges: [None; 4],
            reference: None,
            temperature: None,
        };
        Some(Scan { time, lost: 0, codes })
    }

    /// A real board reads a free-running counter, DWT's on a Cortex-M.
    fn ticks(&self) -> u32 {
        self.start.elapsed().as_micros() as u32
    }

    /// A real board implements [`taxel::store::Flash`] over its pages.
    fn store(&mut self) -> &mut Store<Self::Flash> {
        &mut self.store
    }
}

/// One direction of the link.
type Wire = Pipe<NoopRawMutex, 4096>;

/// Minimal host; `host-tools/client` is the complete one.
struct Host<'w> {
    to: &'w Wire,
    from: &'w Wire,
    deframer: Deframer,
}

impl Host<'_> {
    async fn send(&mut self, command: Command) {
        let mut buffer = [0; MAX_PACKET];
        let packet = pack(&Request { tag: 1, command }, &mut buffer).expect("a request fits");
        self.to.write_all(packet).await;
    }

    async fn message(&mut self) -> Message {
        loop {
            let mut byte = [0];
            self.from.read(&mut byte).await;
            if let Some(Ok(message)) = self.deframer.push(byte[0]) {
                return message;
            }
        }
    }

    /// Asks for the identity, turns the stream on and returns `count` frames.
    async fn run(&mut self, count: usize) -> Vec<Frame> {
        self.send(Command::Info).await;
        self.send(Command::SetFields(Fields::SIGNALS)).await;
        self.send(Command::TakeBias { scans: 10 }).await;
        self.send(Command::Stream(true)).await;
        let mut frames = Vec::new();
        while frames.len() < count {
            match self.message().await {
                Message::Frame(frame) => frames.push(frame),
                Message::Reply { result: Ok(Response::Info(info)), .. } => {
                    println!("board {}, serial {}", info.identity.board, info.identity.serial);
                }
                Message::Reply { result: Ok(Response::Bias { .. }), .. } => println!("bias taken"),
                Message::Reply { result: Ok(_), .. } => {}
                other => panic!("the finger refused a request: {other:?}"),
            }
        }
        frames
    }
}

fn main() {
    let identity = Identity {
        board: "made up".try_into().expect("at most 24 bytes"),
        serial: "0001".try_into().expect("at most 32 bytes"),
        build: env!("CARGO_PKG_VERSION").try_into().expect("at most 24 bytes"),
        scan_hz: SCAN_HZ,
        full_scale: FullScale::BITS_12,
        tick_hz: 1_000_000,
    };
    let mut chip = MadeUpChip {
        start: Instant::now(),
        scans: 0,
        store: Store::new(RamFlash::new(vec![0; RamFlash::SIZE])),
    };
    let mut instrument = Instrument::new(identity);
    let (up, down) = (Wire::new(), Wire::new());
    let mut host = Host { to: &down, from: &up, deframer: Deframer::default() };
    let mut buffers = Buffers::new();
    let session = run_session(&down, &up, &mut chip, &mut instrument, &mut buffers, Pace::Live);
    let frames = match block_on(select(session, host.run(60))) {
        Either::First(ended) => panic!("the session ended before the host: {ended:?}"),
        Either::Second(frames) => frames,
    };
    for frame in frames.iter().step_by(10) {
        let taxels = frame.signals.and_then(|signals| signals.taxels);
        println!("{:6} µs  r1c1 {:+.4}", frame.time.0, taxels.map_or(0.0, |c| c[5]));
    }
}
