//! Bus side of the OTG core: answers to transactions.

use super::{
    ENDPOINTS, ENUMDNE, EPENA, Entry, NAKSTS, OUT_DATA, OUT_DONE, Otg, SETUP_DATA, SETUP_DONE,
    STALL, USBAEP, USBRST, USBSUSP, WKUPINT, XFRC,
};
use crate::board::Outcome;
use crate::board::usb::{Answer, Device};

/// Codes of DATA0 and DATA1 in the receive FIFO.
const PIDS: [u32; 2] = [0b00, 0b10];

impl Otg {
    /// Index of an endpoint; `None` if the device has another address or lacks the endpoint.
    fn addressed(&self, address: u8, number: u8) -> Option<usize> {
        let own = self.former.unwrap_or(self.dcfg >> 4 & 0x7f);
        let there = own == u32::from(address) && usize::from(number) < ENDPOINTS;
        there.then_some(usize::from(number))
    }

    /// Answer of an IN endpoint; ACK stands for data.
    fn sends(&self, i: usize) -> Answer {
        let endpoint = &self.ins[i];
        let filled = 4 * self.transmit[i].len() >= (endpoint.tsiz & 0x7_ffff) as usize;
        match () {
            () if !endpoint.is(USBAEP) => Answer::Silence,
            () if endpoint.is(STALL) => Answer::Stall,
            () if endpoint.is(NAKSTS) || !endpoint.is(EPENA) || !filled => Answer::Nak,
            () => Answer::Ack,
        }
    }

    /// Answer of an OUT endpoint.
    fn receives(&self, i: usize) -> Answer {
        let endpoint = &self.outs[i];
        match () {
            () if !endpoint.is(USBAEP) => Answer::Silence,
            () if endpoint.is(STALL) => Answer::Stall,
            () if endpoint.is(NAKSTS) => Answer::Nak,
            () => Answer::Ack,
        }
    }

    /// Appends a packet and its end marker to the receive FIFO.
    fn put(&mut self, i: usize, pid: u32, data: &[u8], data_status: u32, done: u32) -> Outcome {
        let words = data.chunks(4).map(|bytes| {
            let mut word = [0; 4];
            word.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
            u32::from_le_bytes(word)
        });
        let status = i as u32 | (data.len() as u32) << 4 | pid << 15;
        self.receive
            .push_back(Entry { status: status | data_status << 17, words: words.collect() });
        self.receive.push_back(Entry { status: i as u32 | done << 17, words: Default::default() });
        let used: usize = self.receive.iter().map(|entry| 1 + entry.words.len()).sum();
        if used > self.grxfsiz as usize {
            return Err(format!("{used} words exceed the receive FIFO of {}", self.grxfsiz));
        }
        Ok(())
    }
}

impl Device for Otg {
    fn is_attached(&self) -> bool {
        // PWRDWN (transceiver on), NOVBUSSENS, SDIS.
        self.gccfg >> 16 & 1 == 1 && self.gccfg >> 21 & 1 == 1 && self.dctl >> 1 & 1 == 0
    }

    fn bus_reset(&mut self) {
        for i in 0..ENDPOINTS {
            for endpoint in [&mut self.ins[i], &mut self.outs[i]] {
                endpoint.ctl |= NAKSTS;
                if i > 0 {
                    endpoint.ctl &= !USBAEP;
                }
            }
        }
        self.former = None;
        self.gintsts |= USBRST;
    }

    fn bus_reset_over(&mut self) {
        self.gintsts |= ENUMDNE;
    }

    fn suspend(&mut self, suspended: bool) {
        self.suspended = suspended;
        self.gintsts |= if suspended { USBSUSP } else { WKUPINT };
    }

    fn ready_to_send(&self, address: u8, number: u8) -> bool {
        self.addressed(address, number)
            .is_some_and(|i| matches!(self.sends(i), Answer::Ack | Answer::Stall))
    }

    fn ready_to_receive(&self, address: u8, number: u8) -> bool {
        self.addressed(address, number)
            .is_some_and(|i| matches!(self.receives(i), Answer::Ack | Answer::Stall))
    }

    fn setup(&mut self, address: u8, data: [u8; 8]) -> Outcome<Answer> {
        let Some(i) = self.addressed(address, 0) else { return Ok(Answer::Silence) };
        for endpoint in [&mut self.ins[i], &mut self.outs[i]] {
            endpoint.ctl = endpoint.ctl & !STALL | NAKSTS;
            endpoint.data1 = true;
        }
        self.put(i, PIDS[0], &data, SETUP_DATA, SETUP_DONE)?;
        Ok(Answer::Ack)
    }

    fn out(&mut self, address: u8, number: u8, data1: bool, data: &[u8]) -> Outcome<Answer> {
        let Some(i) = self.addressed(address, number) else { return Ok(Answer::Silence) };
        let answer = self.receives(i);
        // A repeated packet is acknowledged and dropped.
        if answer != Answer::Ack || self.outs[i].data1 != data1 {
            return Ok(answer);
        }
        self.put(i, PIDS[usize::from(data1)], data, OUT_DATA, OUT_DONE)?;
        self.outs[i].data1 = !data1;
        self.outs[i].moved(data.len());
        Ok(Answer::Ack)
    }

    fn take(&mut self, address: u8, number: u8) -> Outcome<Answer> {
        let Some(i) = self.addressed(address, number) else { return Ok(Answer::Silence) };
        let answer = self.sends(i);
        if answer != Answer::Ack {
            return Ok(answer);
        }
        self.check_setup()?;
        let length = (self.ins[i].tsiz & 0x7_ffff) as usize;
        let data = self.transmit[i].drain(..).flat_map(u32::to_le_bytes).take(length).collect();
        let endpoint = &mut self.ins[i];
        let data1 = endpoint.data1;
        endpoint.data1 = !data1;
        endpoint.moved(length);
        endpoint.int |= XFRC;
        endpoint.ctl &= !EPENA;
        if i == 0 {
            self.former = None;
        }
        Ok(Answer::Data(data1, data))
    }
}
