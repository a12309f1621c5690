//! What survives power-off: the calibration, and the settings.
//!
//! Either is kept twice, in two areas of flash in turn ([`slots`]): wherever the power is cut, one whole
//! calibration and one set of settings is left.

mod ram;
mod settings;
mod slots;

pub use ram::RamFlash;
pub use settings::{Settings, StoredBias};

use crate::calibration;
use settings::Kept;
use slots::{HEADER, Slots};

/// Bytes that are programmed at once, and only once between two erasures: the STM32G4 guards each such
/// word by an ECC (RM0440 §3.3.8), so that not even a zero may be written into a zero.
pub type Word = [u8; 8];
const WORD: usize = size_of::<Word>();

/// Bytes of a slot that are used.
pub const SLOT: usize = 4096;
/// Bytes of a page of the settings that are used.
pub const PAGE: usize = 2048;

const _: () = assert!(calibration::MAX_BYTES == SLOT - HEADER, "a record fills a slot");

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
    calibration: Slots,
    settings: Slots,
}

impl<F: Flash> Store<F> {
    /// A store on `flash`, nothing read yet.
    pub const fn new(flash: F) -> Self {
        Self {
            flash,
            calibration: Slots::new([Area::SlotA, Area::SlotB]),
            settings: Slots::new([Area::PageA, Area::PageB]),
        }
    }

    /// The flash below.
    pub const fn flash(&self) -> &F {
        &self.flash
    }

    /// The flash below, as it is left at power-off.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Finds the newest record that `accept` takes, and the newest settings, as a board does at power-up.
    pub fn open(&mut self, accept: impl FnMut(&[u8]) -> bool) {
        self.calibration.open(&self.flash, accept);
        self.settings.open(&self.flash, |bytes| Kept::read(bytes).is_some());
    }

    /// The record in force.
    #[must_use]
    pub fn record(&self) -> Option<&[u8]> {
        self.calibration.current(&self.flash)
    }

    /// A record that was put in force once, and that the last [`Self::open`] did not accept: an older one is
    /// in force, or none.
    #[must_use]
    pub fn passed_over(&self) -> Option<&[u8]> {
        self.calibration.passed_over(&self.flash)
    }

    /// A record of `length` bytes will follow: erases the slot that is not in force.
    ///
    /// # Errors
    /// It is longer than any record, or the flash failed.
    pub fn begin(&mut self, length: usize) -> Result<(), StoreError> {
        self.calibration.begin(&mut self.flash, length)
    }

    /// The next bytes of it. All but the last must be whole words.
    ///
    /// # Errors
    /// They do not follow the last, or the flash failed.
    pub fn write(&mut self, offset: usize, data: &[u8]) -> Result<(), StoreError> {
        self.calibration.write(&mut self.flash, offset, data)
    }

    /// The record that has been written, as the flash reads it.
    ///
    /// # Errors
    /// There is none, or parts of it are missing.
    pub fn written(&self) -> Result<&[u8], StoreError> {
        self.calibration.written(&self.flash)
    }

    /// Makes what has been written the newest record.
    ///
    /// # Errors
    /// There is nothing, or the flash failed.
    pub fn commit(&mut self) -> Result<(), StoreError> {
        self.calibration.commit(&mut self.flash)
    }
}
