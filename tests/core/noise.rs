//! Frames over a line with errors: none is accepted that was not sent, the frame after the damage
//! is read again, and the gaps in the sequence are the losses.
//!
//! A damaged packet that still decodes passes its CRC-32 by chance once in 2³² times. If only the
//! CRC refused a hundred million packets, one wrong frame would pass with odds of 2 %. About half
//! of them are refused for their coding.
//!
//! A hundred million damaged frames:
//! `TAXEL_LONG=1 cargo test --release -p taxel --test core-tests noise::`. It took 8.5 min of
//! processor time: 100 532 544 frames were lost, no wrong one was accepted, and the gaps in the
//! sequence were these losses. The CRC alone refused 51.9 million packets.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::frame::Frame;
use taxel::units::Micros;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::Message;
use taxel::wire::{MAX_PACKET, WireError, pack_frame};

use crate::wire_golden::made_of;

/// Errors per bit, from several in a frame to one in five hundred frames.
const RATES: [f64; 6] = [1e-3, 5e-4, 1e-4, 3e-5, 1e-5, 1e-6];
/// Number of the first frame: the sequence wraps soon.
const FIRST: u32 = u32::MAX - 1000;
/// Most bytes that an error replaces.
const BURST: usize = 8;

/// Violated property of a receiver.
#[derive(Debug, PartialEq)]
enum Fault {
    /// It accepted a frame that was not sent.
    WrongFrame,
    /// It refused a frame that came intact after a whole packet.
    IntactFrameLost,
    /// It lost two untouched frames in a row.
    LateResync,
    /// The gap before a frame is not the number of frames lost.
    WrongGap,
}

/// Line that flips bits, replaces runs of bytes, and drops and doubles bytes.
struct Line {
    draw: ChaCha8Rng,
    rate: f64,
    /// Bits until the next error.
    until: usize,
}

impl Line {
    fn new(rate: f64, seed: u64) -> Self {
        let mut line = Self { draw: ChaCha8Rng::seed_from_u64(seed), rate, until: 0 };
        line.until = line.gap();
        line
    }

    /// Draws the bits between two errors.
    fn gap(&mut self) -> usize {
        let share = 1.0 - self.draw.random::<f64>();
        (share.ln() / (-self.rate).ln_1p()) as usize
    }

    /// Skips the packets before the next error, all as long as this one.
    fn skip(&mut self, packet: &[u8]) {
        self.until %= 8 * packet.len();
    }

    /// Passes a packet on; returns whether an error hit it.
    fn pass(&mut self, packet: &[u8], received: &mut Vec<u8>) -> bool {
        received.clear();
        let mut from = 0;
        while self.until < 8 * packet.len() {
            let (at, bit) = (self.until / 8, self.until % 8);
            self.until += 1 + self.gap();
            // An error in a byte that the last one took leaves that one.
            if at < from {
                continue;
            }
            received.extend(&packet[from..at]);
            from = at + 1;
            match self.draw.random_range(0..4) {
                0 => received.push(packet[at] ^ 1 << bit),
                1 => {
                    let length = self.draw.random_range(1..=BURST).min(packet.len() - at);
                    received.extend((0..length).map(|_| self.draw.random::<u8>()));
                    from = at + length;
                }
                2 => {}
                _ => received.extend([packet[at]; 2]),
            }
        }
        self.until -= 8 * packet.len();
        let hit = from > 0;
        received.extend(&packet[from..]);
        hit
    }
}

/// Reference that knows what was sent: it compares the bytes between two zeros with the packets.
#[derive(Default)]
struct Reference {
    /// The packet being sent, and the one before, whose end may have been lost.
    sent: [Vec<u8>; 2],
    received: Vec<u8>,
}

impl Reference {
    fn send(&mut self, packet: &[u8]) {
        self.sent.swap(0, 1);
        self.sent[0].clear();
        self.sent[0].extend(packet);
    }

    /// Takes a byte; returns the packet that it completes.
    fn push(&mut self, byte: u8) -> Option<&[u8]> {
        self.received.push(byte);
        if byte != 0 {
            return None;
        }
        let intact = self.sent.iter().find(|sent| **sent == self.received);
        self.received.clear();
        intact.map(Vec::as_slice)
    }
}

/// Outcome of a campaign.
#[derive(Debug, Default)]
struct Tally {
    sent: u64,
    damaged: u64,
    lost: u64,
    /// Untouched frames that were lost with the damaged one before.
    joined: u64,
}

/// Sends frames over a line until `damaged` of them were hit by an error.
///
/// `receive` takes a byte, and returns the frame that it completes and the number of frames lost
/// before. Stretches without an error are skipped; their frames take no number.
fn campaign(
    rate: f64,
    damaged: u64,
    mut receive: impl FnMut(u8) -> Option<(Frame, u32)>,
) -> Result<Tally, Fault> {
    let seed = rate.to_bits();
    let mut draw = ChaCha8Rng::seed_from_u64(seed);
    let mut words = || (0..200).map(|_| draw.random()).collect::<Vec<u32>>();
    let mut pool: Vec<Frame> = (0..256).map(|_| made_of(&words())).collect();
    let (mut line, mut reference) = (Line::new(rate, seed), Reference::default());
    let (mut tally, mut bytes) = (Tally::default(), vec![]);
    let (mut buffer, mut again) = ([0; MAX_PACKET], [0; MAX_PACKET]);
    // Frames lost since the last one that came intact, and untouched ones of them in a row.
    let (mut gap, mut untouched) = (0_u32, 0_u32);
    while tally.damaged < damaged || gap > 0 {
        let frame = &mut pool[tally.sent as usize % 256];
        frame.seq = FIRST.wrapping_add(tally.sent as u32);
        frame.time = Micros(250 * tally.sent);
        let packet = pack_frame(&*frame, &mut buffer).unwrap();
        if gap == 0 {
            line.skip(packet);
        }
        let hit = line.pass(packet, &mut bytes);
        tally.damaged += u64::from(hit);
        tally.sent += 1;
        gap += 1;
        untouched = if hit { 0 } else { untouched + 1 };
        reference.send(packet);
        for byte in &bytes {
            match (reference.push(*byte), receive(*byte)) {
                (None, None) => {}
                (None, Some(_)) => return Err(Fault::WrongFrame),
                (Some(_), None) if untouched > 1 => return Err(Fault::LateResync),
                (Some(_), None) => return Err(Fault::IntactFrameLost),
                (Some(sent), Some((frame, missed))) => {
                    if pack_frame(&frame, &mut again) != Ok(sent) {
                        return Err(Fault::WrongFrame);
                    }
                    // The frame before may come with this one's bytes.
                    let late = u32::from(frame.seq != FIRST.wrapping_add(tally.sent as u32 - 1));
                    if missed != gap - 1 - late {
                        return Err(Fault::WrongGap);
                    }
                    tally.lost += u64::from(missed);
                    (gap, untouched) = (late, 0);
                }
            }
        }
        if untouched > 1 {
            return Err(Fault::LateResync);
        }
        tally.joined += u64::from(untouched);
    }
    Ok(tally)
}

/// Receiver of the project's own deframer, which knows of a gap by the numbers alone.
struct Receiver {
    deframer: Deframer,
    next: u32,
    /// Packets refused for their coding, their CRC, and all else.
    refused: [u64; 3],
}

impl Receiver {
    fn new() -> Self {
        Self { deframer: Deframer::default(), next: FIRST, refused: [0; 3] }
    }

    fn push(&mut self, byte: u8) -> Option<(Frame, u32)> {
        match self.deframer.push(byte)? {
            Ok(Message::Frame(frame)) => Some((frame, self.gap(frame.seq))),
            Ok(_) => Some(Default::default()),
            Err(error) => {
                self.refused[match error {
                    WireError::Coding => 0,
                    WireError::Crc => 1,
                    _ => 2,
                }] += 1;
                None
            }
        }
    }

    fn gap(&mut self, seq: u32) -> u32 {
        let gap = seq.wrapping_sub(self.next);
        self.next = seq.wrapping_add(1);
        gap
    }
}

#[test]
fn damaged_frames_are_refused_and_counted() {
    let long = std::env::var_os("TAXEL_LONG").is_some();
    let frames: u64 = if long { 100_000_000 } else { 100_000 };
    for rate in RATES {
        let mut receiver = Receiver::new();
        let tally = campaign(rate, frames / 6 + 1, |byte| receiver.push(byte)).unwrap();
        println!("{rate:e} errors a bit: {tally:?}, refused {:?}", receiver.refused);
        let Tally { sent, damaged, lost, joined } = tally;
        // An error may leave its frame intact, and may take the next frame's start.
        assert!(lost > damaged - damaged / 100, "{lost} lost of {damaged} damaged");
        assert!(lost <= damaged + joined && sent > damaged, "{lost} lost of {damaged} damaged");
        assert!(joined > damaged / 2000, "{joined} packets joined of {damaged} damaged");
        let [coding, crc, _] = receiver.refused;
        assert!(coding.min(crc) > damaged / 100, "{:?}", receiver.refused);
    }
}

/// Decoder that skips the check of the CRC.
fn unchecked() -> impl FnMut(u8) -> Option<(Frame, u32)> {
    let (mut packet, mut receiver) = (vec![], Receiver::new());
    move |byte| {
        if byte != 0 {
            packet.push(byte);
            return None;
        }
        let mut packet = std::mem::take(&mut packet);
        let length = cobs::decode_in_place(&mut packet).ok()?.checked_sub(4)?;
        match postcard::take_from_bytes(&packet[..length]) {
            Ok((Message::Frame(frame), [])) => Some((frame, receiver.gap(frame.seq))),
            _ => None,
        }
    }
}

#[test]
fn noise_finds_decoder_without_crc() {
    for rate in RATES {
        assert_eq!(campaign(rate, 1000, unchecked()).unwrap_err(), Fault::WrongFrame);
    }
}

#[test]
fn noise_finds_receiver_that_counts_no_gap() {
    let mut receiver = Receiver::new();
    let receive = |byte| receiver.push(byte).map(|(frame, gap)| (frame, gap.min(1)));
    assert_eq!(campaign(RATES[0], 1000, receive).unwrap_err(), Fault::WrongGap);
}

#[test]
fn noise_finds_deframer_deaf_after_damage() {
    let (mut receiver, mut deaf) = (Receiver::new(), false);
    let receive = |byte| {
        let refused = receiver.refused;
        let frame = receiver.push(byte);
        let ends = frame.is_some() || refused != receiver.refused;
        // A packet after a refused one is lost, too.
        let heard = frame.filter(|_| !deaf);
        deaf = if ends { refused != receiver.refused } else { deaf };
        heard
    };
    assert_eq!(campaign(RATES[4], 1000, receive).unwrap_err(), Fault::IntactFrameLost);
}
