//! A day of virtual time at 4 kHz: every frame is received or known to be lost, every counter
//! wraps, and memory stays flat.
//!
//! All 345.6 million frames: `TAXEL_LONG=1 cargo test --release -p taxel --test core-tests day::`.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::calibration::MAX_BYTES;
use taxel::instrument::Instrument;
use taxel::units::Micros;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{Command, Message, Request};
use taxel::wire::{MAX_PACKET, pack_frame};

use crate::common::{everything, identity, pressed, store, unloaded};

const DAY: u64 = 24 * 3600 * 4000;
/// Microseconds between two scans.
const APART: u64 = 250;

/// Resident memory of this process in kB; 0 where the system does not tell.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or_default()
}

/// Scans and frames before the day: both counters, and with them the frames' numbers, wrap soon.
const START: u32 = u32::MAX - 1_000;
/// Lost scans before the day, of which there are fewer.
const START_OVERRUNS: u32 = u32::MAX - 100;

/// Receiver of frames, which knows of a gap by the numbers alone.
#[derive(Default)]
struct Receiver {
    deframer: Deframer,
    next: u32,
    received: u64,
    missed: u64,
    damaged: u64,
}

impl Receiver {
    /// Takes a packet; fails at a frame whose time is not that of its number.
    fn bytes(&mut self, packet: &[u8]) -> Result<(), String> {
        for byte in packet {
            let frame = match self.deframer.push::<Message>(*byte) {
                None => continue,
                Some(Ok(Message::Frame(frame))) => frame,
                Some(Ok(other)) => return Err(format!("{other:?} was not sent")),
                Some(Err(_)) => {
                    self.damaged += 1;
                    continue;
                }
            };
            self.missed += u64::from(frame.seq.wrapping_sub(self.next));
            self.next = frame.seq.wrapping_add(1);
            self.received += 1;
            let frames = self.received + self.missed;
            let time = Micros(APART * (frames - 1));
            if frame.time != time {
                return Err(format!("frame {} of {:?}, not {time:?}", frame.seq, frame.time));
            }
        }
        Ok(())
    }
}

/// Outcome of a day.
#[derive(Debug)]
struct Day {
    received: u64,
    missed: u64,
    /// Frames that the link dropped, frames that it damaged, and packets that were refused.
    dropped: u64,
    flipped: u64,
    damaged: u64,
    /// Growth of the process's memory in kB.
    grown: u64,
}

/// Streams the frames of `scans` over a link that drops and damages some. The scan `vanishes` gets
/// lost without a trace.
///
/// Fails unless each frame is received or known to be lost, and the counters agree.
fn day(scans: u64, vanishes: Option<u64>) -> Result<Day, String> {
    let (mut instrument, mut store) = (Instrument::new(identity()), store());
    let mut record = [0; MAX_BYTES];
    let record = everything().to_bytes(&mut record).unwrap();
    instrument.install(record, &mut store).unwrap();
    for command in [Command::SetRate { hz: 4000 }, Command::Stream(true)] {
        instrument.handle(&Request { tag: 0, command }, &mut store).unwrap();
    }
    let counters = instrument.counters();
    (counters.scans, counters.frames, counters.overruns) = (START, START, START_OVERRUNS);
    let mut link = ChaCha8Rng::seed_from_u64(1);
    let mut receiver = Receiver { next: START, ..Receiver::default() };
    let (mut overruns, mut dropped, mut flipped, mut memory) = (0, 0, 0, 0);
    let mut buffer = [0; MAX_PACKET];
    for i in (0..scans).filter(|i| Some(*i) != vanishes) {
        // A press a second, on one taxel after the other.
        let (time, second) = (APART * i, i / 4000);
        let mut scan = match i % 4000 {
            0..2000 => unloaded(time),
            _ => pressed(time, second as usize % 16, 3_000 + (i % 512) as u16),
        };
        scan.lost = u32::from(i % 997 == 5) * 2;
        overruns += scan.lost;
        assert!(instrument.scan(&scan).frame, "scan {i}");
        pack_frame(instrument.frame(&scan), &mut buffer).unwrap();
        let length = 1 + buffer.iter().position(|byte| *byte == 0).unwrap();
        let packet = &mut buffer[..length];
        let luck: u32 = link.random();
        // The last frame arrives, so that the gap before it is known.
        if i + 1 < scans && luck.is_multiple_of(1000) {
            dropped += 1;
            continue;
        }
        if i + 2 < scans && luck % 1000 == 1 {
            flipped += 1;
            packet[(luck >> 16) as usize % length] ^= 1 << (luck >> 13 & 7);
        }
        receiver.bytes(packet)?;
        if i == scans / 10 {
            memory = resident();
        }
    }
    let grown = resident().saturating_sub(memory);
    let Receiver { received, missed, damaged, next, .. } = receiver;
    let day = Day { received, missed, dropped, flipped, damaged, grown };
    let counters = *instrument.counters();
    let end = START.wrapping_add(scans as u32);
    let overruns = START_OVERRUNS.wrapping_add(overruns);
    // A flip in a packet's end takes the next one too.
    let accounted = received + missed == scans
        && (dropped + flipped..=dropped + 2 * flipped).contains(&missed)
        && [counters.scans, counters.frames, next] == [end; 3]
        && counters.overruns == overruns;
    if accounted { Ok(day) } else { Err(format!("{scans} scans: {day:?}, {counters:?}")) }
}

/// Variable that the test sets for a process of its own.
const ALONE: &str = "TAXEL_ALONE";

#[test]
fn every_frame_of_a_day_is_accounted_for() {
    // The memory is that of a process, in which other tests take theirs.
    if std::env::var_os(ALONE).is_none() {
        let mut own = std::process::Command::new(std::env::current_exe().unwrap());
        own.args(["--exact", "day::every_frame_of_a_day_is_accounted_for", "--nocapture"]);
        let ran = own.env(ALONE, "1").output().unwrap();
        let [out, err] = [ran.stdout, ran.stderr].map(|text| String::from_utf8(text).unwrap());
        println!("{out}");
        assert!(ran.status.success() && out.contains(" 1 passed;"), "{err}");
        return;
    }
    let long = std::env::var_os("TAXEL_LONG").is_some();
    let scans = if long { DAY } else { 200_000 };
    let Day { received, missed, dropped, flipped, damaged, grown } = day(scans, None).unwrap();
    println!(
        "{scans} frames: {received} received, {missed} missed of {dropped} dropped and {flipped} damaged; {grown} kB more"
    );
    assert!(dropped.min(flipped).min(damaged) > scans / 2000, "the link is as bad as it was set");
    assert!(grown <= 512, "memory grew by {grown} kB");
}

#[test]
fn scan_that_vanishes_is_noticed() {
    assert!(day(2_000, None).is_ok());
    for vanishes in [0, 1_000, 1_999] {
        assert!(day(2_000, Some(vanishes)).is_err(), "scan {vanishes}");
    }
}
