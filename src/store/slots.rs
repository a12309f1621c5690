//! Two alternating areas of flash: one holds the active content, the other takes the next.
//!
//! ```text
//! area:  magic u32 │ sequence u32 ║ length u32 │ CRC-32 of these 12 bytes ║ content … 0xff
//!        └───────── header, written last, two words ────────┘
//! ```
//! The sequence counts the erasures of both areas, so that it also tells their wear. An erasure
//! whose content was never finished is in it only if a later one is finished before power-off.
//! The header is written only when all of the new content is there and has been read back; it makes
//! that content the newest. Wherever the power is cut, one whole content remains.

use super::{Area, Flash, StoreError, WORD, Word};
use crate::crc32::crc32;

pub(super) const HEADER: usize = 2 * WORD;
const MAGIC: [u8; 4] = *b"TXCL";

/// State of the two areas.
#[derive(Debug)]
pub(super) struct Slots {
    areas: [Area; 2],
    newest: Option<Newest>,
    /// Newer content that was not accepted when it was read at power-up.
    passed_over: Option<Newest>,
    incoming: Option<Incoming>,
    /// Erasures of both areas over their life.
    erasures: u32,
}

/// The area that holds the active content.
#[derive(Clone, Copy, Debug)]
struct Newest {
    area: Area,
    sequence: u32,
    length: usize,
}

/// Content being written into the other area.
#[derive(Clone, Copy, Debug)]
struct Incoming {
    expected: usize,
    received: usize,
}

impl Slots {
    pub(super) const fn new(areas: [Area; 2]) -> Self {
        Self { areas, newest: None, passed_over: None, incoming: None, erasures: 0 }
    }

    /// Finds the newest content that `accept` accepts. The other area is tried if it accepts none,
    /// as after a power cut.
    pub(super) fn open(&mut self, flash: &impl Flash, mut accept: impl FnMut(&[u8]) -> bool) {
        (self.incoming, self.passed_over) = (None, None);
        let found = self.areas.map(|area| newest_in(flash, area));
        let [first, second] = match found {
            [Some(a), Some(b)] if b.follows(a) => [Some(b), Some(a)],
            [None, Some(b)] => [Some(b), None],
            other => other,
        };
        self.erasures = first.map_or(0, |newest| newest.sequence);
        self.newest = first.filter(|newest| accept(newest.content(flash)));
        if self.newest.is_none() {
            self.newest = second.filter(|newest| accept(newest.content(flash)));
            self.passed_over = first;
        }
    }

    /// Returns the newest content if it was not accepted at power-up, until it is replaced.
    pub(super) fn passed_over<'f>(&self, flash: &'f impl Flash) -> Option<&'f [u8]> {
        self.passed_over.as_ref().map(|newest| newest.content(flash))
    }

    /// Returns the erasures of both areas over their life.
    pub(super) const fn erasures(&self) -> u32 {
        self.erasures
    }

    /// Returns the active content.
    pub(super) fn current<'f>(&self, flash: &'f impl Flash) -> Option<&'f [u8]> {
        self.newest.as_ref().map(|newest| newest.content(flash))
    }

    /// Erases the other area for `length` bytes.
    pub(super) fn begin(
        &mut self,
        flash: &mut impl Flash,
        length: usize,
    ) -> Result<(), StoreError> {
        self.incoming = None;
        let area = self.other();
        if length > area.size() - HEADER {
            return Err(StoreError::OutOfOrder);
        }
        self.passed_over = self.passed_over.filter(|passed| passed.area != area);
        self.erasures = self.erasures.wrapping_add(1);
        flash.erase(area)?;
        self.incoming = Some(Incoming { expected: length, received: 0 });
        Ok(())
    }

    /// Writes the next bytes; all chunks but the last must be whole words.
    pub(super) fn write(
        &mut self,
        flash: &mut impl Flash,
        offset: usize,
        data: &[u8],
    ) -> Result<(), StoreError> {
        let incoming = self.incoming.ok_or(StoreError::OutOfOrder)?;
        let received = offset.saturating_add(data.len());
        let whole = data.len().is_multiple_of(WORD) || received == incoming.expected;
        if offset != incoming.received || received > incoming.expected || !whole {
            return Err(StoreError::OutOfOrder);
        }
        let area = self.other();
        let (words, rest) = data.as_chunks();
        let mut last = [0xff; WORD];
        last.iter_mut().zip(rest).for_each(|(word, byte)| *word = *byte);
        let last = (!rest.is_empty()).then_some(&last);
        for (i, word) in words.iter().chain(last).enumerate() {
            flash.program(area, HEADER + offset + i * WORD, *word)?;
        }
        self.incoming = Some(Incoming { received, ..incoming });
        Ok(())
    }

    /// Returns the complete new content, read back from the flash.
    pub(super) fn written<'f>(&self, flash: &'f impl Flash) -> Result<&'f [u8], StoreError> {
        match self.incoming {
            Some(Incoming { expected, received }) if expected == received => {
                let bytes = flash.bytes(self.other());
                bytes.get(HEADER..HEADER + expected).ok_or(StoreError::Flash)
            }
            _ => Err(StoreError::OutOfOrder),
        }
    }

    /// Makes the written content the newest.
    pub(super) fn commit(&mut self, flash: &mut impl Flash) -> Result<(), StoreError> {
        let length = self.written(flash)?.len();
        let area = self.other();
        // Larger than that of any content at power-up, because the area was erased since.
        let sequence = self.erasures;
        self.incoming = None;
        let [first, second] = header(sequence, length);
        flash.program(area, 0, first)?;
        flash.program(area, WORD, second)?;
        match newest_in(flash, area) {
            Some(newest) if newest.sequence == sequence && newest.length == length => {
                (self.newest, self.passed_over) = (Some(newest), None);
                Ok(())
            }
            _ => Err(StoreError::Flash),
        }
    }

    fn other(&self) -> Area {
        let [first, second] = self.areas;
        match self.newest {
            Some(newest) if newest.area == first => second,
            _ => first,
        }
    }
}

impl Newest {
    /// Whether this content was written after `other`; the sequence may have wrapped in between.
    fn follows(&self, other: Self) -> bool {
        self.sequence.wrapping_sub(other.sequence).cast_signed() > 0
    }

    fn content<'f>(&self, flash: &'f impl Flash) -> &'f [u8] {
        flash.bytes(self.area).get(HEADER..HEADER + self.length).unwrap_or_default()
    }
}

fn newest_in(flash: &impl Flash, area: Area) -> Option<Newest> {
    let (head, _) = flash.bytes(area).split_first_chunk::<HEADER>()?;
    let [_, _, _, _, s0, s1, s2, s3, l0, l1, l2, l3, ..] = *head;
    let sequence = u32::from_le_bytes([s0, s1, s2, s3]);
    let length = usize::try_from(u32::from_le_bytes([l0, l1, l2, l3])).ok()?;
    let whole = header(sequence, length).as_flattened() == head;
    (whole && length <= area.size() - HEADER).then_some(Newest { area, sequence, length })
}

/// Returns the two header words that make a content the newest.
fn header(sequence: u32, length: usize) -> [Word; 2] {
    let [m0, m1, m2, m3] = MAGIC;
    let [s0, s1, s2, s3] = sequence.to_le_bytes();
    // The caller has checked the length against the area.
    let [l0, l1, l2, l3] = (length as u32).to_le_bytes();
    let head = [m0, m1, m2, m3, s0, s1, s2, s3, l0, l1, l2, l3];
    let [c0, c1, c2, c3] = crc32(&head).to_le_bytes();
    [[m0, m1, m2, m3, s0, s1, s2, s3], [l0, l1, l2, l3, c0, c1, c2, c3]]
}
