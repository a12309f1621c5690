//! What survives power-off: the calibration in two slots, and the settings.
//!
//! A new record goes into the slot that is not in force. When all of it is there and has been read back, a
//! header makes it the newest, and not before: wherever the power is cut, one whole calibration is left.
//!
//! ```text
//! slot:  magic u32 │ sequence u32 ║ length u32 │ CRC-32 of these 12 bytes ║ record … 0xff
//!        └───────── header, written last, two words ────────┘
//! ```

mod ram;
mod settings;

pub use ram::RamFlash;
pub use settings::{Settings, StoredBias};

use crate::wire::crc32;

/// Bytes that are programmed at once, and only once between two erasures: the STM32G4 guards each such
/// word by an ECC (RM0440 §3.3.8), so that not even a zero may be written into a zero.
pub type Word = [u8; 8];
const WORD: usize = size_of::<Word>();

/// Bytes of a slot that are used.
pub const SLOT: usize = 4096;
/// Bytes of a page of the settings that are used.
pub const PAGE: usize = 2048;
const HEADER: usize = 2 * WORD;
/// The longest record.
pub const RECORD: usize = SLOT - HEADER;

const MAGIC: [u8; 4] = *b"TXCL";

/// The parts of the flash that belong to the store. Each is erased as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Area {
    /// A calibration: [`SLOT`] bytes.
    SlotA,
    /// The other: [`SLOT`] bytes.
    SlotB,
    /// Settings: [`PAGE`] bytes.
    PageA,
    /// More of them: [`PAGE`] bytes.
    PageB,
}

impl Area {
    /// All of them, in the order in which they stand in the map of memory.
    pub const ALL: [Self; 4] = [Self::SlotA, Self::SlotB, Self::PageA, Self::PageB];

    /// Bytes of it that are used.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Self::SlotA | Self::SlotB => SLOT,
            Self::PageA | Self::PageB => PAGE,
        }
    }
}

/// The flash did not do what it was told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FlashError;

/// NOR flash, mapped into memory. It blocks: a board states how long its scan waits.
pub trait Flash {
    /// What an area holds: at least [`Area::size`] bytes. A word that a power cut tore may read as
    /// anything, but must read.
    fn bytes(&self, area: Area) -> &[u8];

    /// Makes every byte of an area 0xff.
    ///
    /// # Errors
    /// It did not.
    fn erase(&mut self, area: Area) -> Result<(), FlashError>;

    /// Programs an erased word; `offset` is a multiple of its length.
    ///
    /// # Errors
    /// It did not.
    fn program(&mut self, area: Area, offset: usize, word: Word) -> Result<(), FlashError>;
}

/// Why a record was not stored. The one in force stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreError {
    /// Bytes that do not follow those before, or nothing was begun.
    OutOfOrder,
    /// The flash failed, or does not read back what was written.
    Flash,
}

impl From<FlashError> for StoreError {
    fn from(FlashError: FlashError) -> Self {
        Self::Flash
    }
}

/// What survives power-off.
#[derive(Debug)]
pub struct Store<F> {
    flash: F,
    newest: Option<Newest>,
    incoming: Option<Incoming>,
}

/// The slot whose record is in force.
#[derive(Clone, Copy, Debug)]
struct Newest {
    slot: Area,
    sequence: u32,
    length: usize,
}

/// A record on its way into the other slot.
#[derive(Clone, Copy, Debug)]
struct Incoming {
    expected: usize,
    received: usize,
}

impl<F: Flash> Store<F> {
    /// A store on `flash`, nothing read yet.
    pub const fn new(flash: F) -> Self {
        Self { flash, newest: None, incoming: None }
    }

    /// The flash below.
    pub const fn flash(&self) -> &F {
        &self.flash
    }

    /// The flash below, as it is left at power-off.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Finds the newest record that `accept` takes, as a board does at power-up. The other slot is tried
    /// where it takes none: that is what a power cut leaves behind.
    pub fn open(&mut self, mut accept: impl FnMut(&[u8]) -> bool) {
        self.incoming = None;
        let found = [Area::SlotA, Area::SlotB].map(|slot| self.header(slot));
        let [first, second] = match found {
            [Some(a), Some(b)] if b.sequence > a.sequence => [Some(b), Some(a)],
            other => other,
        };
        self.newest = first.filter(|newest| accept(self.record_in(newest)));
        if self.newest.is_none() {
            self.newest = second.filter(|newest| accept(self.record_in(newest)));
        }
    }

    /// The record in force.
    #[must_use]
    pub fn record(&self) -> Option<&[u8]> {
        self.newest.as_ref().map(|newest| self.record_in(newest))
    }

    /// A record of `length` bytes will follow: erases the slot that is not in force.
    ///
    /// # Errors
    /// It is longer than any record, or the flash failed.
    pub fn begin(&mut self, length: usize) -> Result<(), StoreError> {
        self.incoming = None;
        if length > RECORD {
            return Err(StoreError::OutOfOrder);
        }
        self.flash.erase(self.other_slot())?;
        self.incoming = Some(Incoming { expected: length, received: 0 });
        Ok(())
    }

    /// The next bytes of it. All but the last must be whole words.
    ///
    /// # Errors
    /// They do not follow the last, or the flash failed.
    pub fn write(&mut self, offset: usize, data: &[u8]) -> Result<(), StoreError> {
        let incoming = self.incoming.ok_or(StoreError::OutOfOrder)?;
        let received = offset.saturating_add(data.len());
        let whole = data.len().is_multiple_of(WORD) || received == incoming.expected;
        if offset != incoming.received || received > incoming.expected || !whole {
            return Err(StoreError::OutOfOrder);
        }
        let slot = self.other_slot();
        for (i, bytes) in data.chunks(WORD).enumerate() {
            let mut word = [0xff; WORD];
            word.iter_mut().zip(bytes).for_each(|(word, byte)| *word = *byte);
            self.flash.program(slot, HEADER + offset + i * WORD, word)?;
        }
        self.incoming = Some(Incoming { received, ..incoming });
        Ok(())
    }

    /// The record that has been written, as the flash reads it.
    ///
    /// # Errors
    /// There is none, or parts of it are missing.
    pub fn written(&self) -> Result<&[u8], StoreError> {
        match self.incoming {
            Some(Incoming { expected, received }) if expected == received => {
                let bytes = self.flash.bytes(self.other_slot());
                bytes.get(HEADER..HEADER + expected).ok_or(StoreError::Flash)
            }
            _ => Err(StoreError::OutOfOrder),
        }
    }

    /// Makes what has been written the newest record.
    ///
    /// # Errors
    /// There is nothing, or the flash failed.
    pub fn commit(&mut self) -> Result<(), StoreError> {
        let length = self.written()?.len();
        let slot = self.other_slot();
        let sequence = self.newest.map_or(0, |newest| newest.sequence.wrapping_add(1));
        self.incoming = None;
        let [first, second] = header(sequence, length);
        self.flash.program(slot, 0, first)?;
        self.flash.program(slot, WORD, second)?;
        match self.header(slot) {
            Some(newest) if newest.sequence == sequence && newest.length == length => {
                self.newest = Some(newest);
                Ok(())
            }
            _ => Err(StoreError::Flash),
        }
    }

    fn other_slot(&self) -> Area {
        match self.newest {
            Some(Newest { slot: Area::SlotA, .. }) => Area::SlotB,
            _ => Area::SlotA,
        }
    }

    fn header(&self, slot: Area) -> Option<Newest> {
        let (head, _) = self.flash.bytes(slot).split_first_chunk::<HEADER>()?;
        let [_, _, _, _, s0, s1, s2, s3, l0, l1, l2, l3, ..] = *head;
        let sequence = u32::from_le_bytes([s0, s1, s2, s3]);
        let length = usize::try_from(u32::from_le_bytes([l0, l1, l2, l3])).ok()?;
        let whole = header(sequence, length).as_flattened() == head;
        (whole && length <= RECORD).then_some(Newest { slot, sequence, length })
    }

    fn record_in(&self, newest: &Newest) -> &[u8] {
        let bytes = self.flash.bytes(newest.slot);
        bytes.get(HEADER..HEADER + newest.length).unwrap_or_default()
    }
}

/// The two words that make a record the newest.
fn header(sequence: u32, length: usize) -> [Word; 2] {
    let [m0, m1, m2, m3] = MAGIC;
    let [s0, s1, s2, s3] = sequence.to_le_bytes();
    // Lengths are checked against RECORD before they come here.
    let [l0, l1, l2, l3] = (length as u32).to_le_bytes();
    let head = [m0, m1, m2, m3, s0, s1, s2, s3, l0, l1, l2, l3];
    let [c0, c1, c2, c3] = crc32(&head).to_le_bytes();
    [[m0, m1, m2, m3, s0, s1, s2, s3], [l0, l1, l2, l3, c0, c1, c2, c3]]
}
