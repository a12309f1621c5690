//! ADC of the STM32F411 (RM0383 §11).
//!
//! Timers or the program (SWSTART) start its regular sequence, timers its injected one. The
//! injected one may take one conversion per trigger (JDISCEN), and the regular one has a single
//! conversion without DMA. The ADC's clock is PCLK2/4, synchronous with the timers. A sample is the
//! voltage at the end of its sampling time, which must be long enough for its source. Noise is not
//! modelled.

use crate::board::finger::Source;
use crate::board::time::{HZ, Tick, micros};
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

/// Modelled bits of CR1: SCAN, JDISCEN, and the enables of EOC, JEOC and OVR.
const CR1_MODELLED: u32 = 1 << 26 | 1 << 12 | 1 << 8 | 1 << 7 | 1 << 5;
/// Modelled bits of CR2: ADON, DMA, DDS, SWSTART, and the triggers of both groups.
const CR2_MODELLED: u32 = 0x7f << 24 | 0x3f << 16 | 1 << 9 | 1 << 8 | 1;
const SWSTART: u32 = 1 << 30;

/// Modelled triggers with their EXTSEL and JEXTSEL (§11.12.3).
const REGULAR: [(&str, u32); 3] = [("TIM1_CC1", 0), ("TIM1_CC2", 1), ("TIM1_CC3", 2)];
const INJECTED: [(&str, u32); 2] = [("TIM1_CC4", 0), ("TIM1_TRGO", 1)];

/// Time from ADON to a stable ADC, and cycles from the trigger to sampling (DS10314 table 66).
const STABILISATION: Tick = micros(3);
const LATENCY_CYCLES: u64 = 3;
/// Cycles of sampling by its code, and of a 12-bit conversion.
const SAMPLING_CYCLES: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];
const CONVERSION_CYCLES: u64 = 12;

/// Largest resistance in ohms of the sampling switch, and largest capacitance in farads behind it
/// (DS10314 table 66).
const SWITCH_OHM: f64 = 6_000.0;
const SAMPLING_F: f64 = 7e-12;
/// Least sampling time of temperature sensor and reference (DS10314 tables 71, 74).
const INTERNAL: Tick = micros(10);

/// Group of a conversion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Group {
    Regular,
    Injected,
}

/// Conversion in progress.
#[derive(Clone, Copy, Debug)]
struct Run {
    group: Group,
    /// Index in the group's sequence.
    index: usize,
    /// Sampled code; `None` while sampling.
    sample: Option<u32>,
    /// End of sampling, or of converting.
    until: Tick,
}

/// ADC with its registers and conversion.
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
    /// Index of the injected conversion that the next trigger starts.
    turn: usize,
    stable: Tick,
    /// Period of the ADC's clock.
    cycle: Tick,
}

impl Adc {
    /// Number of conversions in a group.
    fn length(&self, group: Group) -> usize {
        let last = match group {
            Group::Regular if self.cr1 >> 8 & 1 == 1 => self.sqr[0] >> 20 & 0xf,
            // Without SCAN only the first input is converted.
            Group::Regular => 0,
            Group::Injected => self.jsqr >> 20 & 3,
        };
        last as usize + 1
    }

    /// Input at `index` of a group; a short injected group uses the end of its register
    /// (§11.12.12).
    fn input(&self, group: Group, index: usize) -> u32 {
        match group {
            Group::Regular => self.sqr[2 - index / 6] >> (5 * (index % 6)) & 0x1f,
            Group::Injected => self.jsqr >> (5 * (4 - self.length(group) + index)) & 0x1f,
        }
    }

    /// Least sampling time for a source, which has `ohm` on a pin (DS10314 equation 1).
    pub fn least_sampling(&self, source: Source, ohm: f64) -> Tick {
        match source {
            Source::Temperature | Source::Reference => INTERNAL,
            Source::Pin(_) | Source::Amplifier(_) => {
                // To a quarter of a step of 12 bits, and half a cycle.
                let seconds = (ohm + SWITCH_OHM) * SAMPLING_F * f64::from(1 << 14).ln();
                (seconds * HZ as f64) as Tick + self.cycle / 2
            }
        }
    }

    /// Sampling time of an input.
    pub fn sampling(&self, input: u32) -> Tick {
        let register = self.smpr[usize::from(input < 10)];
        let code = register >> (3 * (input % 10)) & 7;
        SAMPLING_CYCLES[code as usize] * self.cycle
    }

    fn begin(&mut self, group: Group, index: usize, at: Tick) {
        let until = at + self.sampling(self.input(group, index));
        self.run = Some(Run { group, index, sample: None, until });
    }

    /// Whether an interrupt is requested: EOCIE, JEOCIE, OVRIE.
    pub fn interrupt(&self) -> bool {
        [(5, EOC), (7, JEOC), (26, OVR)]
            .iter()
            .any(|(enable, flag)| self.cr1 >> enable & 1 == 1 && self.sr & flag != 0)
    }

    /// Time of the next end of sampling or converting.
    pub fn next(&self) -> Option<Tick> {
        self.run.map(|run| run.until)
    }

    /// Handles the rising edge of a trigger; true if it starts a conversion.
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
                return Err("trigger on falling edges, which is not modelled".into());
            }
            // An overrun blocks new conversions until it is cleared (§11.8.1).
            if group == Group::Regular && self.sr & OVR != 0 {
                continue;
            }
            if self.run.is_some() {
                return Err(format!("{source} during a conversion, which is {UNMODELLED}"));
            }
            if now < self.stable {
                return Err(format!("{source} before the ADC is stable"));
            }
            let index = match group {
                Group::Injected if self.cr1 >> 12 & 1 == 1 => self.turn,
                _ => 0,
            };
            self.start(group, index, now)?;
            return Ok(true);
        }
        Ok(false)
    }

    /// Starts a group at the conversion with this index.
    fn start(&mut self, group: Group, index: usize, now: Tick) -> Outcome {
        // Without DMA only EOC at the end of the sequence would exist.
        if group == Group::Regular && self.cr2 >> 8 & 3 != 3 && self.length(group) > 1 {
            return Err("a sequence without DMA and DDS, which is not modelled".into());
        }
        self.sr |= if group == Group::Regular { STRT } else { JSTRT };
        self.begin(group, index, now + LATENCY_CYCLES * self.cycle);
        Ok(())
    }

    /// Input that is sampled at `now`, if any.
    pub fn sampled(&self, now: Tick) -> Option<u32> {
        let run = self.run.filter(|run| run.until <= now && run.sample.is_none())?;
        Some(self.input(run.group, run.index))
    }

    /// Runs the event at [`Self::next`]; true requests a DMA transfer.
    ///
    /// `sample` returns the code of the input in [`Self::sampled`].
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
            // Overrun: the last result was not read. No more are delivered, and the sequence ends.
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

    /// Reads the register at `offset`.
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

    /// Writes the register at `offset`; `cycle` is the period of the ADC's clock.
    pub fn write(&mut self, offset: u32, value: u32, now: Tick, cycle: Tick) -> Outcome {
        match offset {
            SR if value & !FLAGS != 0 => return Err(UNMODELLED.into()),
            // Flags are cleared by writing zero.
            SR => self.sr &= value,
            CR1 if value & !CR1_MODELLED != 0 => return Err(UNMODELLED.into()),
            CR1 => self.cr1 = value,
            CR2 if value & !CR2_MODELLED != 0 => return Err(UNMODELLED.into()),
            CR2 => {
                if self.cr2 & 1 == 0 && value & 1 == 1 {
                    (self.stable, self.cycle) = (now + STABILISATION, cycle);
                }
                if value & 1 == 0 {
                    (self.run, self.turn) = (None, 0);
                }
                // The chip clears SWSTART when the conversion starts.
                self.cr2 = value & !SWSTART;
                if value & SWSTART != 0 {
                    if value & 1 == 0 || now < self.stable {
                        return Err("SWSTART before the ADC is stable".into());
                    }
                    if self.run.is_some() {
                        return Err("SWSTART during a conversion".into());
                    }
                    // As after a trigger.
                    if self.sr & OVR != 0 {
                        return Ok(());
                    }
                    self.start(Group::Regular, 0, now)?;
                }
            }
            SMPR1 | SMPR2 => self.smpr[(offset - SMPR1) as usize / 4] = value,
            SQR1..=SQR3 => self.sqr[(offset - SQR1) as usize / 4] = value,
            JSQR => self.jsqr = value,
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }
}
