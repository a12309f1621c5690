//! Hostile bytes against the model of a session: garbage, and requests of every kind, whole or
//! damaged, split anywhere. Every reply must be the model's.
//!
//! Ten billion bytes:
//! `TAXEL_LONG=1 cargo test --release -p taxel --test core-tests campaign::`. A failure names its
//! seed; `TAXEL_SEED=<seed>` begins with that one.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::session::Pace;

use crate::model::Compared;
use crate::model::rig::{Fault, Rig, records, replay};
use crate::model::wire::{CHUNK, LONGEST, Request, crc32, packet};

/// Bytes of a session at least.
const SESSION: usize = 1 << 16;
/// Sessions of a finger.
const SESSIONS: u64 = 128;

/// Bytes from a hostile host.
struct Hostile {
    rng: ChaCha8Rng,
    bytes: Vec<u8>,
    records: Vec<Vec<u8>>,
    /// Bytes of requests, whole or damaged.
    aimed: usize,
    /// Whether scans never wait, and the stream shall fill the link.
    live: bool,
}

impl Hostile {
    fn below(&mut self, n: u32) -> usize {
        self.rng.random_range(0..n) as usize
    }

    fn one_in(&mut self, n: u32) -> bool {
        self.below(n) == 0
    }

    /// Writes a session's bytes: two fifths of them requests, the last one whole.
    fn session(&mut self) {
        (self.aimed, self.bytes) = (0, vec![]);
        while self.bytes.len() < SESSION {
            if self.aimed * 5 > self.bytes.len() * 2 {
                self.garbage();
                continue;
            }
            let before = self.bytes.len();
            match self.below(64) {
                0 => self.upload(),
                _ => self.request(),
            }
            self.aimed += self.bytes.len() - before;
        }
        self.bytes.push(0);
        self.bytes.extend(packet(&[7, 1]));
    }

    fn garbage(&mut self) {
        let begin = self.bytes.len();
        let length = match self.below(4) {
            // Around the longest packet.
            0 => LONGEST - 8 + self.below(16),
            _ => 1 + self.below(2000),
        };
        self.bytes.resize(begin + length, 0);
        let bytes = &mut self.bytes[begin..];
        match self.rng.random_range(0..8) {
            0 => {}
            1 => bytes.fill(self.rng.random_range(1..=255)),
            2 => {
                self.rng.fill_bytes(bytes);
                bytes.iter_mut().for_each(|byte| *byte |= 1);
            }
            _ => self.rng.fill_bytes(bytes),
        }
        if self.one_in(2) {
            self.bytes.push(0);
        }
    }

    /// Writes a request; a quarter of them is damaged.
    fn request(&mut self) {
        let mut packet = packet(&self.message());
        if self.one_in(4) {
            let at = self.below(packet.len() as u32);
            match self.below(8) {
                0 | 1 => packet[at] ^= 1 << self.below(8),
                2 => drop(packet.remove(at)),
                3 => packet.insert(at, self.rng.random()),
                4 => packet.insert(at, 0),
                5 => packet.insert(at, packet[at]),
                6 => packet.truncate(at),
                _ => packet.extend_from_within(..),
            }
        }
        self.bytes.append(&mut packet);
    }

    /// A message with a right CRC: a request of any kind, or one that is none.
    fn message(&mut self) -> Vec<u8> {
        if self.one_in(16) {
            let mut message = vec![0; self.below(24)];
            self.rng.fill_bytes(&mut message);
            // A command's number, mostly.
            let command = self.below(24) as u8;
            message.get_mut(1).into_iter().for_each(|number| *number = command);
            return message;
        }
        let command = self.below(21) as u8;
        let mut request = Request { tag: self.rng.random(), command, fields: [0; 3], data: vec![] };
        request.fields = [self.number(command), self.number(0), self.number(0)];
        if command == 10 {
            // Some are no whole words, or longer than a chunk.
            let words = 8 * self.below(17);
            request.data = vec![0; if self.one_in(4) { self.below(140) } else { words }];
            self.rng.fill_bytes(&mut request.data);
        }
        let mut message = request.write();
        match self.below(64) {
            // A byte too many or too few.
            0 => message.push(self.rng.random()),
            1 => drop(message.pop()),
            // A number in more bytes than it takes.
            2 if message.len() > 2 => {
                let last = message.len() - 1;
                message[last] |= 128;
                message.push(self.below(3) as u8);
            }
            _ => {}
        }
        message
    }

    /// Draws a field of a command: a usual value, one at a limit, or any.
    fn number(&mut self, command: u8) -> u64 {
        let limits: &[u64] = match command {
            // Mostly off, because a scan takes as long as hundreds of bytes.
            2 => return u64::from(self.one_in(4) != self.live),
            5 => return self.below(4) as u64,
            // Long ones leave no room for others.
            6 | 16 if !self.one_in(200) => return self.below(40) as u64,
            3 | 18 if self.live => &[8000, 4000, 8001],
            4 if self.live => &[511, 511, 511, 512],
            3 | 19 => &[0, 1, 50, 333, 1000, 1001, 2000, 2001, 4000, 4001, 8000],
            4 => &[0, 60, 511, 512],
            9 => &[0, 5, 6, 8, 64, 4080, 4081],
            18 => &[0, 1, 3, 500, 4000, 4000, 8000, 8001],
            20 => &[0, 3, 4, 255, 256, 256, 256],
            _ => &[0, 2, 8, 128, 4096, 4097, 65_535],
        };
        match self.below(8) {
            0 => u64::from(self.rng.random::<u16>()) % if command == 20 { 257 } else { 65_536 },
            _ => limits[self.below(limits.len() as u32)],
        }
    }

    /// Writes an upload, in half of the cases with a mistake.
    fn upload(&mut self) {
        let any = self.below(self.records.len() as u32);
        let mut record = self.records[any].clone();
        let mistake = self.below(12);
        let at = self.below(record.len() as u32);
        match mistake {
            0 => record[at] ^= 1 << self.below(8),
            // Damaged before the CRC was made: another version, or other content.
            1 | 2 => {
                record[if mistake == 1 { 0 } else { at }] ^= 1 << self.below(8);
                let end = record.len() - 4;
                let crc = crc32(&record[..end]).to_le_bytes();
                record[end..].copy_from_slice(&crc);
            }
            _ => {}
        }
        let tag = self.rng.random();
        let mut send = |command: u8, field: usize, data: &[u8]| {
            let fields = [field as u64, 0, 0];
            let request = Request { tag, command, fields, data: data.to_vec() };
            self.bytes.extend(packet(&request.write()));
        };
        send(9, record.len(), &[]);
        let lost = at / CHUNK;
        for (i, chunk) in record.chunks(CHUNK).enumerate() {
            if (mistake, i) != (3, lost) {
                send(10, i * CHUNK, chunk);
            }
            if (mistake, i) == (4, lost) {
                send(10, i * CHUNK, chunk);
            }
        }
        if mistake != 5 {
            send(11, 0, &[]);
        }
        send(12, at, &[]);
    }
}

/// Counts of a campaign.
#[derive(Debug, Default)]
struct Report {
    bytes: u64,
    aimed: u64,
    /// Bytes of sessions whose scans never stop.
    live: u64,
    damaged: u64,
    restarts: u64,
    compared: Compared,
}

/// Sends so many bytes at least. Each seed is a finger from its first power-up on.
fn campaign(
    seeds: impl Iterator<Item = u64>,
    bytes: u64,
    fault: Option<Fault>,
) -> Result<Report, String> {
    let mut report = Report::default();
    for seed in seeds {
        if report.bytes >= bytes {
            break;
        }
        let rng = ChaCha8Rng::seed_from_u64(seed);
        let mut host = Hostile { rng, bytes: vec![], records: records(), aimed: 0, live: false };
        let mut rig = Rig::new(!host.one_in(4), fault, host.rng.random());
        for _ in 0..SESSIONS {
            host.live = host.one_in(10);
            host.session();
            let pace = if host.live { Pace::Live } else { Pace::Lossless };
            rig.session(&host.bytes, pace).map_err(|wrong| format!("seed {seed}, {wrong}"))?;
            report.aimed += host.aimed as u64;
            if host.one_in(4) {
                report.damaged += rig.model.bad;
                report.restarts += 1;
                rig.restart();
            }
            report.live += if host.live { host.bytes.len() as u64 } else { 0 };
        }
        rig.model.leave();
        report.bytes += rig.model.at;
        report.damaged += rig.model.bad;
        report.compared.add(&rig.model.compared);
    }
    Ok(report)
}

/// Asserts that a fault ends the campaign with one line that names the place and both sides, and
/// that its seed gives the same line again.
fn assert_found(fault: Fault) {
    let run = |seed: u64| campaign(seed.., 10_000_000, Some(fault)).err();
    let wrong = run(3).unwrap_or_else(|| panic!("{fault:?} was not found"));
    assert!(wrong.starts_with("seed 3, byte ") && !wrong.contains('\n'), "{wrong}");
    assert!(wrong.contains("expected ") && wrong.contains("found "), "{wrong}");
    assert_eq!(run(3), Some(wrong), "{fault:?}");
}

#[test]
fn dropped_reply_of_100_000_is_found() {
    assert_found(Fault::DropReply(100_000));
}

#[test]
fn reply_sent_twice_is_found() {
    assert_found(Fault::RepeatReply(50_000));
}

#[test]
fn replies_out_of_order_are_found() {
    assert_found(Fault::SwapReplies(50_000));
}

#[test]
fn bad_packet_counted_twice_is_found() {
    assert_found(Fault::CountTwice(1_000));
}

#[test]
fn inputs_of_the_fuzzer_get_the_models_replies() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for i in 0..3000 {
        let mut input = vec![i as u8];
        // Parts of 2 to 9 bytes, most of them packed: a tag, a command and its fields.
        for _ in 0..rng.random_range(0..30) {
            let length = rng.random_range(2..10);
            let packed = rng.random_range(0..8) > 0;
            input.extend([if packed { length } else { length | 128 }, rng.random()]);
            input.push(rng.random_range(0..22));
            input.extend((2..length).map(|_| rng.random::<u8>() >> rng.random_range(0..8)));
        }
        replay(&input).unwrap_or_else(|wrong| panic!("input {i}, {wrong}: {input:02x?}"));
    }
}

#[test]
fn hostile_bytes_get_the_models_replies() {
    let long = std::env::var_os("TAXEL_LONG").is_some();
    let first = std::env::var("TAXEL_SEED").map_or(1, |seed| seed.parse().unwrap());
    let least = if long { 10_000_000_000 } else { 10_000_000 };
    let begin = std::time::Instant::now();
    let report = campaign(first.., least, None).unwrap_or_else(|wrong| panic!("{wrong}"));
    let Report { bytes, aimed, live, damaged, restarts, compared, .. } = &report;
    let Compared { requests, replies, frames, ended, done, refused } = compared;
    println!(
        "{bytes} bytes, {aimed} of them for requests, {live} with the scan on; {requests} requests, \
         {replies} replies and {frames} frames compared, {damaged} bad packets, {restarts} restarts \
         in {:.1} s; accepted by command: {done:?}; refused by reason: {refused:?}",
        begin.elapsed().as_secs_f64()
    );
    assert!(*bytes >= least && aimed * 3 >= *bytes && live * 30 >= *bytes);
    assert_eq!(requests - replies, *ended, "requests without a reply");
    let megabytes = bytes / 1_000_000;
    assert!(*damaged > 5000 * megabytes && *replies > 10_000 * megabytes && *frames > *restarts);
    assert!(done.iter().all(|count| *count > 20 * megabytes), "{done:?}");
    // All but Storage, because this flash never fails.
    let reasons = refused.iter().enumerate().filter(|(_, count)| **count > 0);
    assert_eq!(reasons.map(|(reason, _)| reason).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 6, 8, 9]);
}
