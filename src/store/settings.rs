//! Settings in two pages of flash, by `sequential-storage`: a power cut leaves the older ones.

use core::task::Poll;

use embassy_futures::poll_once;
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{Area, Flash, FlashError, PAGE, Store, StoreError, WORD, Word};
use crate::condition::Bias;
use crate::estimate::contact_point::PointMethod;
use crate::frame::Fields;

/// Longest item with its key, in whole words: a bias of everything takes 134 bytes (asserted below).
const ITEM: usize = 144;

/// What the host has set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// Frames a second.
    pub hz: u16,
    /// Fields of the frames.
    pub fields: Fields,
    /// How the contact point is found.
    pub point_method: PointMethod,
}

/// A bias taken on command, and the calibration that it was taken under.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredBias {
    /// CRC of the calibration: under another one it means nothing.
    pub calibration: u32,
    /// What the unloaded finger reads; `None` for the calibration's own.
    pub bias: Option<Bias>,
}

/// The items' keys. Frozen: append, never renumber.
trait Item: Serialize + DeserializeOwned {
    const KEY: u8;
}

impl Item for Settings {
    const KEY: u8 = 0;
}

impl Item for StoredBias {
    const KEY: u8 = 1;
}

impl<F: Flash> Store<F> {
    /// The settings that were saved last.
    pub fn settings(&mut self) -> Option<Settings> {
        self.load()
    }

    /// Saves settings.
    ///
    /// # Errors
    /// The flash failed.
    pub fn save_settings(&mut self, settings: &Settings) -> Result<(), StoreError> {
        self.save(settings)
    }

    /// The bias that was saved last.
    pub fn bias(&mut self) -> Option<StoredBias> {
        self.load()
    }

    /// Saves a bias.
    ///
    /// # Errors
    /// The flash failed.
    pub fn save_bias(&mut self, bias: &StoredBias) -> Result<(), StoreError> {
        self.save(bias)
    }

    fn load<T: Item>(&mut self) -> Option<T> {
        let mut buffer = [0; ITEM];
        let mut map = map(&mut self.flash);
        match poll_once(map.fetch_item::<&[u8]>(&mut buffer, &T::KEY)) {
            Poll::Ready(Ok(item)) => postcard::from_bytes(item?).ok(),
            _ => None,
        }
    }

    fn save<T: Item>(&mut self, item: &T) -> Result<(), StoreError> {
        let mut bytes = [0; ITEM];
        let bytes: &[u8] = postcard::to_slice(item, &mut bytes).map_err(|_| StoreError::Flash)?;
        let mut buffer = [0; ITEM];
        let mut map = map(&mut self.flash);
        match poll_once(map.store_item(&mut buffer, &T::KEY, &bytes)) {
            Poll::Ready(Ok(())) => Ok(()),
            // It never is pending: the flash below blocks.
            _ => Err(StoreError::Flash),
        }
    }
}

/// No cache: what is in the flash is looked up at power-up and on command only.
type Map<'f, F> = MapStorage<u8, Pages<'f, F>, Cache<Uncached, Uncached, Uncached, u8>>;

fn map<F: Flash>(flash: &mut F) -> Map<'_, F> {
    let config = const { MapConfig::new(0..2 * PAGE as u32) };
    MapStorage::new(Pages(flash), config, Cache::new_uncached())
}

/// The settings' pages one after the other.
struct Pages<'f, F>(&'f mut F);

fn page(offset: u32) -> (Area, usize) {
    let offset = offset as usize;
    (if offset < PAGE { Area::PageA } else { Area::PageB }, offset % PAGE)
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl<F> ErrorType for Pages<'_, F> {
    type Error = FlashError;
}

impl<F: Flash> ReadNorFlash for Pages<'_, F> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let (area, start) = page(offset);
        let found = self.0.bytes(area).get(start..start + bytes.len()).ok_or(FlashError)?;
        bytes.copy_from_slice(found);
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * PAGE
    }
}

impl<F: Flash> NorFlash for Pages<'_, F> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        for start in (from..to).step_by(PAGE) {
            self.0.erase(page(start).0)?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let (area, start) = page(offset);
        let (words, []) = bytes.as_chunks::<WORD>() else { return Err(FlashError) };
        for (i, word) in words.iter().enumerate() {
            let word: Word = *word;
            self.0.program(area, start + i * WORD, word)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::{BridgeBias, TaxelBias};

    #[test]
    fn the_longest_item_fits_with_its_key() {
        let bias = Bias {
            taxels: Some(TaxelBias { level: [1.0; 16], noise: 1.0 }),
            bridges: [Some(BridgeBias { level: [1.0; 3], noise: 1.0 }); 4],
        };
        let mut buffer = [0; ITEM];
        let longest = StoredBias { calibration: u32::MAX, bias: Some(bias) };
        let length = postcard::to_slice(&longest, &mut buffer).unwrap().len();
        assert!((length + 1).next_multiple_of(WORD) <= ITEM, "{length}");
    }
}
