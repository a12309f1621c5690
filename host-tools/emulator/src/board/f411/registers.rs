//! Addresses and clocks of the STM32F411's peripherals, and names of their registers.
//!
//! Addresses and clocks are written down from the reference manual (RM0383 tables 1 and 37), names
//! come from the manufacturer's SVD file. The firmware's register access is generated from another
//! source, so that a mistake in either shows.

use crate::board::registers::Row;

/// Peripheral with its address and clock.
pub struct Peripheral {
    /// Name in the manual.
    pub name: &'static str,
    /// First address.
    pub base: u32,
    /// Size in bytes.
    pub bytes: u32,
    /// Clock enable: offset of the register in RCC, and bit. The reset bit is the same, 0x20 below.
    pub clock: Option<(u32, u32)>,
}

/// Offsets of RCC's clock enable registers.
const AHB1: u32 = 0x30;
const AHB2: u32 = 0x34;
const APB1: u32 = 0x40;
const APB2: u32 = 0x44;

const fn at(name: &'static str, base: u32, bytes: u32, clock: Option<(u32, u32)>) -> Peripheral {
    Peripheral { name, base, bytes, clock }
}

/// Peripherals in order of address.
pub const PERIPHERALS: [Peripheral; 21] = [
    at("TIM2", 0x4000_0000, 0x400, Some((APB1, 0))),
    at("IWDG", 0x4000_3000, 0x400, None),
    at("PWR", 0x4000_7000, 0x400, Some((APB1, 28))),
    at("TIM1", 0x4001_0000, 0x400, Some((APB2, 0))),
    at("ADC1", 0x4001_2000, 0x300, Some((APB2, 8))),
    at("ADC_common", 0x4001_2300, 0x100, Some((APB2, 8))),
    at("SYSCFG", 0x4001_3800, 0x400, Some((APB2, 14))),
    at("EXTI", 0x4001_3c00, 0x400, None),
    at("GPIOA", 0x4002_0000, 0x400, Some((AHB1, 0))),
    at("GPIOB", 0x4002_0400, 0x400, Some((AHB1, 1))),
    at("GPIOC", 0x4002_0800, 0x400, Some((AHB1, 2))),
    at("GPIOD", 0x4002_0c00, 0x400, Some((AHB1, 3))),
    at("GPIOE", 0x4002_1000, 0x400, Some((AHB1, 4))),
    at("GPIOH", 0x4002_1c00, 0x400, Some((AHB1, 7))),
    at("CRC", 0x4002_3000, 0x400, Some((AHB1, 12))),
    at("RCC", 0x4002_3800, 0x400, None),
    at("FLASH", 0x4002_3c00, 0x400, None),
    at("DMA1", 0x4002_6000, 0x400, Some((AHB1, 21))),
    at("DMA2", 0x4002_6400, 0x400, Some((AHB1, 22))),
    at("OTG_FS", 0x5000_0000, 0x4_0000, Some((AHB2, 7))),
    at("DBGMCU", 0xe004_2000, 0x400, None),
];

/// Peripheral at an address.
pub fn peripheral(address: u32) -> Option<&'static Peripheral> {
    PERIPHERALS.iter().find(|its| (its.base..its.base + its.bytes).contains(&address))
}

/// First address of a peripheral.
///
/// # Panics
/// If there is no peripheral of that name, which is a mistake of this program.
pub fn base(name: &str) -> u32 {
    let found = PERIPHERALS.iter().find(|its| its.name == name);
    found.unwrap_or_else(|| panic!("the STM32F411 has no peripheral {name}")).base
}

/// Readable name of a register, of which `row` is the description.
pub fn name(address: u32, row: Option<&Row>) -> String {
    let Some(Peripheral { name, base, .. }) = peripheral(address) else {
        return format!("{address:#010x}");
    };
    // The last one of registers that share an address is an output's or a device's.
    match row.and_then(|row| row.names.rsplit(' ').next()?.split_once('.')) {
        Some((_, register)) => format!("{name}.{register} ({address:#010x})"),
        None => format!("{name} + {:#x} ({address:#010x})", address - base),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::registers::of;

    #[test]
    fn peripherals_are_sorted() {
        assert!(PERIPHERALS.windows(2).all(|pair| pair[0].base + pair[0].bytes <= pair[1].base));
    }

    #[test]
    fn registers_have_the_names_of_the_description() {
        let rows = of("stm32f411");
        let name = |address| name(address, rows.get(&address));
        assert_eq!(name(0x4002_3874), "RCC.CSR (0x40023874)");
        assert_eq!(name(0x4001_0018), "TIM1.CCMR1_OUTPUT (0x40010018)");
        assert_eq!(name(0x5000_0910), "OTG_FS.DIEP0.TSIZ (0x50000910)");
        assert_eq!(name(0x4001_2050), "ADC1 + 0x50 (0x40012050)");
    }
}
