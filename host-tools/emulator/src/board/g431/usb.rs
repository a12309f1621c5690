//! USB full-speed device and its packet memory (RM0440 §45).
//!
//! Double buffers and isochronous endpoints are not modelled.

use stm32_metapac::usb::regs::{Cntr, Epr, Istr};
use stm32_metapac::usb::vals::{EpType, Stat};

use crate::board::time::{Tick, micros};
use crate::board::usb::{Answer, Device};
use crate::board::{Outcome, UNMODELLED};

const ENDPOINTS: usize = 8;
const MEMORY: usize = 1024;

const CNTR: u32 = 0x40;
const ISTR: u32 = 0x44;
const FNR: u32 = 0x48;
const DADDR: u32 = 0x4c;
const BTABLE: u32 = 0x50;
const BCDR: u32 = 0x58;

/// Time from PDWN to a transceiver that has started (DS12589 table 93: tSTARTUP).
const STARTED: Tick = micros(1);

const TABLE: &str = "a buffer description beyond the packet memory (BTABLE)";

/// DPPU: the pull-up that shows the device to a host.
const PULL_UP: u32 = 1 << 15;
/// Bits of ISTR that stay set until they are cleared.
const STANDING: u32 = 0x7f80;
/// Toggle bits of an endpoint's register: DTOG_RX, STAT_RX, DTOG_TX, STAT_TX.
const TOGGLES: u32 = 1 << 14 | 3 << 12 | 1 << 6 | 3 << 4;
const SUSP: u32 = 1 << 11;
const RESET: u32 = 1 << 10;
const WKUP: u32 = 1 << 12;

/// USB device with its registers and packet memory.
pub struct Usb {
    epr: [Epr; ENDPOINTS],
    cntr: u32,
    istr: u32,
    daddr: u32,
    btable: u32,
    bcdr: u32,
    memory: [u8; MEMORY],
    /// Time from which the transceiver has power.
    powered: Tick,
}

impl Default for Usb {
    fn default() -> Self {
        Self {
            epr: [Epr(0); ENDPOINTS],
            cntr: 3,
            istr: 0,
            daddr: 0,
            btable: 0,
            bcdr: 0,
            memory: [0; MEMORY],
            powered: 0,
        }
    }
}

impl Usb {
    /// Whether the device requests its interrupt.
    pub fn interrupt(&self) -> bool {
        self.status() & self.cntr & 0xff00 != 0
    }

    fn status(&self) -> u32 {
        let mut istr = Istr(self.istr);
        let first = self.epr.iter().position(|epr| epr.ctr_rx() || epr.ctr_tx());
        if let Some(first) = first {
            istr.set_ctr(true);
            istr.set_ep_id(first as u8);
            // DIR: set for an OUT or SETUP.
            istr.0 |= u32::from(self.epr[first].ctr_rx()) << 4;
        }
        istr.0
    }

    /// Index of the register that serves an endpoint.
    fn endpoint(&self, address: u8, number: u8) -> Option<usize> {
        let addressed = self.daddr == u32::from(address) | 0x80;
        (0..ENDPOINTS).find(|i| {
            let epr = self.epr[*i];
            let used = epr.stat_rx() != Stat::DISABLED || epr.stat_tx() != Stat::DISABLED;
            addressed && used && epr.ea() == number
        })
    }

    fn receive(&mut self, i: usize, data: &[u8]) -> Outcome {
        let (at, room) = (usize::from(self.entry(i, 2)?), self.entry(i, 3)?);
        let blocks = usize::from(room >> 10 & 0x1f);
        let room = if room >> 15 == 1 { 32 * (blocks + 1) } else { 2 * blocks };
        if data.len() > room {
            return Err(format!("a packet of {} bytes exceeds its buffer of {room}", data.len()));
        }
        let place = self.memory.get_mut(at..at + data.len());
        place.ok_or("a buffer beyond the packet memory")?.copy_from_slice(data);
        let kept = self.entry(i, 3)? & !0x3ff;
        self.set_entry(i, 3, kept | data.len() as u16)?;
        let epr = &mut self.epr[i];
        epr.set_stat_rx(Stat::NAK);
        epr.set_ctr_rx(true);
        Ok(())
    }

    /// Half word of an endpoint's buffer description: address and count to send, then to receive.
    fn entry(&self, i: usize, which: usize) -> Outcome<u16> {
        let at = self.btable as usize + 8 * i + 2 * which;
        let half = self.memory.get(at..at + 2).ok_or(TABLE)?;
        Ok(u16::from_le_bytes([half[0], half[1]]))
    }

    fn set_entry(&mut self, i: usize, which: usize, value: u16) -> Outcome {
        let at = self.btable as usize + 8 * i + 2 * which;
        let half = self.memory.get_mut(at..at + 2).ok_or(TABLE)?;
        half.copy_from_slice(&value.to_le_bytes());
        Ok(())
    }

    /// Reads the register at `offset`; `frame` is the host's frame number.
    pub fn read(&self, offset: u32, frame: u32) -> Outcome<u32> {
        Ok(match offset {
            0x00..=0x1c => self.epr[offset as usize / 4].0,
            CNTR => self.cntr,
            ISTR => self.status(),
            FNR => frame & 0x7ff,
            DADDR => self.daddr,
            BTABLE => self.btable,
            BCDR => self.bcdr,
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes the register at `offset`; `clock` is whether the peripheral has its 48 MHz.
    pub fn write(&mut self, offset: u32, value: u32, clock: bool, now: Tick) -> Outcome {
        match offset {
            0x00..=0x1c => {
                let epr = &mut self.epr[offset as usize / 4];
                // Writing 1 inverts data toggles and states, writing 0 clears CTR.
                let kept = epr.0 & value & 0x8080;
                let toggled = (epr.0 ^ value) & TOGGLES;
                epr.0 = kept | toggled | epr.0 & 0x0800 | value & 0x070f;
                if epr.ep_type() == EpType::ISO {
                    return Err("isochronous endpoint, which is not modelled".into());
                }
            }
            CNTR => {
                if !clock {
                    return Err("without a clock of 48 MHz".into());
                }
                let (before, cntr) = (Cntr(self.cntr), Cntr(value));
                if before.pdwn() && !cntr.pdwn() {
                    self.powered = now;
                }
                if !cntr.fres() && (cntr.pdwn() || now < self.powered + STARTED) {
                    return Err("FRES is cleared before the transceiver has started".into());
                }
                if cntr.fres() && !before.fres() {
                    self.bus_reset();
                }
                self.cntr = value;
            }
            ISTR => self.istr &= value | !STANDING,
            DADDR => self.daddr = value & 0xff,
            BTABLE if value & 7 != 0 || value >= MEMORY as u32 => return Err(UNMODELLED.into()),
            BTABLE => self.btable = value,
            BCDR if value & !PULL_UP != 0 => return Err(UNMODELLED.into()),
            BCDR => self.bcdr = value,
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }

    /// Reads a byte or half word of the packet memory.
    pub fn read_memory(&self, offset: u32, size: u32) -> Outcome<u32> {
        let at = offset as usize;
        let bytes = self.memory.get(at..at + size as usize).filter(|bytes| bytes.len() <= 2);
        let bytes = bytes.ok_or("a word from a packet memory of 16 bits")?;
        Ok(bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    /// Writes a byte or half word of the packet memory.
    pub fn write_memory(&mut self, offset: u32, size: u32, value: u32) -> Outcome {
        let at = offset as usize;
        let place = self.memory.get_mut(at..at + size as usize).filter(|place| place.len() <= 2);
        let place = place.ok_or("a word to a packet memory of 16 bits")?;
        place.iter_mut().zip(value.to_le_bytes()).for_each(|(to, from)| *to = from);
        Ok(())
    }
}

impl Device for Usb {
    fn is_attached(&self) -> bool {
        let cntr = Cntr(self.cntr);
        self.bcdr & PULL_UP != 0 && !cntr.pdwn() && !cntr.fres()
    }

    fn bus_reset(&mut self) {
        self.epr = [Epr(0); ENDPOINTS];
        self.daddr = 0;
        self.istr |= RESET;
    }

    fn suspend(&mut self, suspended: bool) {
        self.istr |= if suspended { SUSP } else { WKUP };
    }

    fn ready_to_send(&self, address: u8, number: u8) -> bool {
        self.endpoint(address, number).is_some_and(|i| self.epr[i].stat_tx() != Stat::NAK)
    }

    fn ready_to_receive(&self, address: u8, number: u8) -> bool {
        self.endpoint(address, number).is_some_and(|i| self.epr[i].stat_rx() != Stat::NAK)
    }

    fn setup(&mut self, address: u8, data: [u8; 8]) -> Outcome<Answer> {
        let Some(i) = self.endpoint(address, 0) else { return Ok(Answer::Silence) };
        if self.epr[i].ep_type() != EpType::CONTROL || self.epr[i].stat_rx() == Stat::DISABLED {
            return Ok(Answer::Silence);
        }
        self.receive(i, &data)?;
        let epr = &mut self.epr[i];
        epr.set_setup(true);
        epr.set_stat_tx(Stat::NAK);
        epr.set_dtog_rx(true);
        epr.set_dtog_tx(true);
        Ok(Answer::Ack)
    }

    fn out(&mut self, address: u8, number: u8, data1: bool, data: &[u8]) -> Outcome<Answer> {
        let Some(i) = self.endpoint(address, number) else { return Ok(Answer::Silence) };
        let epr = self.epr[i];
        match epr.stat_rx() {
            Stat::DISABLED => return Ok(Answer::Silence),
            Stat::NAK => return Ok(Answer::Nak),
            Stat::STALL => return Ok(Answer::Stall),
            Stat::VALID => {}
        }
        // STATUS_OUT: only an empty packet is allowed.
        if epr.ep_type() == EpType::CONTROL && epr.ep_kind() && !data.is_empty() {
            return Ok(Answer::Stall);
        }
        if epr.dtog_rx() != data1 {
            // A repeated packet is acknowledged and dropped.
            return Ok(Answer::Ack);
        }
        self.receive(i, data)?;
        self.epr[i].set_dtog_rx(!data1);
        self.epr[i].set_setup(false);
        Ok(Answer::Ack)
    }

    fn take(&mut self, address: u8, number: u8) -> Outcome<Answer> {
        let Some(i) = self.endpoint(address, number) else { return Ok(Answer::Silence) };
        match self.epr[i].stat_tx() {
            Stat::DISABLED => return Ok(Answer::Silence),
            Stat::NAK => return Ok(Answer::Nak),
            Stat::STALL => return Ok(Answer::Stall),
            Stat::VALID => {}
        }
        let (at, count) = (usize::from(self.entry(i, 0)?), usize::from(self.entry(i, 1)? & 0x3ff));
        let data =
            self.memory.get(at..at + count).ok_or("a packet beyond the packet memory")?.to_vec();
        let epr = &mut self.epr[i];
        let data1 = epr.dtog_tx();
        epr.set_dtog_tx(!data1);
        epr.set_stat_tx(Stat::NAK);
        epr.set_ctr_tx(true);
        Ok(Answer::Data(data1, data))
    }
}

#[cfg(test)]
mod tests;
