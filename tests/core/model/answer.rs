//! Reply to each command, and the state that an accepted one leaves.

use super::wire::{self, CHUNK, Reader, Request, put};
use super::{FASTEST, Facts, Model};

/// Longest calibration record in bytes.
const RECORD: u64 = 4080;

/// Calibration record on its way.
pub(super) struct Upload {
    length: u64,
    bytes: Vec<u8>,
}

/// Reply that a request must get.
#[derive(Debug)]
pub(super) enum Expected {
    Message(Vec<u8>),
    /// This message, or what else the request gets.
    Either(Vec<u8>, Box<Expected>),
    /// Health with the erasures after these bytes.
    Health(Vec<u8>),
    /// Bias, taken on command or not.
    Bias(bool),
    /// Info with any scans and frames between these bytes.
    Info(Vec<u8>, Vec<u8>),
    /// Done or the refusal of a record whose content is wrong.
    Judgement,
}

impl Model {
    /// Reply to a request that no scan has to answer, after so many scans at most.
    pub(super) fn answer(&self, request: &Request, bad: u64, most: u64) -> Expected {
        let expected = self.unpaced(request, bad);
        match request.command {
            9 | 13 | 14 => self.paced(request.tag, most, expected),
            _ => expected,
        }
    }

    fn unpaced(&self, request: &Request, bad: u64) -> Expected {
        let Request { tag, command, fields: [first, ..], ref data } = *request;
        let done = || Expected::Message(vec![1, tag, 0, 0]);
        let refusal = |number: u8, fields: &[u64]| {
            let mut message = vec![1, tag, 1, number];
            fields.iter().for_each(|field| put(&mut message, *field));
            Expected::Message(message)
        };
        let range = |low: u64, high: u64| refusal(0, &[low, high]);
        let [busy, out_of_order, unsupported] = [2, 3, 8];
        let late = self.late.is_some();
        let taking = self.late.as_ref().is_some_and(|late| late.test.is_none());
        match command {
            0 => {
                let [major, minor, patch] = self.facts.firmware;
                Expected::Message(vec![0, tag, 2, major, minor, patch])
            }
            1 => self.info(tag, bad),
            3 if first == 0 || first > self.scan_hz => range(1, self.scan_hz),
            3 => {
                let mut message = vec![1, tag, 0, 2];
                put(&mut message, self.millihertz(first));
                Expected::Message(message)
            }
            4 if first > 511 => range(0, 511),
            6 if first < 2 => range(2, 65_535),
            16 if !(2..=4096).contains(&first) => range(2, 4096),
            6 | 16 => refusal(busy, &[]),
            7 => Expected::Bias(self.biased),
            8 | 11 | 14 if taking => refusal(busy, &[]),
            9 if !(6..=RECORD).contains(&first) => range(6, RECORD),
            10 if !self.upload.as_ref().is_some_and(|upload| upload.follows(first, data)) => {
                refusal(out_of_order, &[])
            }
            11 => match &self.upload {
                Some(Upload { length, bytes }) if *length == bytes.len() as u64 => {
                    let (body, crc) = bytes.split_at(bytes.len() - 4);
                    let version = u64::from(u16::from_le_bytes([bytes[0], bytes[1]]));
                    match version {
                        _ if wire::crc32(body).to_le_bytes() != crc => refusal(4, &[1]),
                        2 if self.facts.records.contains(bytes) => done(),
                        2 => Expected::Judgement,
                        _ => refusal(4, &[2, version]),
                    }
                }
                _ => refusal(out_of_order, &[]),
            },
            12 => match &self.record {
                None => refusal(5, &[]),
                Some(record) => {
                    let rest = record.get(first as usize..).unwrap_or_default();
                    let data = &rest[..rest.len().min(CHUNK)];
                    let mut message = vec![1, tag, 0, 4];
                    put(&mut message, first);
                    put(&mut message, data.len() as u64);
                    message.extend_from_slice(data);
                    Expected::Message(message)
                }
            },
            // All unknown but the cost of frames, which is 0 ticks, and the erasures.
            15 => Expected::Health(vec![1, tag, 0, 5, 0, 0, 0, 1, 0, 0, 0, 0, 1]),
            17 if !self.facts.equipped => refusal(unsupported, &[]),
            18 | 20 if late => refusal(busy, &[]),
            18 if !(1..=FASTEST).contains(&first) => refusal(9, &[0, 1, FASTEST]),
            19 if first > self.scan_hz / 4 => range(0, self.scan_hz / 4),
            20 if (4..256).contains(&first) => range(0, 3),
            20 if !self.facts.equipped => refusal(unsupported, &[]),
            _ => done(),
        }
    }

    /// Changes the state as a request does that the finger accepted.
    pub(super) fn apply(&mut self, request: Request) {
        let Request { command, fields: [first, ..], data, .. } = request;
        match command {
            2 => self.streaming = first == 1,
            3 => self.hz = first,
            4 => self.fields = first,
            5 => self.method = first,
            8 => self.biased = false,
            9 => self.upload = Some(Upload { length: first, bytes: vec![] }),
            10 => self.upload.iter_mut().for_each(|upload| upload.bytes.extend(&data)),
            11 => {
                self.record = self.upload.take().map(|upload| upload.bytes);
                self.biased = false;
            }
            13 => {
                let settings = [self.hz, self.filter, self.fields, self.method];
                self.saved.settings = Some((settings, self.scan));
            }
            14 => self.saved.bias = self.biased.then(|| self.calibration()),
            18 => {
                self.scan = Some(first);
                self.scan_hz = first;
                self.hz = self.hz.min(first);
                self.filter = self.filter.min(first / 4);
                self.biased = false;
            }
            19 => self.filter = first,
            20 => self.held = first < 256,
            _ => {}
        }
    }

    /// Actual frames per thousand seconds: one every so many scans, rounded.
    fn millihertz(&self, hz: u64) -> u64 {
        self.scan_hz * 1000 / ((self.scan_hz + hz / 2) / hz)
    }

    /// Reply to Info around the counts of scans and frames; all other counts are known.
    fn info(&self, tag: u8, bad: u64) -> Expected {
        let Facts { names, full_scale, tick_hz, estimators, .. } = &self.facts;
        let mut begin = vec![1, tag, 0, 1];
        for name in names {
            put(&mut begin, name.len() as u64);
            begin.extend(name.bytes());
        }
        put(&mut begin, self.scan_hz);
        begin.extend(full_scale.to_le_bytes());
        for number in [*tick_hz, self.millihertz(self.hz), self.fields] {
            put(&mut begin, number);
        }
        begin.extend([u8::from(self.streaming), self.method as u8, u8::from(self.biased)]);
        let calibration = self.record.as_ref().map_or(Some(vec![0]), |record| identity(record));
        begin.extend(calibration.unwrap_or_default());
        let mut end = vec![0];
        for number in [bad, 0, 0, 0, *estimators, self.filter] {
            put(&mut end, number);
        }
        Expected::Info(begin, end)
    }
}

impl Upload {
    /// Whether a chunk is the next one: whole words unless it is the last.
    fn follows(&self, offset: u64, data: &[u8]) -> bool {
        let end = offset + data.len() as u64;
        let next = offset == self.bytes.len() as u64 && end <= self.length;
        next && (data.len().is_multiple_of(8) || end == self.length)
    }
}

/// Returns the calibration's part of an Info: the serial, the date and the CRC of a record.
fn identity(record: &[u8]) -> Option<Vec<u8>> {
    let (body, crc) = record.split_last_chunk()?;
    let mut rest = Reader(body.get(2..)?);
    let length = rest.number(64)?;
    let serial = rest.bytes(usize::try_from(length).ok()?)?;
    let mut part = vec![1];
    put(&mut part, length);
    part.extend_from_slice(serial);
    put(&mut part, rest.number(64)?);
    put(&mut part, u64::from(u32::from_le_bytes(*crc)));
    Some(part)
}
