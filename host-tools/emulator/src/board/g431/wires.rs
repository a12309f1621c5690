//! Fixed wires of the chip: clock enable and reset bits, and pins of inputs.

use stm32_metapac::metadata::PeripheralRccRegister;

use super::names::{field, peripheral};

/// Bit of a register of RCC.
#[derive(Clone, Debug)]
pub struct Bit {
    /// Offset of the register.
    pub register: u32,
    /// Number of the bit.
    pub place: u32,
    /// Readable name.
    pub name: String,
}

impl Bit {
    fn new(of: &PeripheralRccRegister) -> Self {
        let (register, place) = field("RCC", of.register, of.field);
        Self { register, place, name: format!("{}.{}", of.register, of.field) }
    }
}

/// Clock enable and reset bits of a peripheral, if they exist.
pub fn bits(name: &str) -> [Option<Bit>; 2] {
    match &peripheral(name).rcc {
        Some(rcc) => [&rcc.enable, &rcc.reset].map(|bit| bit.as_ref().map(Bit::new)),
        None => [None, None],
    }
}

/// Pin of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pad {
    /// Name of the pin.
    pub name: &'static str,
    /// Port: 0 is A.
    pub port: usize,
    /// Number in the port.
    pub number: u32,
}

/// Pins of a peripheral's signals `prefix` + number, by that number.
pub fn pads(of: &str, prefix: &str, count: usize) -> Vec<Option<Pad>> {
    let pin = |number: usize| {
        let signal = format!("{prefix}{number}");
        let name = peripheral(of).pins.iter().find(|pin| pin.signal == signal)?.pin;
        let port = usize::from(name.as_bytes().get(1)?.checked_sub(b'A')?);
        Some(Pad { name, port, number: name.get(2..)?.parse().ok()? })
    };
    (0..count).map(pin).collect()
}
