//! The ADC (RM0383 §11): a regular sequence and an injected one, each started by a timer; the injected one may take
//! one conversion a trigger (JDISCEN). Its clock is PCLK2/4, in step with the timers.
//!
//! A sample is the voltage at the end of its sampling time. Noise and the sampling capacitor's own settling are not
//! modelled.

use crate::board::time::{Tick, micros};
use crate::board::{Outcome, UNMODELLED};

const SR: u32 = 0x00;
const CR1: u32 = 0x04;
const CR2: u32 = 0x08;
const SMPR1: u32 = 0x0c;
const SMPR2: u32 = 0x10;
const SQR1: u32 = 0x2c;
const SQR3: u32 = 0x34;
const JSQR: u32 = 0x38;
const JDR1: u32 = 0x3c;
const JDR4: u32 = 0x48;
const DR: u32 = 0x4c;

/// Flags of SR.
const EOC: u32 = 1 << 1;
const JEOC: u32 = 1 << 2;
const JSTRT: u32 = 1 << 3;
const STRT: u32 = 1 << 4;
const OVR: u32 = 1 << 5;
const FLAGS: u32 = 0x3f;

/// SCAN, JDISCEN, and the enables of EOC, JEOC and OVR: the rest is not modelled.
const CR1_MODELLED: u32 = 1 << 26 | 1 << 12 | 1 << 8 | 1 << 7 | 1 << 5;
/// ADON, DMA, DDS, and what the groups are started by.
const CR2_MODELLED: u32 = 0x3f << 24 | 0x3f << 16 | 1 << 9 | 1 << 8 | 1;

/// EXTSEL and JEXTSEL of the triggers that are modelled (§11.12.3).
const REGULAR: [(&str, u32); 3] = [("TIM1_CC1", 0), ("TIM1_CC2", 1), ("TIM1_CC3", 2)];
const INJECTED: [(&str, u32); 2] = [("TIM1_CC4", 0), ("TIM1_TRGO", 1)];

/// Of DS10314 table 66: from ADON to a stable ADC, and from the trigger to the sampling.
const STABILISATION: Tick = micros(3);
const LATENCY_CYCLES: u64 = 3;
/// The sampling times by their code, and the conversion of 12 bits.
const SAMPLING_CYCLES: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];
const CONVERSION_CYCLES: u64 = 12;

/// The groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Group {
    Regular,
    Injected,
}

/// A conversion.
#[derive(Clone, Copy, Debug)]
struct Run {
    group: Group,
    /// Which of its group's.
    index: usize,
    /// The sample, once it is taken.
    sample: Option<u32>,
    /// Until when it samples, or converts.
    until: Tick,
}

/// The ADC.
#[derive(Default)]
pub struct Adc {
    sr: u32,
    cr1: u32,
    cr2: u32,
    smpr: [u32; 2],
    sqr: [u32; 3],
    jsqr: u32,
    dr: u32,
    jdr: [u32; 4],
    run: Option<Run>,
    /// The injected conversion that the next trigger starts.
    turn: usize,
    stable: Tick,
    /// Of the ADC's clock.
    cycle: Tick,
}

impl Adc {
    /// Conversions of a group.
    fn length(&self, group: Group) -> usize {
        let last = match group {
            Group::Regular if self.cr1 >> 8 & 1 == 1 => self.sqr[0] >> 20 & 0xf,
            // Without SCAN only the first is converted.
            Group::Regular => 0,
            Group::Injected => self.jsqr >> 20 & 3,
        };
        last as usize + 1
    }

    /// The input that a group converts there. A short injected group is the end of its register (§11.12.12).
    fn input(&self, group: Group, index: usize) -> u32 {
        match group {
            Group::Regular => self.sqr[2 - index / 6] >> (5 * (index % 6)) & 0x1f,
            Group::Injected => self.jsqr >> (5 * (4 - self.length(group) + index)) & 0x1f,
        }
    }

    fn sampling(&self, group: Group, index: usize) -> Tick {
        let input = self.input(group, index);
        let register = self.smpr[usize::from(input < 10)];
        let code = register >> (3 * (input % 10)) & 7;
        SAMPLING_CYCLES[code as usize] * self.cycle
    }

    fn begin(&mut self, group: Group, index: usize, at: Tick) {
        let until = at + self.sampling(group, index);
        self.run = Some(Run { group, index, sample: None, until });
    }

    /// It asks for an interrupt: EOCIE, JEOCIE, OVRIE.
    pub fn interrupt(&self) -> bool {
        [(5, EOC), (7, JEOC), (26, OVR)]
            .iter()
            .any(|(enable, flag)| self.cr1 >> enable & 1 == 1 && self.sr & flag != 0)
    }

    /// The next moment at which something happens.
    pub fn next(&self) -> Option<Tick> {
        self.run.map(|run| run.until)
    }

    /// A trigger of this name has risen. True where it starts something.
    pub fn trigger(&mut self, source: &str, now: Tick) -> Outcome<bool> {
        let by = |list: &[(&str, u32)], code: u32| list.contains(&(source, code));
        let (cr2, on) = (self.cr2, self.cr2 & 1 == 1);
        let regular = (Group::Regular, cr2 >> 28 & 3, by(&REGULAR, cr2 >> 24 & 0xf));
        let injected = (Group::Injected, cr2 >> 20 & 3, by(&INJECTED, cr2 >> 16 & 0xf));
        for (group, edge, selected) in [regular, injected] {
            if !on || edge == 0 || !selected {
                continue;
            }
            if edge != 1 {
                return Err("a trigger by falling edges".into());
            }
            // An overrun stands: nothing is started until it is cleared (§11.8.1).
            if group == Group::Regular && self.sr & OVR != 0 {
                continue;
            }
            if self.run.is_some() {
                return Err(format!("{source} while it still converts"));
            }
            if now < self.stable {
                return Err(format!("{source} before it is stable"));
            }
            let index = match group {
                Group::Injected if self.cr1 >> 12 & 1 == 1 => self.turn,
                _ => 0,
            };
            self.sr |= if group == Group::Regular { STRT } else { JSTRT };
            self.begin(group, index, now + LATENCY_CYCLES * self.cycle);
            return Ok(true);
        }
        Ok(false)
    }

    /// The input whose sample is taken at `now`, if one is.
    pub fn sampled(&self, now: Tick) -> Option<u32> {
        let run = self.run.filter(|run| run.until == now && run.sample.is_none())?;
        Some(self.input(run.group, run.index))
    }

    /// What happens at [`Self::next`]; `sample` is asked for the code of [`Self::sampled`]. True asks for a
    /// transfer.
    pub fn advance(&mut self, now: Tick, sample: impl FnOnce() -> Outcome<u32>) -> Outcome<bool> {
        let Some(Run { group, index, sample: taken, .. }) = self.run else { return Ok(false) };
        let Some(code) = taken else {
            let until = now + CONVERSION_CYCLES * self.cycle;
            self.run = Some(Run { group, index, sample: Some(sample()?), until });
            return Ok(false);
        };
        self.run = None;
        let last = index + 1 == self.length(group);
        match group {
            Group::Injected => {
                self.jdr[index] = code;
                let one = self.cr1 >> 12 & 1 == 1;
                self.turn = if last || !one { 0 } else { index + 1 };
                if last {
                    self.sr |= JEOC;
                } else if !one {
                    self.begin(group, index + 1, now);
                }
                Ok(false)
            }
            // Nobody has read the one before. Nobody is asked to any more, and the sequence ends.
            Group::Regular if self.sr & EOC != 0 => {
                self.sr |= OVR;
                Ok(false)
            }
            Group::Regular => {
                self.dr = code;
                self.sr |= EOC;
                if !last {
                    self.begin(group, index + 1, now);
                }
                Ok(self.cr2 >> 8 & 1 == 1)
            }
        }
    }

    /// The register at `offset`.
    pub fn read(&mut self, offset: u32) -> Outcome<u32> {
        Ok(match offset {
            SR => self.sr,
            CR1 => self.cr1,
            CR2 => self.cr2,
            SMPR1 | SMPR2 => self.smpr[(offset - SMPR1) as usize / 4],
            SQR1..=SQR3 => self.sqr[(offset - SQR1) as usize / 4],
            JSQR => self.jsqr,
            JDR1..=JDR4 => self.jdr[(offset - JDR1) as usize / 4],
            DR => {
                self.sr &= !EOC;
                self.dr
            }
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes it. `cycle` is the period of the ADC's clock.
    pub fn write(&mut self, offset: u32, value: u32, now: Tick, cycle: Tick) -> Outcome {
        match offset {
            SR if value & !FLAGS != 0 => return Err(UNMODELLED.into()),
            // Zeros clear.
            SR => self.sr &= value,
            CR1 if value & !CR1_MODELLED != 0 => return Err(UNMODELLED.into()),
            CR1 => self.cr1 = value,
            CR2 if value & !CR2_MODELLED != 0 => return Err(UNMODELLED.into()),
            // EOC at the end of the sequence alone is what there is without DMA.
            CR2 if value & 1 == 1 && value >> 8 & 3 != 3 => {
                return Err("on without DMA and DDS, which is not modelled".into());
            }
            CR2 => {
                if self.cr2 & 1 == 0 && value & 1 == 1 {
                    (self.stable, self.cycle) = (now + STABILISATION, cycle);
                }
                if value & 1 == 0 {
                    (self.run, self.turn) = (None, 0);
                }
                self.cr2 = value;
            }
            SMPR1 | SMPR2 => self.smpr[(offset - SMPR1) as usize / 4] = value,
            SQR1..=SQR3 => self.sqr[(offset - SQR1) as usize / 4] = value,
            JSQR => self.jsqr = value,
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }
}
