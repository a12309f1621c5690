//! DMA2's eight streams in direct mode (RM0383 §9).
//!
//! A transfer completes at its request, because other bus masters are not modelled. FIFO, memory to
//! memory, bursts and double buffers are not modelled either.

use crate::board::chip::Transfer;
use crate::board::{Outcome, UNMODELLED};

/// Number of streams.
pub const STREAMS: usize = 8;
/// Distance between two streams' registers, and offset of the first ones.
const STRIDE: u32 = 0x18;
const FIRST: u32 = 0x10;

/// Flags of a stream: complete, half. TCIE and HTIE are one bit lower in its CR.
const COMPLETE: u32 = 1 << 5;
const HALF: u32 = 1 << 4;
/// First bit of each stream's flags in their register.
const FLAGS: [u32; 4] = [0, 6, 16, 22];

/// Modelled bits of CR: TCIE, HTIE, DIR, CIRC, MINC, PSIZE, MSIZE, PL, CHSEL, EN.
const MODELLED: u32 = 0x0e03_7dd9;

#[derive(Clone, Copy, Default)]
struct Stream {
    cr: u32,
    ndtr: u32,
    par: u32,
    m0ar: u32,
    fcr: u32,
    /// Number of transfers in a turn; `done` of them are complete.
    turn: u32,
    done: u32,
    flags: u32,
}

/// DMA2 with its streams.
#[derive(Default)]
pub struct Dma {
    streams: [Stream; STREAMS],
}

impl Dma {
    /// Whether a stream requests its interrupt.
    pub fn interrupt(&self, stream: usize) -> bool {
        let Stream { cr, flags, .. } = self.streams[stream];
        flags & cr << 1 & (COMPLETE | HALF) != 0
    }

    /// Next transfer of a stream; `None` if it is off, serves another channel, or has none left.
    pub fn take(&mut self, stream: usize, channel: u32) -> Option<Transfer> {
        let stream = &mut self.streams[stream];
        let cr = stream.cr;
        if cr & 1 == 0 || cr >> 25 & 7 != channel || stream.ndtr == 0 {
            return None;
        }
        let size = 1 << (cr >> 11 & 3);
        let step = if cr >> 10 & 1 == 1 { size * stream.done } else { 0 };
        let transfer = Transfer {
            register: stream.par,
            memory: stream.m0ar + step,
            size,
            to_peripheral: cr >> 6 & 1 == 1,
        };
        stream.done += 1;
        stream.ndtr -= 1;
        if stream.done == stream.turn / 2 {
            stream.flags |= HALF;
        }
        if stream.ndtr == 0 {
            stream.flags |= COMPLETE;
            // CIRC restarts the stream; otherwise it disables itself.
            if cr >> 8 & 1 == 1 {
                (stream.ndtr, stream.done) = (stream.turn, 0);
            } else {
                stream.cr &= !1;
            }
        }
        Some(transfer)
    }

    fn flags(&self, first: usize) -> u32 {
        FLAGS.iter().zip(&self.streams[first..]).map(|(at, stream)| stream.flags << at).sum()
    }

    /// Reads the register at `offset`.
    pub fn read(&self, offset: u32) -> Outcome<u32> {
        if offset < FIRST {
            return match offset {
                0x00 => Ok(self.flags(0)),
                0x04 => Ok(self.flags(4)),
                _ => Err("the register is write-only".into()),
            };
        }
        let (stream, register) = place(offset).ok_or(UNMODELLED)?;
        let stream = &self.streams[stream];
        Ok(match register {
            0x00 => stream.cr,
            0x04 => stream.ndtr,
            0x08 => stream.par,
            0x0c => stream.m0ar,
            // FS: the FIFO is empty.
            0x14 => stream.fcr | 4 << 3,
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes the register at `offset`.
    pub fn write(&mut self, offset: u32, value: u32) -> Outcome {
        if let 0x08 | 0x0c = offset {
            let first = if offset == 0x08 { 0 } else { 4 };
            for (at, stream) in FLAGS.iter().zip(&mut self.streams[first..]) {
                stream.flags &= !(value >> at & 0x3d);
            }
            return Ok(());
        }
        let (index, register) = place(offset).ok_or(UNMODELLED)?;
        let stream = &mut self.streams[index];
        let enabled = stream.cr & 1 == 1;
        match register {
            0x00 if value & !MODELLED != 0 => return Err(UNMODELLED.into()),
            0x00 => {
                // Not modelled: memory to memory, and different sizes.
                if value & 1 == 1 && (value >> 6 & 3 > 1 || value >> 11 & 3 != value >> 13 & 3) {
                    return Err(UNMODELLED.into());
                }
                if enabled && value & 1 == 1 && value != stream.cr {
                    return Err("written while the stream is enabled".into());
                }
                if !enabled && value & 1 == 1 {
                    if stream.flags != 0 {
                        return Err(
                            "enabled while flags of the last transfer stand (§9.3.17)".into()
                        );
                    }
                    let part = (1 << (value >> 11 & 3)) - 1;
                    if (stream.par | stream.m0ar) & part != 0 {
                        return Err("enabled with an address that does not fit the size".into());
                    }
                    (stream.turn, stream.done) = (stream.ndtr, 0);
                }
                // A stream that the program stops says that it has ended (§9.3.14).
                if enabled && value & 1 == 0 {
                    stream.flags |= COMPLETE;
                }
                stream.cr = value;
            }
            _ if enabled => return Err("written while the stream is enabled".into()),
            0x04 => stream.ndtr = value & 0xffff,
            0x08 => stream.par = value,
            0x0c => stream.m0ar = value,
            // DMDIS, FEIE
            0x14 if value & (1 << 2 | 1 << 7) != 0 => return Err(UNMODELLED.into()),
            0x14 => stream.fcr = value & 3,
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }
}

/// Stream and register at an offset.
fn place(offset: u32) -> Option<(usize, u32)> {
    let at = offset.checked_sub(FIRST)?;
    let stream = (at / STRIDE) as usize;
    (stream < STREAMS).then_some((stream, at % STRIDE))
}
