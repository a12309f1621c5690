//! Tests of the peripherals' models by the reference manuals' sequences, without a firmware.
//!
//! Addresses, bits and times are typed from RM0440 and DS12589 (STM32G431), RM0383 and DS10314
//! (STM32F411), not taken from the models.

mod adc_f411;
mod adc_g431;
mod clocks;
mod dma;
mod flash;
mod timer;

use taxel::scan::{Codes, Midpoints, TaxelCodes};
use taxel::units::{Code, FullScale};
use taxel_emulator::board::Outcome;
use taxel_emulator::board::chip::{Cause, Chip, Memory};
use taxel_emulator::board::finger::{Finger, Pace};
use taxel_emulator::board::host::Host;
use taxel_emulator::board::model::Model;
use taxel_emulator::board::time::{Tick, micros};

/// First address of the RAM on both chips.
pub const RAM: u32 = 0x2000_0000;

/// Dark codes of the columns that [`Driver`]'s finger shows.
pub const DARK: [u16; 4] = [100, 200, 300, 400];

/// RAM that the DMA transfers to and from.
struct Bytes([u8; 256]);

impl Bytes {
    fn at(&mut self, address: u32, size: u32) -> Outcome<&mut [u8]> {
        let from = address.wrapping_sub(RAM) as usize;
        self.0.get_mut(from..from + size as usize).ok_or_else(|| format!("no RAM at {address:#x}"))
    }
}

impl Memory for Bytes {
    fn read(&mut self, address: u32, size: u32) -> Outcome<u32> {
        let bytes = self.at(address, size)?;
        Ok(bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    fn write(&mut self, address: u32, size: u32, value: u32) -> Outcome {
        let bytes = self.at(address, size)?;
        bytes.iter_mut().zip(value.to_le_bytes()).for_each(|(to, from)| *to = from);
        Ok(())
    }
}

/// Chip with a driver that writes and reads registers.
pub struct Driver {
    pub chip: Box<dyn Chip>,
    pub now: Tick,
    ram: Bytes,
}

impl Driver {
    /// Chip just powered, without an image, with a finger that shows one scan.
    pub fn new(model: Model) -> Self {
        let codes = Codes {
            full_scale: FullScale::BITS_12,
            taxels: Some(TaxelCodes { lit: [[Code(4000); 4]; 4], dark: DARK.map(Code) }),
            bridges: [Some(Midpoints {
                a: Code(1000),
                b: Code(1100),
                c: Code(1200),
                d: Code(1300),
            }); 4],
            temperature: Some(Code(943)),
            reference: Some(Code(1504)),
        };
        let finger = Finger::new(vec![codes], Pace::Scans);
        Self { chip: model.chip(finger, Host::new(false)), now: 0, ram: Bytes([0; 256]) }
    }

    /// Writes a word.
    pub fn write(&mut self, address: u32, value: u32) {
        self.chip.write(address, 4, value, (self.now, 0)).unwrap();
    }

    /// Writes a word and returns the reason why the model refuses it.
    pub fn refused(&mut self, address: u32, value: u32) -> String {
        self.chip.write(address, 4, value, (self.now, 0)).unwrap_err()
    }

    /// Reads a word.
    pub fn read(&mut self, address: u32) -> u32 {
        self.chip.read(address, 4, (self.now, 0)).unwrap()
    }

    /// Sets bits and reads the register back, as after a clock enable.
    pub fn set(&mut self, address: u32, bits: u32) {
        let value = self.read(address) | bits;
        self.write(address, value);
        assert_eq!(self.read(address) & bits, bits);
    }

    /// Lets time pass.
    pub fn wait(&mut self, time: Tick) {
        self.wait_or_stop(time).unwrap();
    }

    /// Lets time pass; the reason if an event stops the machine.
    pub fn wait_or_stop(&mut self, time: Tick) -> Outcome {
        self.now += time;
        self.chip.advance(self.now, &mut self.ram)
    }

    /// Waits until all `bits` of a register are as in `value`; returns the time that it took.
    pub fn wait_for(&mut self, address: u32, bits: u32, value: u32) -> Tick {
        let begin = self.now;
        while self.read(address) & bits != value {
            self.wait(micros(1) / 16);
            assert!(self.now - begin < micros(10_000), "{address:#x} & {bits:#x} != {value:#x}");
        }
        self.now - begin
    }

    /// Resets the chip by its program.
    pub fn reset(&mut self) {
        self.chip.reset(Cause::Software, self.now);
    }

    /// Half word of the RAM.
    pub fn half(&mut self, address: u32) -> u32 {
        self.ram.read(address, 2).unwrap()
    }

    /// Fills the RAM with words from its start on.
    pub fn fill(&mut self, words: &[u32]) {
        for (address, word) in (RAM..).step_by(4).zip(words) {
            self.ram.write(address, 4, *word).unwrap();
        }
    }
}
