//! RAM that behaves like flash, for fingers without flash, such as the virtual one.

use super::{Area, Flash, FlashError, Word};

/// NOR flash in RAM, as strict as real flash: a word is programmed once between two erasures.
#[derive(Clone, Debug)]
pub struct RamFlash<B> {
    bytes: B,
}

impl RamFlash<()> {
    /// Number of bytes it needs.
    pub const SIZE: usize = {
        let [a, b, c, d] = Area::ALL;
        a.size() + b.size() + c.size() + d.size()
    };
}

impl<B: AsRef<[u8]> + AsMut<[u8]>> RamFlash<B> {
    /// Makes an erased flash in `bytes`, which must have at least [`RamFlash::SIZE`] bytes.
    pub fn new(mut bytes: B) -> Self {
        bytes.as_mut().fill(0xff);
        Self { bytes }
    }

    fn area(&mut self, area: Area) -> Result<&mut [u8], FlashError> {
        let start = start(area);
        self.bytes.as_mut().get_mut(start..start + area.size()).ok_or(FlashError)
    }
}

fn start(area: Area) -> usize {
    Area::ALL.iter().take_while(|other| **other != area).map(|other| other.size()).sum()
}

impl<B: AsRef<[u8]> + AsMut<[u8]>> Flash for RamFlash<B> {
    fn bytes(&self, area: Area) -> &[u8] {
        let start = start(area);
        self.bytes.as_ref().get(start..start + area.size()).unwrap_or_default()
    }

    fn erase(&mut self, area: Area) -> Result<(), FlashError> {
        self.area(area)?.fill(0xff);
        Ok(())
    }

    fn program(&mut self, area: Area, offset: usize, word: Word) -> Result<(), FlashError> {
        let erased: Word = [0xff; _];
        let bytes = self.area(area)?.get_mut(offset..).and_then(<[u8]>::first_chunk_mut);
        match bytes {
            Some(bytes) if *bytes == erased && offset.is_multiple_of(erased.len()) => {
                *bytes = word;
                Ok(())
            }
            _ => Err(FlashError),
        }
    }
}
