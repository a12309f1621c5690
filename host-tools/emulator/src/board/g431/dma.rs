//! DMA1 and its request multiplexer (RM0440 §12, §13).
//!
//! A transfer completes at its request, because other bus masters are not modelled.

use super::names::peripheral;
use crate::board::chip::Transfer;
use crate::board::{Outcome, UNMODELLED};

/// Number of DMA1's channels.
pub const CHANNELS: usize = 6;
/// Number of the multiplexer's channels, with DMA2's.
const MULTIPLEXED: usize = 12;

/// Flags of a channel in ISR; the first is set while one of the others is.
const ANY: u32 = 1;
const COMPLETE: u32 = 2;
const HALF: u32 = 4;
/// Bits of CCR that may change while the channel is enabled: EN and the interrupts' enables.
const FREE: u32 = 0xf;

#[derive(Clone, Copy, Default)]
struct Channel {
    ccr: u32,
    cndtr: u32,
    cpar: u32,
    cmar: u32,
    /// Number of transfers in a turn; `done` of them are complete.
    turn: u32,
    done: u32,
}

/// DMA1 with DMAMUX1.
#[derive(Default)]
pub struct Dma {
    channels: [Channel; CHANNELS],
    /// Flags of ISR without [`ANY`].
    isr: u32,
    requests: [u32; MULTIPLEXED],
}

impl Dma {
    /// Whether a channel requests its interrupt.
    pub fn interrupt(&self, channel: usize) -> bool {
        self.isr >> (4 * channel) & self.channels[channel].ccr & 0xe != 0
    }

    /// Enabled channel that serves a request.
    pub fn served_by(&self, request: u32) -> Option<usize> {
        (0..CHANNELS)
            .find(|i| self.requests[*i] & 0x7f == request && self.channels[*i].ccr & 1 == 1)
    }

    /// Next transfer of a channel, and whether it is the last of a turn; `None` if there is none
    /// left.
    pub fn take(&mut self, index: usize) -> Outcome<Option<(Transfer, bool)>> {
        let channel = &mut self.channels[index];
        if channel.cndtr == 0 {
            return Ok(None);
        }
        let ccr = channel.ccr;
        let size = 1 << (ccr >> 8 & 3);
        // Not modelled: MEM2MEM, PINC, different sizes.
        if ccr >> 14 & 1 == 1 || ccr >> 6 & 1 == 1 || ccr >> 10 & 3 != ccr >> 8 & 3 {
            return Err(format!("CCR = {ccr:#x}: a mode that is not modelled"));
        }
        let step = if ccr >> 7 & 1 == 1 { size * channel.done } else { 0 };
        let transfer = Transfer {
            register: channel.cpar,
            memory: channel.cmar + step,
            size,
            to_peripheral: ccr >> 4 & 1 == 1,
        };
        channel.done += 1;
        channel.cndtr -= 1;
        let mut flags = 0;
        if channel.done == channel.turn / 2 {
            flags |= HALF;
        }
        let last = channel.cndtr == 0;
        if last {
            flags |= COMPLETE;
            // CIRC
            if ccr >> 5 & 1 == 1 {
                (channel.cndtr, channel.done) = (channel.turn, 0);
            }
        }
        if flags != 0 {
            self.isr |= flags << (4 * index);
        }
        Ok(Some((transfer, last)))
    }

    /// Reads DMA1's register at `offset`.
    pub fn read(&self, offset: u32) -> Outcome<u32> {
        if offset == 0 {
            let set = (0..CHANNELS).filter(|i| self.isr >> (4 * i) & 0xe != 0);
            return Ok(set.fold(self.isr, |isr, i| isr | ANY << (4 * i)));
        }
        let (channel, register) = place(offset).ok_or(UNMODELLED)?;
        let channel = &self.channels[channel];
        Ok([channel.ccr, channel.cndtr, channel.cpar, channel.cmar][register])
    }

    /// Writes the register at `offset`.
    pub fn write(&mut self, offset: u32, value: u32) -> Outcome {
        if offset == 4 {
            // Clearing the first flag of a channel clears the others.
            let all = (0..CHANNELS).filter(|i| value >> (4 * i) & ANY == 1);
            self.isr &= !all.fold(value, |value, i| value | 0xf << (4 * i));
            return Ok(());
        }
        let (index, register) = place(offset).ok_or(UNMODELLED)?;
        let channel = &mut self.channels[index];
        let enabled = channel.ccr & 1 == 1;
        if enabled && register > 0 {
            return Err("written while the channel is enabled".into());
        }
        match register {
            0 => {
                if enabled && value & 1 == 1 && (value ^ channel.ccr) & !FREE != 0 {
                    return Err("written while the channel is enabled".into());
                }
                if !enabled && value & 1 == 1 {
                    let part = (1 << (value >> 8 & 3)) - 1;
                    if (channel.cpar | channel.cmar) & part != 0 {
                        // The chip ignores the low bits of the address (RM0440, DMA_CPARx).
                        return Err(format!(
                            "an address that does not fit the size, which is {UNMODELLED}"
                        ));
                    }
                    (channel.turn, channel.done) = (channel.cndtr, 0);
                }
                channel.ccr = value;
            }
            1 => channel.cndtr = value & 0xffff,
            2 => channel.cpar = value,
            _ => channel.cmar = value,
        }
        Ok(())
    }

    /// Reads the multiplexer's register at `offset`.
    pub fn read_multiplexer(&self, offset: u32) -> Outcome<u32> {
        self.requests.get(offset as usize / 4).copied().ok_or_else(|| UNMODELLED.into())
    }

    /// Writes the register at `offset`.
    pub fn write_multiplexer(&mut self, offset: u32, value: u32) -> Outcome {
        // Synchronisation and events are not modelled.
        if value & !0x7f != 0 {
            return Err(UNMODELLED.into());
        }
        *self.requests.get_mut(offset as usize / 4).ok_or(UNMODELLED)? = value;
        Ok(())
    }
}

/// Channel and register at an offset in DMA1.
fn place(offset: u32) -> Option<(usize, usize)> {
    let at = offset.checked_sub(8)?;
    let (channel, register) = (at as usize / 20, at as usize % 20 / 4);
    (channel < CHANNELS && register < 4).then_some((channel, register))
}

/// Number of a request in the multiplexer's list.
///
/// # Panics
/// If there is no such request, which is a mistake of this program.
pub fn request(of: &str, signal: &str) -> u32 {
    peripheral(of)
        .dma_channels
        .iter()
        .find(|channel| channel.signal == signal)
        .and_then(|channel| channel.request)
        .unwrap_or_else(|| panic!("{of} has no request {signal}"))
}
