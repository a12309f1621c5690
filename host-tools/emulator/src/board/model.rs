//! Boards that the emulator can run.

use clap::ValueEnum;

use super::chip::Chip;
use super::f411::F411;
use super::finger::Finger;
use super::g431::G431;
use super::host::Host;

/// Board, named as in `boards/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Model {
    /// Product board.
    #[value(name = "stm32g431")]
    G431,
    /// Product board with the chip's sibling that has more memory.
    #[value(name = "stm32g473")]
    G473,
    /// Black Pill board.
    #[value(name = "stm32f411")]
    F411,
}

impl Model {
    /// Chip of the board, just powered.
    pub fn chip(self, finger: Finger, host: Host) -> Box<dyn Chip> {
        match self {
            Self::G431 => Box::new(G431::new(finger, host)),
            Self::G473 => Box::new(G431::g473(finger, host)),
            Self::F411 => Box::new(F411::new(finger, host)),
        }
    }
}
