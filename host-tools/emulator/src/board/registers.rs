//! Bits of the chips' registers, from a table that the firmware's register access is not made from.
//!
//! `cargo xtask registers` writes the table from the manufacturer's SVD files.

use std::collections::HashMap;

/// Table of the chips: board, address, names, reset value, bits of fields, writable bits.
const TABLE: &str = include_str!("../../data/registers.csv");

/// Ends of the names of registers of flags, which are cleared by writing ones or zeros to all bits.
const FLAGS: [&str; 5] = [".SR", ".ISR", ".ISTR", ".GINTSTS", ".INT"];

/// Reserved bits that the firmware sets: board, register and bits.
///
/// embassy-usb-synopsys-otg 0.3.3 writes the packets per frame (MCNT) for endpoint 0 too, which has
/// no such field.
const KNOWN: [(&str, &str, u32); 1] = [("stm32f411", "DIEP0.TSIZ", 1 << 29)];

/// Bits that may be set of registers whose model stores bits without their effect.
///
/// Board or `*`, end of the register's name, and bits: those with a model, and those that the
/// firmware sets although they have none. Any other bit stops the machine. Registers that are not
/// named here have models that check their bits themselves.
const MODELLED: &[(&str, &str, u32)] = &[
    // UIE and CCxIE: no stream serves TIM2.
    ("*", "TIM2.DIER", 0x1f),
    // Sampling times of the converted inputs, and their places in the sequences
    ("stm32g431", "ADC1.SMPR1", 0x7fff & !7),
    ("stm32g431", "ADC1.SMPR2", 7 << 24 | 7 << 18),
    ("stm32g431", "ADC1.SQR2", 0),
    ("stm32g431", "ADC1.JSQR", 0x1f_ffff),
    ("stm32g431", "ADC2.SMPR1", 0),
    ("stm32g431", "ADC2.SMPR2", 7 << 24 | 7 << 18 | 7 << 9),
    ("stm32g431", "ADC2.SQR2", 0x1f),
    ("stm32g431", "ADC2.JSQR", 0),
    // Flags that the model sets: ADRDY, EOC, EOS, OVR, JEOC, JEOS
    ("stm32g431", "ADC1.IER", 0x7d),
    ("stm32g431", "ADC2.IER", 0x7d),
    ("stm32f411", "ADC1.SMPR1", 0x7e0_0000),
    ("stm32f411", "ADC1.SMPR2", 0x7ff_fff8),
    ("stm32f411", "ADC1.SQR1", 0xf << 20),
    ("stm32f411", "ADC1.SQR2", 0x3ff),
    ("stm32f411", "ADC1.JSQR", 0x3f_fc00),
    ("stm32f411", "ADC_COMMON.CCR", 0x83_0000),
    // Speeds have no effect: the pins of the USB and of the probe. Alternate functions of the
    // former.
    ("stm32f411", "GPIOA.OSPEEDR", 0x0fc0_0000),
    ("stm32f411", "GPIOA.AFRH", 0xf_f000),
    // MMS and MMS2; OCxPE and OCxM; MOE
    ("*", "TIM1.CR2", 0xf0_0070),
    ("*", "CCMR1_OUTPUT", 0x0101_7878),
    ("*", "CCMR2_OUTPUT", 0x0101_7878),
    ("*", "CCMR3_OUTPUT", 0x0101_7878),
    ("*", "TIM1.BDTR", 1 << 15),
    // CCxE, without complementary outputs and polarities
    ("*", "TIM1.CCER", 0x11_1111),
    // CCxIE and CCxDE: the timer's other interrupts have lines of their own.
    ("*", "TIM1.DIER", 0x1e1e),
    // Only the frozen part of an address of 16 bits: no dither.
    ("stm32g431", "TIM1.ARR", 0xffff),
    ("stm32g431", "TIM1.CCR1", 0xffff),
    ("stm32g431", "TIM1.CCR2", 0xffff),
    ("stm32g431", "TIM1.CCR3", 0xffff),
    ("stm32g431", "TIM1.CCR6", 0xffff),
    // OPAEN, VP_SEL, VM_SEL, OPAINTOEN, PGA_GAIN; VPS_SEL and T1CM_EN
    ("stm32g431", "OPAMP2_CSR", 0x7_c16d),
    ("stm32g431", "OPAMP3_CSR", 0x7_c16d),
    ("stm32g431", "OPAMP2_TCMR", 0xe),
    ("stm32g431", "OPAMP3_TCMR", 0xe),
    // VOS and DBP; EIWUL and UCPD1_DBDIS
    ("stm32g431", "PWR.CR1", 0x700),
    ("stm32g431", "PWR.CR3", 0xc000),
    // CEN, AUTOTRIMEN, TRIM
    ("stm32g431", "CRS.CR", 0x7f60),
    ("stm32g431", "USB.CNTR", 0x9c0f),
    // SW, HPRE, PPRE: no MCO. HSION, PLLON. PLLSRC, M, N, R.
    ("stm32g431", "RCC.CFGR", 0x3fff),
    ("stm32g431", "RCC.CR", 0x0301_0500),
    ("stm32g431", "RCC.PLLCFGR", 0x0700_7ff3),
    // CLK48SEL; RTCEN, RTCSEL, BDRST; LSION, RMVF and the flags
    ("stm32g431", "RCC.CCIPR", 3 << 26),
    ("stm32g431", "RCC.BDCR", 0x1_8300),
    ("stm32g431", "FLASH.ACR", 0x1f0f),
    ("stm32g431", "DBGMCU.CR", 7),
    ("stm32g431", "DBGMCU.APB1L_FZ", 1 << 12 | 1),
    ("stm32g431", "DBGMCU.APB1H_FZ", 0),
    ("stm32g431", "DBGMCU.APB2_FZ", 1 << 11),
    // No transfer errors.
    ("stm32g431", "CH1.CR", 0x7ff7),
    ("stm32g431", "CH2.CR", 0x7ff7),
    ("stm32g431", "CH3.CR", 0x7ff7),
    // SW, HPRE, PPRE1, PPRE2; HSION, HSEON, PLLON and HSITRIM's reset value
    ("stm32f411", "RCC.CFGR", 0xfcff),
    ("stm32f411", "RCC.CR", 0x0303_ff83),
    ("stm32f411", "RCC.DCKCFGR", 0),
    ("stm32f411", "DBGMCU.CR", 7),
    ("stm32f411", "DBGMCU.APB1_FZ", 1 << 12 | 1),
    ("stm32f411", "DBGMCU.APB2_FZ", 1),
    // TXFELVL is for slaves of a DMA; FDMOD, TRDT, PHYSEL
    ("stm32f411", "GLOBAL.GAHBCFG", 1),
    ("stm32f411", "GLOBAL.GUSBCFG", 0x4000_3c40),
    // WUIM, SRQIM, OEPINT, IEPINT, ENUMDNEM, USBRST, USBSUSPM, RXFLVLM, OTGINT
    ("stm32f411", "GLOBAL.GINTMSK", 0xc00c_3814),
    // DSPD, DAD; XFRCM; XFRCM and STUPM; the endpoints that there are
    ("stm32f411", "DEVICE.DCFG", 0x7f3),
    ("stm32f411", "DEVICE.DIEPMSK", 1),
    ("stm32f411", "DEVICE.DOEPMSK", 1 << 3 | 1),
    ("stm32f411", "DEVICE.DAINTMSK", 0xf_000f),
];

/// Board whose chip's models serve this one too: its bits in [`MODELLED`] hold for both.
fn modelled_as(board: &str) -> &str {
    match board {
        "stm32g473" => "stm32g431",
        other => other,
    }
}

/// Register in the table.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Names of the register; several share an address.
    pub names: &'static str,
    /// Value after a reset.
    pub reset: u32,
    /// Bits of all fields; the others are reserved.
    pub fields: u32,
    /// Bits that can be written.
    pub writable: u32,
    /// Bits that may be set.
    pub modelled: u32,
}

impl Row {
    /// Reserved bits that a write of `value` changes, against zero and the reset value.
    pub fn reserved_in(&self, value: u32) -> u32 {
        if FLAGS.iter().any(|end| self.names.ends_with(end)) {
            return 0;
        }
        value & (value ^ self.reset) & !self.fields
    }

    /// Bits without a model that a write of `value` sets, against the reset value.
    pub fn unmodelled_in(&self, value: u32) -> u32 {
        value & (value ^ self.reset) & !self.modelled
    }
}

/// Registers of a board's chip by address.
pub fn of(board: &str) -> HashMap<u32, Row> {
    let row = |line: &'static str| {
        let cells: Vec<&str> = line.split(',').collect();
        let [its, address, names, reset, fields, writable] = cells[..] else { return None };
        if its != board {
            return None;
        }
        let hex = |text: &str| u32::from_str_radix(text.strip_prefix("0x")?, 16).ok();
        let [address, reset, fields, writable] =
            [hex(address)?, hex(reset)?, hex(fields)?, hex(writable)?];
        let known = |(on, end, _): &&(&str, &str, u32)| *on == its && names.ends_with(end);
        let allowed: u32 = KNOWN.iter().filter(known).map(|(.., bits)| bits).sum();
        let fields = fields | allowed;
        let named = |(on, end, _): &&(&str, &str, u32)| {
            let ends = |name: &str| {
                name.ends_with(end)
                    && !name[..name.len() - end.len()].ends_with(char::is_alphanumeric)
            };
            ["*", modelled_as(board)].contains(on) && names.split(' ').any(ends)
        };
        let modelled = MODELLED.iter().find(named).map_or(u32::MAX, |(.., bits)| *bits);
        Some((address, Row { names, reset, fields, writable, modelled }))
    };
    TABLE.lines().filter_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reserved_bits_are_those_of_no_field() {
        let registers = of("stm32g431");
        let cr5 = registers[&0x4000_7080];
        assert_eq!((cr5.names, cr5.reset, cr5.fields), ("PWR.CR5", 1 << 8, 1 << 8));
        assert_eq!([0, 1, 1 << 8].map(|value| cr5.reserved_in(value)), [0, 1, 0]);
        assert!(registers.len() > 300 && of("stm32f411").len() > 250);
        // BKER, of a flash with two banks
        let flash =
            ["stm32g431", "stm32g473"].map(|board| of(board)[&0x4002_2014].fields >> 11 & 1);
        assert_eq!(flash, [0, 1]);
    }
}
