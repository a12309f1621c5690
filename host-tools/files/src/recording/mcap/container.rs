//! Records of an MCAP file outside its chunks, found in a damaged file too.
//!
//! A record states its length, so that one wrong length hides everything behind it. Where a record
//! is impossible, the reader therefore searches for the next chunk: its compression stands at a
//! fixed place as text, its length stands in it twice, and its CRC settles the matter.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

use mcap::records::op;

use super::chunk::Chunk;

/// Longest accepted record in bytes, far above this writer's own.
const LONGEST: u64 = 64 << 20;
/// First operation code that programs may use as they like.
const PRIVATE: u8 = 0x80;
/// Length of a record's operation code and length.
const PREFIX: u64 = 9;
/// Place of the compression's length in a record of a chunk, after both times, size and CRC.
const COMPRESSION_AT: usize = PREFIX as usize + 28;
/// Names of compressions with their lengths, as they stand in a chunk.
const MARKS: [&[u8]; 2] = [b"\x03\0\0\0lz4", b"\x04\0\0\0zstd"];
/// Bytes of the file that a search reads at once.
const WINDOW: usize = 1 << 16;

/// Record of a file outside its chunks.
pub(super) enum Found {
    Chunk(Chunk),
    Other {
        opcode: u8,
        data: Vec<u8>,
    },
    /// Damaged bytes; the records found after them follow.
    Damage(&'static str),
}

/// Reader of the records of a file outside its chunks.
pub(super) struct Container {
    file: BufReader<File>,
    at: u64,
    /// Length of the file, or none of a pipe.
    length: Option<u64>,
    /// End of the last chunk whose two lengths agree: a search begins there.
    sound: u64,
    /// Chunk found by a search.
    next: Option<Chunk>,
    /// Whether the summary has begun, whose records stand nowhere else.
    summary: bool,
    over: bool,
    /// Whether the file begins as every MCAP file does.
    pub(super) begins: bool,
    /// Whether the file ends as every MCAP file does; assumed of a pipe.
    pub(super) ends: bool,
}

impl Container {
    /// Prepares to read a file from its start.
    pub(super) fn new(mut file: File) -> io::Result<Self> {
        let length = file.seek(SeekFrom::End(0)).ok();
        let at = mcap::MAGIC.len() as u64;
        let mut container = Self {
            file: BufReader::new(file),
            at: 0,
            length,
            sound: at,
            next: None,
            summary: false,
            over: false,
            begins: false,
            ends: true,
        };
        if let Some(length) = length {
            container.seek(length.saturating_sub(at))?;
            container.ends = container.take(at)? == mcap::MAGIC;
            container.seek(0)?;
        }
        container.begins = container.take(at)? == mcap::MAGIC;
        Ok(container)
    }

    /// Reads the next record.
    pub(super) fn next(&mut self) -> io::Result<Option<Found>> {
        if let Some(chunk) = self.next.take() {
            return Ok(Some(Found::Chunk(chunk)));
        }
        if self.over {
            return Ok(None);
        }
        match self.record()? {
            Ok(found) => Ok(Some(found)),
            Err(problem) => {
                let cut = problem == CUT;
                let found = self.search()?;
                // A killed writer's file ends within a record, which is no damage.
                self.over = !found;
                Ok((found || !cut).then_some(Found::Damage(problem)))
            }
        }
    }

    /// Lists where the chunks begin, by the lengths of the records alone. `None` if a length or a
    /// code is impossible.
    pub(super) fn chunks(&mut self) -> io::Result<Option<Vec<u64>>> {
        let Some(end) = self.length else { return Ok(None) };
        let (mut starts, mut at) = (Vec::new(), mcap::MAGIC.len() as u64);
        loop {
            self.seek(at)?;
            let prefix = self.take(PREFIX)?;
            let Some((&opcode, length)) = prefix.split_first() else { return Ok(Some(starts)) };
            let Ok(length) = length.try_into().map(u64::from_le_bytes) else {
                return Ok(Some(starts));
            };
            if length > LONGEST {
                return Ok(None);
            }
            let next = at + PREFIX + length;
            match opcode {
                op::DATA_END => return Ok(Some(starts)),
                // A killed writer's last record.
                _ if next > end => return Ok((!self.ends).then_some(starts)),
                op::CHUNK => starts.push(at),
                op::HEADER | op::MESSAGE_INDEX | op::ATTACHMENT | op::METADATA => {}
                op::SCHEMA | op::CHANNEL | PRIVATE.. => {}
                _ => return Ok(None),
            }
            at = next;
        }
    }

    /// Moves to the beginning of a record.
    pub(super) fn jump(&mut self, start: u64) -> io::Result<()> {
        self.seek(start)?;
        (self.sound, self.next, self.over) = (start, None, false);
        Ok(())
    }

    /// Reads a record by its length, or returns why there is none.
    fn record(&mut self) -> io::Result<Result<Found, &'static str>> {
        let prefix = self.take(PREFIX)?;
        let Some((&opcode, length)) = prefix.split_first() else { return Ok(Err(CUT)) };
        let Ok(length) = length.try_into().map(u64::from_le_bytes) else { return Ok(Err(CUT)) };
        let known = match opcode {
            op::HEADER
            | op::MESSAGE
            | op::CHUNK
            | op::MESSAGE_INDEX
            | op::ATTACHMENT
            | op::METADATA
            | op::DATA_END => !self.summary,
            op::SCHEMA | op::CHANNEL | PRIVATE.. => true,
            _ => self.summary,
        };
        if !known || length > LONGEST {
            return Ok(Err("no record begins here"));
        }
        let data = self.take(length)?;
        if (data.len() as u64) < length {
            return Ok(Err(CUT));
        }
        if !fits(opcode, &data) {
            return Ok(Err("a record's length is wrong"));
        }
        if opcode == op::CHUNK {
            self.sound = self.at;
            return Ok(Ok(Found::Chunk(Chunk(data))));
        }
        self.summary |= opcode == op::DATA_END;
        self.over = opcode == op::FOOTER;
        Ok(Ok(Found::Other { opcode, data }))
    }

    /// Searches from the last whole record for the next chunk with a right CRC.
    fn search(&mut self) -> io::Result<bool> {
        if self.length.is_none() {
            return Ok(false);
        }
        let mut from = self.sound;
        loop {
            self.seek(from)?;
            let window = self.take(WINDOW as u64)?;
            let marks = (COMPRESSION_AT..window.len())
                .filter(|at| MARKS.iter().any(|mark| window[*at..].starts_with(mark)));
            for mark in marks {
                let start = from + (mark - COMPRESSION_AT) as u64;
                if let Some((chunk, end)) = self.chunk_at(start)? {
                    self.seek(end)?;
                    (self.sound, self.next) = (end, Some(chunk));
                    return Ok(true);
                }
            }
            if window.len() < WINDOW {
                return Ok(false);
            }
            // A mark at the window's end stands whole in the next window.
            from += (WINDOW / 2) as u64;
        }
    }

    /// Reads a chunk by either of its two lengths; returns it and its end.
    fn chunk_at(&mut self, start: u64) -> io::Result<Option<(Chunk, u64)>> {
        self.seek(start)?;
        let beginning = self.take(PREFIX + Chunk::HEADER)?;
        let inner = beginning.get(PREFIX as usize..).and_then(Chunk::length);
        let mut lengths = [number(&beginning, 1, 8), inner];
        // A wrong longer one would take what follows for a part of this chunk.
        lengths.sort_unstable();
        for length in lengths.into_iter().flatten() {
            if length > LONGEST {
                continue;
            }
            self.seek(start + PREFIX)?;
            let mut chunk = Chunk(self.take(length)?);
            if chunk.0.len() as u64 == length && chunk.set_length() && chunk.records().is_ok() {
                return Ok(Some((chunk, self.at)));
            }
        }
        Ok(None)
    }

    fn seek(&mut self, at: u64) -> io::Result<()> {
        self.at = self.file.seek(SeekFrom::Start(at))?;
        Ok(())
    }

    /// Reads so many bytes, or fewer at the end of the file. Takes no more memory than is read.
    fn take(&mut self, length: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        (&mut self.file).take(length).read_to_end(&mut bytes)?;
        self.at += bytes.len() as u64;
        Ok(bytes)
    }
}

/// The file ends within a record.
const CUT: &str = "the file ends within a record";

/// Returns whether a record's length agrees with those of its parts.
///
/// The library would reserve memory for any length that a damaged record states.
fn fits(opcode: u8, data: &[u8]) -> bool {
    let end = match opcode {
        op::CHUNK => Chunk::length(data).and_then(|length| usize::try_from(length).ok()),
        op::HEADER => after(data, 0, 4).and_then(|at| after(data, at, 4)),
        // Channel, then entries.
        op::MESSAGE_INDEX => after(data, 2, 4),
        op::METADATA => after(data, 0, 4).and_then(|map| {
            let mut at = map + 4;
            while at < data.len() {
                at = after(data, at, 4)?;
            }
            after(data, map, 4).filter(|end| *end == at)
        }),
        // Number, name, encoding, content.
        op::SCHEMA => {
            after(data, 2, 4).and_then(|at| after(data, at, 4)).and_then(|at| after(data, at, 4))
        }
        // Two numbers, topic, encoding, map.
        op::CHANNEL => {
            after(data, 4, 4).and_then(|at| after(data, at, 4)).and_then(|at| after(data, at, 4))
        }
        // Two times, name, type, content, CRC.
        op::ATTACHMENT => after(data, 16, 4)
            .and_then(|at| after(data, at, 4))
            .and_then(|at| after(data, at, 8))
            .map(|at| at + 4),
        // A chunk with a damaged code looks like one.
        PRIVATE.. if Chunk::length(data) == Some(data.len() as u64) => None,
        op::DATA_END => Some(4),
        op::FOOTER => Some(20),
        _ => Some(data.len()),
    };
    end == Some(data.len())
}

/// Returns the end of a part that begins with its length, a number of `width` bytes.
fn after(data: &[u8], at: usize, width: usize) -> Option<usize> {
    let length = usize::try_from(number(data, at, width)?).ok()?;
    at.checked_add(width)?.checked_add(length).filter(|end| *end <= data.len())
}

/// Reads a little-endian number of at most eight bytes.
pub(super) fn number(bytes: &[u8], at: usize, width: usize) -> Option<u64> {
    let bytes = bytes.get(at..at.checked_add(width)?)?;
    Some(bytes.iter().rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte)))
}
