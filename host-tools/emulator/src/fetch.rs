//! Waits of the core for a flash with wait states, behind the accelerator that ST calls ART.
//!
//! The flash delivers one word of 64 or 128 bits per read. A read takes the wait states and one
//! cycle more. Instructions wait for it unless they lie in the present word, in the instruction
//! cache, or in the word that was prefetched. A prefetch starts when the word before it arrives. It
//! hides the cycles that the core spends in that word. Constants wait unless they lie in the data
//! cache. Memories other than the flash have no waits.
//!
//! Every word read goes into its cache, and the line used least recently makes room. A line holds
//! the words that were read, not those beside them. Not modelled: fetches that the core makes ahead
//! of execution, and instructions and constants that ask for the flash at once.

use crate::block::Block;

/// Address of the flash on both chips, and in the bench machine.
pub const FLASH: u32 = 0x0800_0000;

/// Sizes of a flash and of its accelerator.
#[derive(Clone, Copy, Debug)]
pub struct Accelerator {
    /// Bytes of the flash.
    pub bytes: u32,
    /// Bytes of one read of the flash.
    pub word: u32,
    /// Words of a line of the caches.
    pub words: u32,
    /// Number of lines of the instruction cache and of the data cache.
    pub lines: [usize; 2],
}

/// Accelerator of the STM32G4: caches of 32 and 8 lines of 4 × 64 bits (RM0440 §3.3.4).
pub const G4: Accelerator = Accelerator { bytes: 1 << 20, word: 8, words: 4, lines: [32, 8] };

/// Accelerator of the STM32F411: caches of 64 and 8 lines of 128 bits (RM0383 §3.4.2).
pub const F4: Accelerator = Accelerator { bytes: 1 << 20, word: 16, words: 1, lines: [64, 8] };

/// Settings of the flash's access control register, whose bits are the same on both chips.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Settings {
    /// Wait states: LATENCY.
    pub wait_states: u64,
    /// Whether the next word is prefetched: PRFTEN.
    pub prefetch: bool,
    /// Whether the caches of instructions and of constants are on: ICEN, DCEN.
    pub caches: [bool; 2],
}

impl Settings {
    /// STM32G431 at 170 MHz: four wait states, and the whole accelerator on.
    pub const G431: Self = Self { wait_states: 4, prefetch: true, caches: [true; 2] };

    /// Settings in a value of `FLASH_ACR`.
    #[must_use]
    pub fn of(acr: u32) -> Self {
        let bit = |place: u32| acr >> place & 1 == 1;
        Self { wait_states: u64::from(acr & 0xf), prefetch: bit(8), caches: [bit(9), bit(10)] }
    }
}

/// Place of a line that is not in the cache.
const ABSENT: u8 = u8::MAX;

/// Line of a cache, linked to its neighbours in the order of use.
#[derive(Clone, Copy, Debug)]
struct Line {
    number: u32,
    /// Words that are present, one bit each.
    present: u8,
    /// Places of the lines used next after this one, and last before it.
    newer: u8,
    older: u8,
}

/// Cache with the least recently used line as the next to go.
#[derive(Debug)]
struct Cache {
    /// Words of a line, as a power of two.
    words: u32,
    lines: Vec<Line>,
    capacity: usize,
    /// Places of the lines used last and least recently.
    newest: u8,
    oldest: u8,
    /// Index into `lines` by number of the line.
    places: Vec<u8>,
}

impl Cache {
    fn new(shape: &Accelerator, capacity: usize) -> Self {
        let all = shape.bytes / shape.word / shape.words;
        Self {
            words: shape.words.ilog2(),
            lines: Vec::with_capacity(capacity),
            capacity,
            newest: ABSENT,
            oldest: ABSENT,
            places: vec![ABSENT; all as usize],
        }
    }

    fn clear(&mut self) {
        for line in self.lines.drain(..) {
            self.places[line.number as usize] = ABSENT;
        }
        (self.newest, self.oldest) = (ABSENT, ABSENT);
    }

    /// Reads a word: whether it was there. It is there afterwards.
    fn read(&mut self, word: u32) -> bool {
        let (number, bit) = (word >> self.words, 1 << (word & ((1 << self.words) - 1)));
        let place = self.places[number as usize];
        if place != ABSENT {
            if place != self.newest {
                self.take_out(place);
                self.put_first(place);
            }
            let line = &mut self.lines[usize::from(place)];
            let hit = line.present & bit != 0;
            line.present |= bit;
            return hit;
        }
        let new = Line { number, present: bit, newer: ABSENT, older: ABSENT };
        let place = if self.lines.len() < self.capacity {
            self.lines.push(new);
            self.lines.len() as u8 - 1
        } else {
            let place = self.oldest;
            self.take_out(place);
            let line = &mut self.lines[usize::from(place)];
            self.places[line.number as usize] = ABSENT;
            *line = new;
            place
        };
        self.places[number as usize] = place;
        self.put_first(place);
        false
    }

    fn take_out(&mut self, place: u8) {
        let Line { newer, older, .. } = self.lines[usize::from(place)];
        match self.lines.get_mut(usize::from(newer)) {
            Some(line) => line.older = older,
            None => self.newest = older,
        }
        match self.lines.get_mut(usize::from(older)) {
            Some(line) => line.newer = newer,
            None => self.oldest = newer,
        }
    }

    fn put_first(&mut self, place: u8) {
        let older = self.newest;
        match self.lines.get_mut(usize::from(older)) {
            Some(line) => line.newer = place,
            None => self.oldest = place,
        }
        self.newest = place;
        let line = &mut self.lines[usize::from(place)];
        (line.newer, line.older) = (ABSENT, older);
    }
}

/// Words of the flash that a block reads, by their numbers.
#[derive(Debug, Default)]
pub struct Reads {
    /// Words of instructions, with the cycle of the block in which each is needed.
    words: Vec<(u32, u64)>,
    /// Words of constants that the instructions load from an address beside them.
    constants: Vec<u32>,
}

/// Flash with its accelerator, as the core fetches from it.
#[derive(Debug)]
pub struct Fetch {
    shape: Accelerator,
    settings: Settings,
    /// Instruction cache and data cache.
    caches: [Cache; 2],
    /// Whether the settings stay, whatever a program writes.
    fixed: bool,
    /// Word that the core executes from, and the time of its arrival in cycles without waits.
    present: Option<(u32, u64)>,
}

impl Default for Fetch {
    /// Flash of an STM32G4 without wait states.
    fn default() -> Self {
        Self::new(G4, Settings::default())
    }
}

impl Fetch {
    /// Builds a flash with empty caches.
    #[must_use]
    pub fn new(shape: Accelerator, settings: Settings) -> Self {
        let caches = shape.lines.map(|lines| Cache::new(&shape, lines));
        Self { shape, settings, caches, fixed: false, present: None }
    }

    /// Reads of the flash that `block` makes.
    #[must_use]
    pub fn reads(&self, block: &Block) -> Reads {
        let Accelerator { bytes, word, .. } = self.shape;
        let word_of =
            |address: u32| address.checked_sub(FLASH).filter(|at| *at < bytes).map(|at| at / word);
        let mut reads = Reads::default();
        let (mut address, mut cycles) = (block.start, 0);
        for (i, instruction) in block.instructions.iter().enumerate() {
            for byte in [address, address + u32::from(instruction.size) - 1] {
                if let Some(word) = word_of(byte)
                    && reads.words.last().is_none_or(|(last, _)| *last != word)
                {
                    reads.words.push((word, cycles));
                }
            }
            let literal = instruction.literal.and_then(|offset| {
                let base = (address + 4) & !3;
                word_of(base.checked_add_signed(offset.into())?)
            });
            reads.constants.extend(literal);
            cycles += block.cost_of(i, false).high;
            address += u32::from(instruction.size);
        }
        reads
    }

    /// Applies the access control register; a cache that is off forgets its contents.
    pub fn set(&mut self, settings: Settings) {
        if self.fixed || settings == self.settings {
            return;
        }
        self.settings = settings;
        for (cache, on) in self.caches.iter_mut().zip(settings.caches) {
            if !on {
                cache.clear();
            }
        }
    }

    /// Applies settings that stay, whatever a program writes.
    pub fn fix(&mut self, settings: Settings) {
        self.fixed = false;
        self.set(settings);
        self.fixed = true;
    }

    /// Empties the caches.
    pub fn flush(&mut self) {
        self.caches.iter_mut().for_each(Cache::clear);
        self.present = None;
    }

    /// Cycles that the core waits for `reads` from `now` on, in cycles without waits.
    pub fn waits(&mut self, reads: &Reads, now: u64) -> u64 {
        if self.settings.wait_states == 0 {
            return 0;
        }
        let words = reads.words.iter().map(|(word, at)| (*word, now + at));
        let fetched: u64 = words.map(|(word, at)| self.fetch(word, at)).sum();
        fetched + reads.constants.iter().map(|word| self.load(*word)).sum::<u64>()
    }

    fn fetch(&mut self, word: u32, now: u64) -> u64 {
        let Settings { wait_states, prefetch, caches: [cached, _] } = self.settings;
        let before = self.present.replace((word, now));
        if let Some((same, since)) = before
            && same == word
        {
            self.present = Some((word, since));
            return 0;
        }
        if cached && self.caches[0].read(word) {
            return 0;
        }
        match before {
            Some((before, since)) if prefetch && before + 1 == word => {
                (wait_states + 1).saturating_sub(now - since)
            }
            _ => wait_states,
        }
    }

    fn load(&mut self, word: u32) -> u64 {
        let Settings { wait_states, caches: [_, cached], .. } = self.settings;
        let hit = cached && self.caches[1].read(word);
        if hit { 0 } else { wait_states }
    }
}
