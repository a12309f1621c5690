//! Persistent store of the calibration and the settings.
//!
//! Calibration and settings are each kept in two areas of flash in turn ([`slots`]). Wherever the
//! power is cut, one whole calibration and one whole set of settings remain.

mod ram;
mod settings;
mod slots;

pub use ram::RamFlash;
pub use settings::{Settings, StoredBias};

use crate::calibration;
use crate::wire::message::Erasures;
use settings::Kept;
use slots::{HEADER, Slots};

/// Smallest unit of programming, eight bytes; programmed only once between two erasures.
///
/// The STM32G4 guards each such word by an ECC (RM0440 §3.3.8), so that even a zero may not be
/// written over a zero.
pub type Word = [u8; 8];
const WORD: usize = size_of::<Word>();

/// Used bytes of a calibration slot.
pub const SLOT: usize = 4096;
/// Used bytes of a settings page.
pub const PAGE: usize = 2048;

const _: () = assert!(calibration::MAX_BYTES == SLOT - HEADER, "a record fills a slot");

/// Areas of the flash that belong to the store. Each is erased as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Area {
    /// First calibration slot: [`SLOT`] bytes.
    SlotA,
    /// Second calibration slot: [`SLOT`] bytes.
    SlotB,
    /// First settings page: [`PAGE`] bytes.
    PageA,
    /// Second settings page: [`PAGE`] bytes.
    PageB,
}

impl Area {
    /// All areas in the order of their addresses.
    pub const ALL: [Self; 4] = [Self::SlotA, Self::SlotB, Self::PageA, Self::PageB];

    /// Returns the number of used bytes of the area.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Self::SlotA | Self::SlotB => SLOT,
            Self::PageA | Self::PageB => PAGE,
        }
    }
}

/// Failure of an erasure or of programming.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FlashError;

/// Memory-mapped NOR flash with blocking calls: a board states how long its scan waits.
pub trait Flash {
    /// Returns the content of an area: at least [`Area::size`] bytes. A word torn by a power cut
    /// may read as anything, but must be readable.
    fn bytes(&self, area: Area) -> &[u8];

    /// Sets every byte of an area to 0xff.
    ///
    /// # Errors
    /// [`FlashError`] if the erasure failed.
    fn erase(&mut self, area: Area) -> Result<(), FlashError>;

    /// Programs an erased word; `offset` is a multiple of its length.
    ///
    /// # Errors
    /// [`FlashError`] if programming failed.
    fn program(&mut self, area: Area, offset: usize, word: Word) -> Result<(), FlashError>;
}

/// Reasons for not storing a record. The active record stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreError {
    /// The bytes do not follow the previous ones, no record was begun, or it is too long.
    OutOfOrder,
    /// The flash failed, or reads back different bytes.
    Flash,
}

impl From<FlashError> for StoreError {
    fn from(FlashError: FlashError) -> Self {
        Self::Flash
    }
}

/// Calibration record and settings in flash.
#[derive(Debug)]
pub struct Store<F> {
    flash: F,
    calibration: Slots,
    settings: Slots,
}

impl<F: Flash> Store<F> {
    /// Makes a store on `flash` without reading it.
    pub const fn new(flash: F) -> Self {
        Self {
            flash,
            calibration: Slots::new([Area::SlotA, Area::SlotB]),
            settings: Slots::new([Area::PageA, Area::PageB]),
        }
    }

    /// Returns the underlying flash.
    pub const fn flash(&self) -> &F {
        &self.flash
    }

    /// Returns the underlying flash, as it is left at power-off.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Finds the newest record that `accept` accepts, and the newest settings. A board does so at
    /// power-up.
    pub fn open(&mut self, accept: impl FnMut(&[u8]) -> bool) {
        self.calibration.open(&self.flash, accept);
        self.settings.open(&self.flash, |bytes| Kept::read(bytes).is_some());
    }

    /// Returns how often the flash was erased over its life.
    #[must_use]
    pub const fn erasures(&self) -> Erasures {
        Erasures { calibration: self.calibration.erasures(), settings: self.settings.erasures() }
    }

    /// Returns the active record.
    #[must_use]
    pub fn record(&self) -> Option<&[u8]> {
        self.calibration.current(&self.flash)
    }

    /// Returns the newest record if the last [`Self::open`] did not accept it. An older record is
    /// then active, or none.
    #[must_use]
    pub fn passed_over(&self) -> Option<&[u8]> {
        self.calibration.passed_over(&self.flash)
    }

    /// Begins a record of `length` bytes and erases the slot that is not active.
    ///
    /// # Errors
    /// The record is longer than a slot holds, or the flash failed.
    pub fn begin(&mut self, length: usize) -> Result<(), StoreError> {
        self.calibration.begin(&mut self.flash, length)
    }

    /// Writes the next bytes of the record. All chunks but the last must be whole words.
    ///
    /// # Errors
    /// The bytes do not follow the previous ones, or the flash failed.
    pub fn write(&mut self, offset: usize, data: &[u8]) -> Result<(), StoreError> {
        self.calibration.write(&mut self.flash, offset, data)
    }

    /// Returns the complete new record, read back from the flash.
    ///
    /// # Errors
    /// No record was begun, or parts of it are missing.
    pub fn written(&self) -> Result<&[u8], StoreError> {
        self.calibration.written(&self.flash)
    }

    /// Makes the written record the newest.
    ///
    /// # Errors
    /// No complete record was written, or the flash failed.
    pub fn commit(&mut self) -> Result<(), StoreError> {
        self.calibration.commit(&mut self.flash)
    }
}
