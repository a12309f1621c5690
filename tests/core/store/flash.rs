//! Model of a flash that loses power in the middle of an operation, and of two broken ones.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::store::{Area, Flash, FlashError, RamFlash, Word};

/// Planted fault of a flash.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    None,
    /// A word is reported as programmed, and is lost if the power fails in the next operation.
    WritesLate,
    /// A torn erasure clears the first word of the other area, too.
    DisturbsNeighbour,
}

/// Flash that loses power in the middle of an operation.
pub struct Mortal {
    pub cells: RamFlash<Vec<u8>>,
    /// Operations until the power cut.
    pub left: usize,
    pub done: usize,
    /// Operations that were torn: erasures, words of a header, words of a content.
    pub torn: [u64; 3],
    tear: ChaCha8Rng,
    fault: Fault,
    /// The last programmed word.
    last: Option<(Area, usize)>,
}

impl Mortal {
    pub fn new() -> Self {
        Self::with(Fault::None)
    }

    /// An erased flash with a planted fault.
    pub fn with(fault: Fault) -> Self {
        let cells = RamFlash::new(vec![0; RamFlash::SIZE]);
        let tear = ChaCha8Rng::seed_from_u64(0);
        Self { cells, left: usize::MAX, done: 0, torn: [0; 3], tear, fault, last: None }
    }

    /// The flash at the next power-up; the power fails again after `left` operations.
    pub fn revived(self, left: usize, seed: u64) -> Self {
        Self { left, done: 0, tear: ChaCha8Rng::seed_from_u64(seed), ..self }
    }

    /// Overwrites an area as no flash can.
    pub fn rewrite(&mut self, area: Area, change: impl FnOnce(&mut [u8])) {
        let mut bytes = self.cells.bytes(area).to_vec();
        change(&mut bytes);
        self.cells.erase(area).unwrap();
        for (i, word) in bytes.as_chunks::<8>().0.iter().enumerate() {
            if *word != [0xff; 8] {
                self.cells.program(area, 8 * i, *word).unwrap();
            }
        }
    }

    /// Counts an operation; returns how far it gets.
    fn operate(&mut self) -> Result<Progress, FlashError> {
        let last = self.last.take();
        let progress = match self.left {
            0 => return Err(FlashError),
            1 => Progress::Torn,
            _ => Progress::Whole,
        };
        self.left -= 1;
        self.done += 1;
        if let (Progress::Torn, Fault::WritesLate, Some((area, offset))) =
            (&progress, self.fault, last)
        {
            self.rewrite(area, |bytes| bytes[offset..offset + 8].fill(0xff));
        }
        Ok(progress)
    }
}

enum Progress {
    Whole,
    Torn,
}

/// The area that takes turns with `area`.
fn neighbour(area: Area) -> Area {
    match area {
        Area::SlotA => Area::SlotB,
        Area::SlotB => Area::SlotA,
        Area::PageA => Area::PageB,
        Area::PageB => Area::PageA,
    }
}

impl Flash for Mortal {
    fn bytes(&self, area: Area) -> &[u8] {
        self.cells.bytes(area)
    }

    fn erase(&mut self, area: Area) -> Result<(), FlashError> {
        match self.operate()? {
            Progress::Whole => self.cells.erase(area),
            Progress::Torn => {
                self.torn[0] += 1;
                let tear = &mut self.tear;
                let before = self.cells.bytes(area).to_vec();
                self.cells.erase(area)?;
                // Cells rise one by one: in each word none, some or all bits may have risen.
                for (i, word) in before.as_chunks::<8>().0.iter().enumerate() {
                    let risen = match tear.random_range(0..3) {
                        0 => 0,
                        1 => tear.random(),
                        _ => u64::MAX,
                    };
                    let word = u64::from_le_bytes(*word) | risen;
                    if word != u64::MAX {
                        self.cells.program(area, i * 8, word.to_le_bytes())?;
                    }
                }
                if self.fault == Fault::DisturbsNeighbour {
                    self.rewrite(neighbour(area), |bytes| bytes[..8].fill(0));
                }
                Err(FlashError)
            }
        }
    }

    fn program(&mut self, area: Area, offset: usize, word: Word) -> Result<(), FlashError> {
        match self.operate()? {
            Progress::Whole => {
                self.last = Some((area, offset));
                self.cells.program(area, offset, word)
            }
            Progress::Torn => {
                self.torn[if offset < 16 { 1 } else { 2 }] += 1;
                // Cells fall one by one.
                let standing: u64 = match self.tear.random_range(0..3) {
                    0 => 0,
                    1 => self.tear.random(),
                    _ => u64::MAX,
                };
                let torn = (u64::from_le_bytes(word) | standing).to_le_bytes();
                if torn != [0xff; 8] {
                    self.cells.program(area, offset, torn)?;
                }
                Err(FlashError)
            }
        }
    }
}
