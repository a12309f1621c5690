//! A day of virtual time at 4 kHz: every frame is received or known to be lost, every counter
//! wraps, and memory stays flat.
//!
//! All 345.6 million frames: `TAXEL_LONG=1 cargo test -p taxel --test core-tests day::`.

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
    fn bytes(&mut self, packet: &[u8]) {
        for byte in packet {
            let frame = match self.deframer.push::<Message>(*byte) {
                None => continue,
                Some(Ok(Message::Frame(frame))) => frame,
                Some(other) => {
                    assert!(other.is_err(), "no message but a frame was sent: {other:?}");
                    self.damaged += 1;
                    continue;
                }
            };
            self.missed += u64::from(frame.seq.wrapping_sub(self.next));
            self.next = frame.seq.wrapping_add(1);
            self.received += 1;
            let frames = self.received + self.missed;
            assert_eq!(frame.time, Micros(APART * (frames - 1)), "frame {}", frame.seq);
        }
    }
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
    let (mut instrument, mut store) = (Instrument::new(identity()), store());
    let mut record = [0; MAX_BYTES];
    let record = everything().to_bytes(&mut record).unwrap();
    instrument.install(record, &mut store).unwrap();
    for command in [Command::SetRate { hz: 4000 }, Command::Stream(true)] {
        instrument.handle(&Request { tag: 0, command }, &mut store).unwrap();
    }
    // Each counter wraps within the first minute.
    let start = u32::MAX - 1_000;
    let counters = instrument.counters();
    (counters.scans, counters.frames, counters.overruns) = (start, start, start);
    let (mut link, mut receiver) = (ChaCha8Rng::seed_from_u64(1), Receiver::default());
    let (mut overruns, mut dropped, mut flipped, mut memory) = (0, 0, 0, 0);
    let mut buffer = [0; MAX_PACKET];
    for i in 0..scans {
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
        receiver.bytes(packet);
        if i == scans / 10 {
            memory = resident();
        }
    }
    let grown = resident().saturating_sub(memory);
    let Receiver { received, missed, damaged, .. } = receiver;
    println!(
        "{scans} frames: {received} received, {missed} missed of {dropped} dropped and {flipped} damaged; {grown} kB more"
    );
    assert_eq!(received + missed, scans, "each frame is received or missed");
    // A flip in a packet's end takes the next one too.
    assert!((dropped + flipped..=dropped + 2 * flipped).contains(&missed), "{missed}");
    assert!(dropped.min(flipped).min(damaged) > scans / 2000, "the link is as bad as it was set");
    let counters = *instrument.counters();
    let sum = |more: u64| start.wrapping_add(more as u32);
    assert_eq!((counters.scans, counters.frames), (sum(scans), sum(scans)));
    assert_eq!(counters.overruns, start.wrapping_add(overruns));
    assert!(grown <= 512, "memory grew by {grown} kB");
}
