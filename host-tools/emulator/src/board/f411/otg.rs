//! USB OTG core as a full-speed device without DMA (RM0383 §22): FIFOs, endpoints, interrupts.
//!
//! Host mode, isochronous endpoints and low power are not modelled. Packets from the bus wait in
//! one receive FIFO until the program pops them. Packets to the host wait in the FIFO of their
//! endpoint. An OUT endpoint accepts data whenever it does not answer NAK, whether EPENA is set or
//! not, because embassy's driver relies on that.

mod bus;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use crate::board::{Outcome, UNMODELLED};

/// Number of endpoints in each direction, with endpoint 0.
const ENDPOINTS: usize = 4;
/// Size of the memory that all FIFOs share, words.
const MEMORY: u32 = 320;

const GAHBCFG: u32 = 0x008;
const GUSBCFG: u32 = 0x00c;
const GRSTCTL: u32 = 0x010;
const GINTSTS: u32 = 0x014;
const GINTMSK: u32 = 0x018;
const GRXSTSP: u32 = 0x020;
const GRXFSIZ: u32 = 0x024;
const DIEPTXF0: u32 = 0x028;
const GCCFG: u32 = 0x038;
const CID: u32 = 0x03c;
/// Hardware configuration of the core, which RM0383 omits and the driver reads.
///
/// It holds the width of an interface that a full-speed core lacks.
const GHWCFG4: u32 = 0x050;
const DIEPTXF1: u32 = 0x104;
const DCFG: u32 = 0x800;
const DCTL: u32 = 0x804;
const DSTS: u32 = 0x808;
const DIEPMSK: u32 = 0x810;
const DOEPMSK: u32 = 0x814;
const DAINT: u32 = 0x818;
const DAINTMSK: u32 = 0x81c;
const DIEPEMPMSK: u32 = 0x834;
const IN: u32 = 0x900;
const OUT: u32 = 0xb00;
const PCGCCTL: u32 = 0xe00;
const FIFO: u32 = 0x1000;

/// Bits of GINTSTS.
const RXFLVL: u32 = 1 << 4;
const NPTXFE: u32 = 1 << 5;
const USBSUSP: u32 = 1 << 11;
const USBRST: u32 = 1 << 12;
const ENUMDNE: u32 = 1 << 13;
const IEPINT: u32 = 1 << 18;
const OEPINT: u32 = 1 << 19;
const WKUPINT: u32 = 1 << 31;
/// Bits of GINTSTS that stay set until they are cleared.
const STANDING: u32 = WKUPINT | 1 << 30 | ENUMDNE | USBRST | USBSUSP | 1 << 3;

/// Bits of an endpoint's control register.
const USBAEP: u32 = 1 << 15;
const NAKSTS: u32 = 1 << 17;
const STALL: u32 = 1 << 21;
const CNAK: u32 = 1 << 26;
const SNAK: u32 = 1 << 27;
const SD0PID: u32 = 1 << 28;
const SODDFRM: u32 = 1 << 29;
const EPDIS: u32 = 1 << 30;
const EPENA: u32 = 1 << 31;

/// Place of a FIFO that was not set up: beyond the memory.
const UNPLACED: u32 = 0x0200_0200;

/// Bits of an endpoint's interrupts: transfer complete, disabled, SETUP done, FIFO empty.
const XFRC: u32 = 1;
const EPDISD: u32 = 1 << 1;
const STUP: u32 = 1 << 3;
const TXFE: u32 = 1 << 7;

/// Values of PKTSTS.
const OUT_DATA: u32 = 0b0010;
const OUT_DONE: u32 = 0b0011;
const SETUP_DONE: u32 = 0b0100;
const SETUP_DATA: u32 = 0b0110;

/// One direction of an endpoint.
#[derive(Clone, Default)]
struct Endpoint {
    /// MPSIZ, USBAEP, NAKSTS, EPTYP, STALL, TXFNUM, EPENA.
    ctl: u32,
    int: u32,
    tsiz: u32,
    /// Whether the next data are DATA1.
    data1: bool,
}

impl Endpoint {
    fn is(&self, bit: u32) -> bool {
        self.ctl & bit != 0
    }

    /// Reduces XFRSIZ and PKTCNT by a packet of `bytes` bytes.
    fn moved(&mut self, bytes: usize) {
        let left = (self.tsiz & 0x7_ffff).saturating_sub(bytes as u32);
        let packets = (self.tsiz >> 19 & 0x3ff).saturating_sub(1);
        self.tsiz = self.tsiz & 0x6000_0000 | packets << 19 | left;
        if packets == 0 {
            self.ctl = self.ctl & !EPENA | NAKSTS;
        }
    }
}

/// Entry of the receive FIFO.
struct Entry {
    status: u32,
    words: VecDeque<u32>,
}

/// OTG core with its registers and FIFOs.
pub struct Otg {
    gahbcfg: u32,
    gusbcfg: u32,
    gintsts: u32,
    gintmsk: u32,
    gccfg: u32,
    grxfsiz: u32,
    dieptxf: [u32; ENDPOINTS],
    dcfg: u32,
    dctl: u32,
    diepmsk: u32,
    doepmsk: u32,
    daintmsk: u32,
    diepempmsk: u32,
    suspended: bool,
    ins: [Endpoint; ENDPOINTS],
    outs: [Endpoint; ENDPOINTS],
    transmit: [VecDeque<u32>; ENDPOINTS],
    receive: VecDeque<Entry>,
    /// Unread words of the entry that was popped last.
    popped: VecDeque<u32>,
    /// Device address until the status stage of SET_ADDRESS is over.
    former: Option<u32>,
}

impl Default for Otg {
    fn default() -> Self {
        let mut otg = Self {
            gahbcfg: 0,
            gusbcfg: 0x1440,
            gintsts: 0,
            gintmsk: 0,
            gccfg: 0,
            grxfsiz: 0x200,
            dieptxf: [UNPLACED; ENDPOINTS],
            dcfg: 0x0220_0000,
            dctl: 0,
            diepmsk: 0,
            doepmsk: 0,
            daintmsk: 0,
            diepempmsk: 0,
            suspended: false,
            ins: Default::default(),
            outs: Default::default(),
            transmit: Default::default(),
            receive: VecDeque::new(),
            popped: VecDeque::new(),
            former: None,
        };
        // Endpoint 0 always exists, and endpoints answer NAK by default.
        for endpoint in otg.ins.iter_mut().chain(&mut otg.outs) {
            endpoint.ctl |= NAKSTS;
        }
        (otg.ins[0].ctl, otg.outs[0].ctl) = (USBAEP | NAKSTS, USBAEP | NAKSTS);
        otg
    }
}

impl Otg {
    /// Whether the core requests its interrupt.
    pub fn interrupt(&self) -> bool {
        self.gahbcfg & 1 == 1 && self.status() & self.gintmsk != 0
    }

    /// Value of GINTSTS.
    fn status(&self) -> u32 {
        let asked = self.daint() & self.daintmsk;
        let flag = |set: bool, bit: u32| if set { bit } else { 0 };
        self.gintsts
            | NPTXFE
            | flag(!self.receive.is_empty(), RXFLVL)
            | flag(asked & 0xffff != 0, IEPINT)
            | flag(asked >> 16 != 0, OEPINT)
    }

    /// Endpoints with an interrupt: IN in the lower half, OUT in the upper.
    fn daint(&self) -> u32 {
        let asks = |i: usize| {
            let empty = self.transmit[i].is_empty() && self.diepempmsk >> i & 1 == 1;
            let ins = self.ins[i].int & self.diepmsk != 0 || empty;
            let outs = self.outs[i].int & self.doepmsk != 0;
            u32::from(ins) << i | u32::from(outs) << (16 + i)
        };
        (0..ENDPOINTS).map(asks).sum()
    }

    /// Reads the register at `offset`; `frame` is the host's frame number.
    pub fn read(&mut self, offset: u32, frame: u32) -> Outcome<u32> {
        Ok(match offset {
            GAHBCFG => self.gahbcfg,
            GUSBCFG => self.gusbcfg,
            // AHBIDL: resets and flushes complete at once.
            GRSTCTL => 1 << 31,
            GINTSTS => self.status(),
            GINTMSK => self.gintmsk,
            GRXSTSP => self.pop()?,
            GRXFSIZ => self.grxfsiz,
            DIEPTXF0 => self.dieptxf[0],
            DIEPTXF1..0x110 => self.dieptxf[1 + (offset - DIEPTXF1) as usize / 4],
            GCCFG => self.gccfg,
            CID => 0x1200,
            GHWCFG4 => 0x0ff0_8030,
            DCFG => self.dcfg,
            DCTL => self.dctl,
            // Full speed; FNSOF.
            DSTS => u32::from(self.suspended) | 0b11 << 1 | (frame & 0x3fff) << 8,
            DIEPMSK => self.diepmsk,
            DOEPMSK => self.doepmsk,
            DAINT => self.daint(),
            DAINTMSK => self.daintmsk,
            DIEPEMPMSK => self.diepempmsk,
            PCGCCTL => 0,
            FIFO..0x5000 => self.popped.pop_front().ok_or("more words than the packet has")?,
            IN..OUT | OUT..0xd00 => return self.read_endpoint(offset),
            _ => return Err(UNMODELLED.into()),
        })
    }

    fn read_endpoint(&self, offset: u32) -> Outcome<u32> {
        let (i, register) = (((offset & 0x1ff) % 0x100 / 0x20) as usize, offset & 0x1f);
        let ways = if offset < OUT { &self.ins } else { &self.outs };
        let endpoint = ways.get(i).ok_or(UNMODELLED)?;
        Ok(match register {
            // DPID, which endpoint 0 does not have.
            0x00 => endpoint.ctl | u32::from(endpoint.data1 && i > 0) << 16,
            // TXFE follows the FIFO.
            0x08 if offset < OUT && self.transmit[i].is_empty() => endpoint.int | TXFE,
            0x08 => endpoint.int,
            0x10 => endpoint.tsiz,
            0x18 if offset < OUT => self.depth(i) - self.transmit[i].len() as u32,
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Size of an IN endpoint's FIFO, words.
    fn depth(&self, i: usize) -> u32 {
        self.dieptxf[i] >> 16
    }

    /// Pops an entry of the receive FIFO and returns its status.
    fn pop(&mut self) -> Outcome<u32> {
        if !self.popped.is_empty() {
            return Err("popped before all words of the last packet are read".into());
        }
        let Entry { status, words } = self.receive.pop_front().ok_or("the FIFO is empty")?;
        self.popped = words;
        // These two entries carry no data; popping them raises an interrupt (§22.17.5).
        let i = (status & 0xf) as usize;
        match status >> 17 & 0xf {
            SETUP_DONE => self.outs[i].int |= STUP,
            OUT_DONE => self.outs[i].int |= XFRC,
            _ => {}
        }
        Ok(status)
    }

    /// Writes the register at `offset`; `clock` is whether the core has its 48 MHz.
    pub fn write(&mut self, offset: u32, value: u32, clock: bool) -> Outcome {
        match offset {
            // GINT, TXFELVL
            GAHBCFG if value & !0x81 != 0 => return Err(UNMODELLED.into()),
            GAHBCFG => self.gahbcfg = value,
            // FHMOD must not be set; FDMOD must.
            GUSBCFG if value >> 29 & 3 != 2 => {
                return Err("device mode is not forced (FDMOD); the ID pin is not modelled".into());
            }
            GUSBCFG => self.gusbcfg = value,
            GRSTCTL => return self.flush(value),
            GINTSTS => self.gintsts &= !(value & STANDING),
            GINTMSK => self.gintmsk = value,
            GRXFSIZ => self.grxfsiz = value & 0xffff,
            DIEPTXF0 => return self.place(0, value),
            DIEPTXF1..0x110 => return self.place(1 + (offset - DIEPTXF1) as usize / 4, value),
            GCCFG if !clock => return Err("without a clock of 48 MHz".into()),
            // VBUSBSEN, VBUSASEN: the board does not wire VBUS to PA9. PWRDWN and NOVBUSSENS.
            GCCFG if value & !(1 << 21 | 1 << 16) != 0 => return Err(UNMODELLED.into()),
            GCCFG => self.gccfg = value,
            DCFG => {
                let (before, now) = (self.dcfg >> 4 & 0x7f, value >> 4 & 0x7f);
                if value & 3 != 3 {
                    return Err("not full speed with the internal transceiver (DSPD)".into());
                }
                self.former = (now != before && now != 0).then_some(before);
                self.dcfg = value;
            }
            // SDIS; remote wake-up, test modes and global NAKs are not modelled.
            DCTL if value & !2 != 0 => return Err(UNMODELLED.into()),
            DCTL => self.dctl = value,
            DIEPMSK => self.diepmsk = value,
            DOEPMSK => self.doepmsk = value,
            DAINTMSK => self.daintmsk = value,
            DIEPEMPMSK => self.diepempmsk = value,
            FIFO..0x5000 => return self.push((offset / FIFO - 1) as usize, value),
            IN..OUT | OUT..0xd00 => return self.write_endpoint(offset, value),
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }

    /// Checks what an answer needs: the turnaround time, and that no FIFO lies in another one.
    pub fn check_setup(&self) -> Outcome {
        // TRDT for HCLK from 32 MHz on (RM0383 table 113)
        if self.gusbcfg >> 10 & 0xf != 6 {
            return Err("OTG_FS: a turnaround time other than 6 (TRDT)".into());
        }
        let mut end = self.grxfsiz;
        for fifo in self.dieptxf.iter().filter(|fifo| **fifo != UNPLACED) {
            let (start, words) = (fifo & 0xffff, fifo >> 16);
            if start < end {
                return Err(format!(
                    "OTG_FS: a FIFO begins at {start}, the one before ends at {end}"
                ));
            }
            end = start + words;
        }
        Ok(())
    }

    /// Sets address and size of an IN endpoint's FIFO.
    fn place(&mut self, i: usize, value: u32) -> Outcome {
        let (start, words) = (value & 0xffff, value >> 16);
        if start + words > MEMORY || words < 16 || start < self.grxfsiz {
            return Err(format!("a FIFO of {words} words at {start} does not fit {MEMORY} words"));
        }
        self.dieptxf[i] = value;
        Ok(())
    }

    /// Flushes FIFOs on a write to GRSTCTL: RXFFLSH, and TXFFLSH of one FIFO or of all.
    fn flush(&mut self, value: u32) -> Outcome {
        if value & !(0x1f << 6 | 3 << 4) != 0 {
            return Err(UNMODELLED.into());
        }
        if value >> 4 & 1 == 1 {
            self.receive.clear();
            self.popped.clear();
        }
        if value >> 5 & 1 == 1 {
            match (value >> 6 & 0x1f) as usize {
                0x10 => self.transmit.iter_mut().for_each(VecDeque::clear),
                one => self.transmit.get_mut(one).ok_or(UNMODELLED)?.clear(),
            }
        }
        Ok(())
    }

    /// Appends a word to a packet for the host.
    fn push(&mut self, i: usize, word: u32) -> Outcome {
        let wanted = (self.ins[i].tsiz & 0x7_ffff).div_ceil(4) as usize;
        if !self.ins[i].is(EPENA) || self.transmit[i].len() >= wanted {
            return Err("word outside a transfer".into());
        }
        if self.transmit[i].len() as u32 >= self.depth(i) {
            return Err("the FIFO is full".into());
        }
        self.transmit[i].push_back(word);
        Ok(())
    }

    fn write_endpoint(&mut self, offset: u32, value: u32) -> Outcome {
        let (i, register) = (((offset & 0x1ff) % 0x100 / 0x20) as usize, offset & 0x1f);
        let ways = if offset < OUT { &mut self.ins } else { &mut self.outs };
        let endpoint = ways.get_mut(i).ok_or(UNMODELLED)?;
        match register {
            0x00 => control(endpoint, i, value),
            // Writing one clears a flag.
            0x08 => {
                endpoint.int &= !value;
                Ok(())
            }
            0x10 => {
                endpoint.tsiz = value;
                Ok(())
            }
            _ => Err(UNMODELLED.into()),
        }
    }
}

/// Writes an endpoint's control register.
fn control(endpoint: &mut Endpoint, i: usize, value: u32) -> Outcome {
    if i > 0 && value >> 18 & 3 == 1 {
        return Err("isochronous endpoint, which is not modelled".into());
    }
    let before = endpoint.ctl;
    // MPSIZ, EPTYP and TXFNUM are stored, and USBAEP where it is writable; EPENA and NAKSTS have
    // separate set and clear bits.
    let mut ctl =
        value & (0x7ff | 3 << 18 | 0xf << 22 | USBAEP | STALL) | before & (EPENA | NAKSTS);
    if i == 0 {
        // On endpoint 0 STALL can only be set; a SETUP clears it (§22.16.4).
        ctl |= USBAEP | before & STALL;
    }
    if value & CNAK != 0 {
        ctl &= !NAKSTS;
    }
    if value & SNAK != 0 {
        ctl |= NAKSTS;
    }
    if value & (SD0PID | SODDFRM) != 0 && i > 0 {
        endpoint.data1 = value & SODDFRM != 0;
    }
    if value & EPENA != 0 {
        ctl |= EPENA;
    }
    if value & EPDIS != 0 && before & EPENA != 0 {
        ctl &= !EPENA;
        endpoint.int |= EPDISD;
    }
    endpoint.ctl = ctl;
    Ok(())
}
