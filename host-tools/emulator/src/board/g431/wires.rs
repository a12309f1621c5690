//! The chip's fixed wires, looked up once: which bits switch a peripheral's clock on and reset it, which
//! pins are which inputs.

use stm32_metapac::metadata::PeripheralRccRegister;

use super::names::{field, peripheral};

/// A bit of RCC.
#[derive(Clone, Debug)]
pub struct Bit {
    /// Its register's offset.
    pub register: u32,
    /// Its place.
    pub place: u32,
    /// For people.
    pub name: String,
}

impl Bit {
    fn new(of: &PeripheralRccRegister) -> Self {
        let (register, place) = field("RCC", of.register, of.field);
        Self { register, place, name: format!("{}.{}", of.register, of.field) }
    }
}

/// The bits that switch a peripheral's clock on and that reset it, where there are such.
pub fn bits(name: &str) -> [Option<Bit>; 2] {
    match &peripheral(name).rcc {
        Some(rcc) => [&rcc.enable, &rcc.reset].map(|bit| bit.as_ref().map(Bit::new)),
        None => [None, None],
    }
}

/// A pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pad {
    /// As it is called.
    pub name: &'static str,
    /// Its port: 0 is A.
    pub port: usize,
    /// Its number there.
    pub number: u32,
}

/// The pins of a peripheral's signals whose names are `prefix` and a number, by that number.
pub fn pads(of: &str, prefix: &str, count: usize) -> Vec<Option<Pad>> {
    let pin = |number: usize| {
        let signal = format!("{prefix}{number}");
        let name = peripheral(of).pins.iter().find(|pin| pin.signal == signal)?.pin;
        let port = usize::from(name.as_bytes().get(1)?.checked_sub(b'A')?);
        Some(Pad { name, port, number: name.get(2..)?.parse().ok()? })
    };
    (0..count).map(pin).collect()
}
