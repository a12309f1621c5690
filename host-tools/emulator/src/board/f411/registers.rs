//! Addresses and names of the STM32F411's peripherals and registers.
//!
//! They are written down from the reference manual (RM0383 tables 1, 37 and each chapter's map).
//! The firmware's register access is generated from another source, so that a mistake in either
//! shows.

/// Peripheral with its address, clock and registers.
pub struct Peripheral {
    /// Name in the manual.
    pub name: &'static str,
    /// First address.
    pub base: u32,
    /// Size in bytes.
    pub bytes: u32,
    /// Clock enable: offset of the register in RCC, and bit. The reset bit is the same, 0x20 below.
    pub clock: Option<(u32, u32)>,
    /// Registers with their offsets.
    pub registers: &'static [(u32, &'static str)],
}

/// Offsets of RCC's clock enable registers.
const AHB1: u32 = 0x30;
const AHB2: u32 = 0x34;
const APB1: u32 = 0x40;
const APB2: u32 = 0x44;

const GPIO: &[(u32, &str)] = &[
    (0x00, "MODER"),
    (0x04, "OTYPER"),
    (0x08, "OSPEEDR"),
    (0x0c, "PUPDR"),
    (0x10, "IDR"),
    (0x14, "ODR"),
    (0x18, "BSRR"),
    (0x1c, "LCKR"),
    (0x20, "AFRL"),
    (0x24, "AFRH"),
];

const TIM: &[(u32, &str)] = &[
    (0x00, "CR1"),
    (0x04, "CR2"),
    (0x08, "SMCR"),
    (0x0c, "DIER"),
    (0x10, "SR"),
    (0x14, "EGR"),
    (0x18, "CCMR1"),
    (0x1c, "CCMR2"),
    (0x20, "CCER"),
    (0x24, "CNT"),
    (0x28, "PSC"),
    (0x2c, "ARR"),
    (0x30, "RCR"),
    (0x34, "CCR1"),
    (0x38, "CCR2"),
    (0x3c, "CCR3"),
    (0x40, "CCR4"),
    (0x44, "BDTR"),
    (0x48, "DCR"),
    (0x4c, "DMAR"),
    (0x50, "OR"),
];

const fn port(name: &'static str, place: u32) -> Peripheral {
    let base = 0x4002_0000 + 0x400 * place;
    Peripheral { name, base, bytes: 0x400, clock: Some((AHB1, place)), registers: GPIO }
}

/// Peripherals in order of address.
pub const PERIPHERALS: [Peripheral; 21] = [
    Peripheral {
        name: "TIM2",
        base: 0x4000_0000,
        bytes: 0x400,
        clock: Some((APB1, 0)),
        registers: TIM,
    },
    Peripheral {
        name: "IWDG",
        base: 0x4000_3000,
        bytes: 0x400,
        clock: None,
        registers: &[(0x00, "KR"), (0x04, "PR"), (0x08, "RLR"), (0x0c, "SR")],
    },
    Peripheral {
        name: "PWR",
        base: 0x4000_7000,
        bytes: 0x400,
        clock: Some((APB1, 28)),
        registers: &[(0x00, "CR"), (0x04, "CSR")],
    },
    Peripheral {
        name: "TIM1",
        base: 0x4001_0000,
        bytes: 0x400,
        clock: Some((APB2, 0)),
        registers: TIM,
    },
    Peripheral {
        name: "ADC1",
        base: 0x4001_2000,
        bytes: 0x300,
        clock: Some((APB2, 8)),
        registers: &[
            (0x00, "SR"),
            (0x04, "CR1"),
            (0x08, "CR2"),
            (0x0c, "SMPR1"),
            (0x10, "SMPR2"),
            (0x14, "JOFR1"),
            (0x18, "JOFR2"),
            (0x1c, "JOFR3"),
            (0x20, "JOFR4"),
            (0x24, "HTR"),
            (0x28, "LTR"),
            (0x2c, "SQR1"),
            (0x30, "SQR2"),
            (0x34, "SQR3"),
            (0x38, "JSQR"),
            (0x3c, "JDR1"),
            (0x40, "JDR2"),
            (0x44, "JDR3"),
            (0x48, "JDR4"),
            (0x4c, "DR"),
        ],
    },
    Peripheral {
        name: "ADC_common",
        base: 0x4001_2300,
        bytes: 0x100,
        clock: Some((APB2, 8)),
        registers: &[(0x00, "CSR"), (0x04, "CCR")],
    },
    Peripheral {
        name: "SYSCFG",
        base: 0x4001_3800,
        bytes: 0x400,
        clock: Some((APB2, 14)),
        registers: &[
            (0x00, "MEMRMP"),
            (0x04, "PMC"),
            (0x08, "EXTICR1"),
            (0x0c, "EXTICR2"),
            (0x10, "EXTICR3"),
            (0x14, "EXTICR4"),
            (0x20, "CMPCR"),
        ],
    },
    Peripheral {
        name: "EXTI",
        base: 0x4001_3c00,
        bytes: 0x400,
        clock: None,
        registers: &[
            (0x00, "IMR"),
            (0x04, "EMR"),
            (0x08, "RTSR"),
            (0x0c, "FTSR"),
            (0x10, "SWIER"),
            (0x14, "PR"),
        ],
    },
    port("GPIOA", 0),
    port("GPIOB", 1),
    port("GPIOC", 2),
    port("GPIOD", 3),
    port("GPIOE", 4),
    port("GPIOH", 7),
    Peripheral {
        name: "CRC",
        base: 0x4002_3000,
        bytes: 0x400,
        clock: Some((AHB1, 12)),
        registers: &[(0x00, "DR"), (0x04, "IDR"), (0x08, "CR")],
    },
    Peripheral {
        name: "RCC",
        base: 0x4002_3800,
        bytes: 0x400,
        clock: None,
        registers: &[
            (0x00, "CR"),
            (0x04, "PLLCFGR"),
            (0x08, "CFGR"),
            (0x0c, "CIR"),
            (0x10, "AHB1RSTR"),
            (0x14, "AHB2RSTR"),
            (0x20, "APB1RSTR"),
            (0x24, "APB2RSTR"),
            (0x30, "AHB1ENR"),
            (0x34, "AHB2ENR"),
            (0x40, "APB1ENR"),
            (0x44, "APB2ENR"),
            (0x50, "AHB1LPENR"),
            (0x54, "AHB2LPENR"),
            (0x60, "APB1LPENR"),
            (0x64, "APB2LPENR"),
            (0x70, "BDCR"),
            (0x74, "CSR"),
            (0x80, "SSCGR"),
            (0x84, "PLLI2SCFGR"),
            (0x8c, "DCKCFGR"),
        ],
    },
    Peripheral {
        name: "FLASH",
        base: 0x4002_3c00,
        bytes: 0x400,
        clock: None,
        registers: &[
            (0x00, "ACR"),
            (0x04, "KEYR"),
            (0x08, "OPTKEYR"),
            (0x0c, "SR"),
            (0x10, "CR"),
            (0x14, "OPTCR"),
        ],
    },
    Peripheral {
        name: "DMA1",
        base: 0x4002_6000,
        bytes: 0x400,
        clock: Some((AHB1, 21)),
        registers: &[],
    },
    Peripheral {
        name: "DMA2",
        base: 0x4002_6400,
        bytes: 0x400,
        clock: Some((AHB1, 22)),
        registers: &[
            (0x00, "LISR"),
            (0x04, "HISR"),
            (0x08, "LIFCR"),
            (0x0c, "HIFCR"),
            (0x10, "S0CR"),
            (0x14, "S0NDTR"),
            (0x18, "S0PAR"),
            (0x1c, "S0M0AR"),
            (0x20, "S0M1AR"),
            (0x24, "S0FCR"),
            (0x28, "S1CR"),
            (0x2c, "S1NDTR"),
            (0x30, "S1PAR"),
            (0x34, "S1M0AR"),
            (0x38, "S1M1AR"),
            (0x3c, "S1FCR"),
        ],
    },
    Peripheral {
        name: "OTG_FS",
        base: 0x5000_0000,
        bytes: 0x4_0000,
        clock: Some((AHB2, 7)),
        registers: &[
            (0x000, "GOTGCTL"),
            (0x004, "GOTGINT"),
            (0x008, "GAHBCFG"),
            (0x00c, "GUSBCFG"),
            (0x010, "GRSTCTL"),
            (0x014, "GINTSTS"),
            (0x018, "GINTMSK"),
            (0x01c, "GRXSTSR"),
            (0x020, "GRXSTSP"),
            (0x024, "GRXFSIZ"),
            (0x028, "DIEPTXF0"),
            (0x02c, "HNPTXSTS"),
            (0x038, "GCCFG"),
            (0x03c, "CID"),
            (0x100, "HPTXFSIZ"),
            (0x104, "DIEPTXF1"),
            (0x108, "DIEPTXF2"),
            (0x10c, "DIEPTXF3"),
            (0x800, "DCFG"),
            (0x804, "DCTL"),
            (0x808, "DSTS"),
            (0x810, "DIEPMSK"),
            (0x814, "DOEPMSK"),
            (0x818, "DAINT"),
            (0x81c, "DAINTMSK"),
            (0x828, "DVBUSDIS"),
            (0x82c, "DVBUSPULSE"),
            (0x834, "DIEPEMPMSK"),
            (0x900, "DIEPCTL0"),
            (0x908, "DIEPINT0"),
            (0x910, "DIEPTSIZ0"),
            (0x918, "DTXFSTS0"),
            (0x920, "DIEPCTL1"),
            (0x928, "DIEPINT1"),
            (0x930, "DIEPTSIZ1"),
            (0x938, "DTXFSTS1"),
            (0x940, "DIEPCTL2"),
            (0x948, "DIEPINT2"),
            (0x950, "DIEPTSIZ2"),
            (0x958, "DTXFSTS2"),
            (0x960, "DIEPCTL3"),
            (0x968, "DIEPINT3"),
            (0x970, "DIEPTSIZ3"),
            (0x978, "DTXFSTS3"),
            (0xb00, "DOEPCTL0"),
            (0xb08, "DOEPINT0"),
            (0xb10, "DOEPTSIZ0"),
            (0xb20, "DOEPCTL1"),
            (0xb28, "DOEPINT1"),
            (0xb30, "DOEPTSIZ1"),
            (0xb40, "DOEPCTL2"),
            (0xb48, "DOEPINT2"),
            (0xb50, "DOEPTSIZ2"),
            (0xb60, "DOEPCTL3"),
            (0xb68, "DOEPINT3"),
            (0xb70, "DOEPTSIZ3"),
            (0xe00, "PCGCCTL"),
        ],
    },
    Peripheral {
        name: "DBGMCU",
        base: 0xe004_2000,
        bytes: 0x400,
        clock: None,
        registers: &[(0x00, "IDCODE"), (0x04, "CR"), (0x08, "APB1_FZ"), (0x0c, "APB2_FZ")],
    },
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

/// Readable name of a register.
pub fn name(address: u32) -> String {
    let Some(Peripheral { name, base, registers, .. }) = peripheral(address) else {
        return format!("{address:#010x}");
    };
    let offset = address - base;
    match registers.iter().find(|(at, _)| *at == offset & !3) {
        Some((_, register)) => format!("{name}.{register} ({address:#010x})"),
        None => format!("{name} + {offset:#x} ({address:#010x})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peripherals_and_registers_are_sorted() {
        assert!(PERIPHERALS.windows(2).all(|pair| pair[0].base + pair[0].bytes <= pair[1].base));
        for peripheral in &PERIPHERALS {
            let offsets = peripheral.registers.windows(2);
            assert!(offsets.into_iter().all(|pair| pair[0].0 < pair[1].0), "{}", peripheral.name);
        }
        assert_eq!(name(0x4002_3874), "RCC.CSR (0x40023874)");
        assert_eq!(name(0x4001_2050), "ADC1 + 0x50 (0x40012050)");
    }
}
