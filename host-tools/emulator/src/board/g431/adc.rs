//! ADC of the STM32G431 (RM0440 §21).
//!
//! It has calibration, a regular and an injected group started by timers, oversampling of the
//! regular group, and overrun. The clock is HCLK/4, synchronous with the timers. A sample is the
//! voltage at the end of its sampling time, which must be long enough for its source. Noise is not
//! modelled.

use stm32_metapac::adc::regs::{Cfgr2, Cr};
use stm32_metapac::metadata::PeripheralTrigger;

use super::names::peripheral;
use crate::board::time::{Tick, micros};
use crate::board::{Outcome, UNMODELLED};

const ISR: u32 = 0x00;
const IER: u32 = 0x04;
const CR: u32 = 0x08;
const CFGR: u32 = 0x0c;
const CFGR2: u32 = 0x10;
const SMPR1: u32 = 0x14;
const SMPR2: u32 = 0x18;
const SQR1: u32 = 0x30;
const SQR4: u32 = 0x3c;
const DR: u32 = 0x40;
const JSQR: u32 = 0x4c;
const JDR1: u32 = 0x80;
const JDR4: u32 = 0x8c;

const OVR: u32 = 1 << 4;
const ADSTP: u32 = 1 << 4;
const JADSTP: u32 = 1 << 5;

/// Start-up of the regulator, cycles of a calibration, and latency from trigger to sampling
/// (DS12589 table 66).
const REGULATOR_US: u64 = 20;
const CALIBRATION_CYCLES: u64 = 116;
/// Cycles between the end of a calibration and ADEN (RM0440 §21.4.8).
const CALIBRATED_CYCLES: u64 = 4;
const LATENCY_EIGHTHS: u64 = 17;
/// Half cycles of sampling by its code, and of a 12-bit conversion.
const SAMPLING_HALVES: [u64; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];
const CONVERSION_HALVES: u64 = 25;
/// Half cycles from enabled to ready, one conversion by the data sheet.
const STABILISATION_HALVES: u64 = 30;

/// Group being converted.
#[derive(Clone, Copy, Debug)]
struct Run {
    /// Index in the sequence.
    index: usize,
    /// Number of samples in `sum`.
    samples: u32,
    sum: u32,
    /// Whether the ADC is sampling; otherwise it is converting.
    sampling: bool,
    /// End of sampling, or of converting.
    until: Tick,
}

/// Group of a conversion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Group {
    Regular,
    Injected,
}

/// Source, group and code of a line in the chip's list of triggers.
fn trigger(line: &PeripheralTrigger) -> Option<(String, Group, u32)> {
    let (group, number) = match line.signal.strip_prefix("ADC_EXT_TRG") {
        Some(number) => (Group::Regular, number),
        None => (Group::Injected, line.signal.strip_prefix("ADC_JEXT_TRG")?),
    };
    Some((line.source.to_owned(), group, number.parse().ok()?))
}

/// ADC with its registers and conversions.
pub struct Adc {
    isr: u32,
    ier: u32,
    cr: u32,
    cfgr: u32,
    cfgr2: u32,
    smpr: [u32; 2],
    sqr: [u32; 4],
    jsqr: u32,
    dr: u32,
    jdr: [u32; 4],
    regular: Option<Run>,
    injected: Option<Run>,
    regulator_since: Tick,
    /// End of the calibration or the start-up.
    busy: Option<Tick>,
    /// End of the last calibration.
    calibrated: Option<Tick>,
    ready: bool,
    /// Whether the DMA has made its last transfer in one-shot mode.
    dma_ended: bool,
    /// Period of the ADC's clock.
    cycle: Tick,
    /// Triggers: source, group, and code of EXTSEL or JEXTSEL.
    triggers: Vec<(String, Group, u32)>,
}

impl Adc {
    /// ADC after a reset, by its name.
    pub fn new(name: &str) -> Self {
        let triggers = peripheral(name).triggers;
        Self {
            isr: 0,
            ier: 0,
            cr: 1 << 29,
            cfgr: 1 << 31,
            cfgr2: 0,
            smpr: [0; 2],
            sqr: [0; 4],
            jsqr: 0,
            dr: 0,
            jdr: [0; 4],
            regular: None,
            injected: None,
            regulator_since: 0,
            busy: None,
            calibrated: None,
            ready: false,
            dma_ended: false,
            cycle: 1,
            triggers: triggers.iter().filter_map(trigger).collect(),
        }
    }

    fn halves(&self, halves: u64) -> Tick {
        self.cycle * halves / 2
    }

    fn run(&mut self, group: Group) -> &mut Option<Run> {
        match group {
            Group::Regular => &mut self.regular,
            Group::Injected => &mut self.injected,
        }
    }

    /// Input at `index` of a group.
    fn input(&self, group: Group, index: usize) -> u32 {
        let place = index + 1;
        match group {
            Group::Regular => self.sqr[place / 5] >> (6 * (place % 5)) & 0x1f,
            Group::Injected => self.jsqr >> (9 + 6 * index) & 0x1f,
        }
    }

    /// Sampling time of an input.
    pub fn sampling(&self, input: u32) -> Tick {
        // Inputs from 19 on do not exist; the sample itself stops the machine.
        let smpr = self.smpr.get(input as usize / 10).copied().unwrap_or_default();
        let code = smpr >> (3 * (input % 10)) & 7;
        self.halves(SAMPLING_HALVES[code as usize])
    }

    /// Whether an interrupt is requested.
    pub fn interrupt(&self) -> bool {
        self.isr & self.ier & 0x7ff != 0
    }

    /// Time of the next event.
    pub fn next(&self) -> Option<Tick> {
        let runs = [self.regular, self.injected].into_iter().flatten().map(|run| run.until);
        runs.chain(self.busy).min()
    }

    /// Edge and source of the regular group's trigger: EXTEN, EXTSEL.
    pub fn regular_trigger(&self) -> [u32; 2] {
        [self.cfgr >> 10 & 3, self.cfgr >> 5 & 0x1f]
    }

    /// Handles the rising edge of a trigger; true if it starts a conversion.
    ///
    /// `regular` is [`Self::regular_trigger`] of this ADC, or in a dual mode of ADC1.
    pub fn trigger(&mut self, source: &str, regular: [u32; 2], now: Tick) -> Outcome<bool> {
        let mut starts = false;
        let cr = Cr(self.cr);
        let jsqr = self.jsqr;
        let regular = (Group::Regular, cr.adstart(), regular[0], regular[1]);
        let injected = (Group::Injected, cr.jadstart(), jsqr >> 7 & 3, jsqr >> 2 & 0x1f);
        for (group, started, edge, select) in [regular, injected] {
            let wanted = self
                .triggers
                .iter()
                .any(|(from, starts, code)| (*starts, *code) == (group, select) && from == source);
            if !started || !wanted || edge == 0 {
                continue;
            }
            if edge != 1 {
                return Err("trigger on falling edges, which is not modelled".into());
            }
            if self.regular.is_some() || self.injected.is_some() {
                return Err(format!("{source} during a conversion, which is {UNMODELLED}"));
            }
            self.begin(group, now + self.cycle * LATENCY_EIGHTHS / 8);
            starts = true;
        }
        Ok(starts)
    }

    fn begin(&mut self, group: Group, start: Tick) {
        let until = start + self.sampling(self.input(group, 0));
        *self.run(group) = Some(Run { index: 0, samples: 0, sum: 0, sampling: true, until });
    }

    /// Whether a calibration or start-up has ended.
    fn is_ready(&self, now: Tick) -> bool {
        self.busy.is_some_and(|until| until <= now)
    }

    /// Group whose sampling or converting has ended, if any.
    fn due(&self, now: Tick) -> Option<(Run, Group)> {
        let groups = [(self.regular, Group::Regular), (self.injected, Group::Injected)];
        groups
            .into_iter()
            .find_map(|(run, group)| Some((run?, group)).filter(|(run, _)| run.until <= now))
    }

    /// Input that is sampled at `now`, if any.
    pub fn sampled(&self, now: Tick) -> Option<u32> {
        let (run, group) = self.due(now)?;
        (run.sampling && !self.is_ready(now)).then(|| self.input(group, run.index))
    }

    /// Whether a group is being converted.
    pub fn is_converting(&self) -> bool {
        self.regular.is_some() || self.injected.is_some()
    }

    /// Runs the event at [`Self::next`]; true requests a DMA transfer.
    ///
    /// `sample` returns the code of the input in [`Self::sampled`].
    pub fn advance(&mut self, now: Tick, sample: impl FnOnce() -> Outcome<u32>) -> Outcome<bool> {
        if self.is_ready(now) {
            self.busy = None;
            let mut cr = Cr(self.cr);
            if cr.adcal() {
                cr.set_adcal(false);
                self.cr = cr.0;
                self.calibrated = Some(now);
            } else {
                self.isr |= 1;
                self.ready = true;
            }
            return Ok(false);
        }
        let Some((mut run, group)) = self.due(now) else { return Ok(false) };
        let input = self.input(group, run.index);
        if run.sampling {
            run.sum += sample()?;
            run.samples += 1;
            run.until = now + self.halves(CONVERSION_HALVES);
            let ratio = match group {
                Group::Regular if Cfgr2(self.cfgr2).rovse() => 2 << (self.cfgr2 >> 2 & 7),
                _ => 1,
            };
            if run.samples < ratio {
                run.until += self.sampling(input);
            } else {
                run.sampling = false;
            }
            *self.run(group) = Some(run);
            return Ok(false);
        }
        let (index, sum) = (run.index, run.sum);
        let last = match group {
            Group::Regular => self.sqr[0] & 0xf,
            Group::Injected => self.jsqr & 3,
        };
        *self.run(group) = (index < last as usize).then(|| {
            let until = now + self.sampling(self.input(group, index + 1));
            Run { index: index + 1, samples: 0, sum: 0, sampling: true, until }
        });
        let ended = u32::from(self.run(group).is_none());
        // A group that the program has started stops at its end.
        match group {
            Group::Regular if ended == 1 && self.cfgr >> 10 & 3 == 0 => self.cr &= !(1 << 2),
            Group::Injected if ended == 1 && self.jsqr >> 7 & 3 == 0 => self.cr &= !(1 << 3),
            _ => {}
        }
        match group {
            Group::Injected => {
                self.jdr[index] = sum;
                self.isr |= 1 << 5 | ended << 6;
                Ok(false)
            }
            // Overrun: the last result was not read. No more are delivered (§21.4.27).
            Group::Regular if self.isr >> 2 & 1 == 1 => {
                self.isr |= OVR;
                Ok(false)
            }
            Group::Regular => {
                self.dr = sum >> (self.cfgr2 >> 5 & 0xf);
                self.isr |= 1 << 2 | ended << 3;
                // An overrun that stands holds the DMA's requests back (§21.4.27).
                Ok(self.cfgr & 1 == 1 && !self.dma_ended && self.isr & OVR == 0)
            }
        }
    }

    /// Records the DMA's last transfer: without DMACFG no request follows (§21.4.27).
    pub fn end_dma(&mut self) {
        self.dma_ended = self.cfgr & 2 == 0;
    }

    /// Reads the register at `offset`.
    pub fn read(&mut self, offset: u32) -> Outcome<u32> {
        Ok(match offset {
            ISR => self.isr,
            IER => self.ier,
            CR => self.cr,
            CFGR => self.cfgr,
            CFGR2 => self.cfgr2,
            SMPR1 | SMPR2 => self.smpr[(offset - SMPR1) as usize / 4],
            SQR1..=SQR4 => self.sqr[(offset - SQR1) as usize / 4],
            DR => {
                self.isr &= !(1 << 2);
                self.dr
            }
            JSQR => self.jsqr,
            JDR1..=JDR4 => self.jdr[(offset - JDR1) as usize / 4],
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes the register at `offset`; `cycle` is the period of the ADC's clock.
    pub fn write(&mut self, offset: u32, value: u32, now: Tick, cycle: Tick) -> Outcome {
        let started = self.cr & 0b1100 != 0;
        match offset {
            ISR => self.isr &= !value,
            CR => return self.control(value, now, cycle),
            _ if started => return Err("written while conversions are started".into()),
            IER => self.ier = value,
            CFGR => {
                // DMAEN, DMACFG, EXTSEL, EXTEN, JQDIS: the rest is not modelled.
                if value & !(1 << 31 | 0xfe3) != 0 {
                    return Err(UNMODELLED.into());
                }
                (self.cfgr, self.dma_ended) = (value, false);
            }
            CFGR2 if value & !0x1fd != 0 => return Err(UNMODELLED.into()),
            CFGR2 => self.cfgr2 = value,
            SMPR1 | SMPR2 => self.smpr[(offset - SMPR1) as usize / 4] = value,
            SQR1..=SQR4 => self.sqr[(offset - SQR1) as usize / 4] = value,
            JSQR => self.jsqr = value,
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }

    fn control(&mut self, value: u32, now: Tick, cycle: Tick) -> Outcome {
        let (before, mut cr) = (Cr(self.cr), Cr(value));
        // DEEPPWD, ADVREGEN and ADCALDIF (RM0440, ADC_CR).
        if (value ^ before.0) & 0x7000_0000 != 0 && before.aden() {
            return Err("power or kind of calibration is changed while the ADC is enabled".into());
        }
        if cr.advregen() && !before.advregen() {
            self.regulator_since = now;
        }
        let regulated = before.advregen() && now >= self.regulator_since + micros(REGULATOR_US);
        self.cycle = cycle;
        if cr.adcal() && !before.adcal() {
            if !regulated || before.aden() {
                return Err("calibration before the regulator is up, or while enabled".into());
            }
            self.busy = Some(now + CALIBRATION_CYCLES * cycle);
        }
        if cr.aden() && !before.aden() {
            let calibrated = self.calibrated.map(|end| end + CALIBRATED_CYCLES * cycle);
            if !regulated || before.adcal() || calibrated.is_none_or(|from| now < from) {
                return Err("enabled before regulator and calibration are done".into());
            }
            self.busy = Some(now + self.halves(STABILISATION_HALVES));
        }
        if (cr.adstart() || cr.jadstart()) && !self.ready {
            return Err("started before the ADC is ready".into());
        }
        // Conversions stop at once.
        if value & ADSTP != 0 {
            cr.set_adstart(false);
            self.regular = None;
        }
        if value & JADSTP != 0 {
            cr.set_jadstart(false);
            self.injected = None;
        }
        cr.0 &= !(ADSTP | JADSTP);
        if cr.addis() {
            return Err(UNMODELLED.into());
        }
        // Writing 0 does not clear these bits.
        cr.0 |= before.0 & 1 | (before.0 & 1 << 31);
        if before.adstart() && value & ADSTP == 0 {
            cr.set_adstart(true);
        }
        if before.jadstart() && value & JADSTP == 0 {
            cr.set_jadstart(true);
        }
        self.cr = cr.0;
        let software = [
            (Group::Regular, cr.adstart() && !before.adstart(), self.cfgr >> 10 & 3),
            (Group::Injected, cr.jadstart() && !before.jadstart(), self.jsqr >> 7 & 3),
        ];
        for (group, _, _) in software.into_iter().filter(|(_, starts, edge)| *starts && *edge == 0)
        {
            if self.is_converting() {
                return Err("started by the program during a conversion".into());
            }
            self.begin(group, now);
        }
        Ok(())
    }
}
