//! State kept over a reset: the place of the last panic, and a request for the ROM bootloader.
//!
//! Both are in RAM that start-up does not touch. A mark identifies each, because RAM holds anything
//! after power-up.

use core::arch::naked_asm;
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::panic::Location;
use core::ptr;

use cortex_m::peripheral::SCB;
use heapless::String;

/// Longest kept message, bytes.
pub const MESSAGE: usize = 96;

const PANICKED: u32 = 0x7061_6e63;
const BOOTLOADER: u32 = 0x6466_7521;

struct Kept {
    mark: u32,
    length: usize,
    text: [u8; MESSAGE],
}

struct Uninit(UnsafeCell<MaybeUninit<Kept>>);

// SAFETY: touched only before the first task runs and, with every interrupt off, on the way to a
// reset.
unsafe impl Sync for Uninit {}

#[unsafe(link_section = ".uninit.boot")]
static KEPT: Uninit = Uninit(UnsafeCell::new(MaybeUninit::uninit()));

fn kept() -> *mut Kept {
    KEPT.0.get().cast()
}

/// Enters the ROM bootloader if the last reset was for it, else returns the last panic, once.
///
/// Call it first in `main`, before a clock is set.
///
/// # Safety
/// `rom` is the address of the ROM bootloader's vector table, and nothing runs yet.
pub unsafe fn resume(rom: usize) -> Option<String<MESSAGE>> {
    // SAFETY: plain words, valid with any content; nothing else runs.
    let mark = unsafe { ptr::read_volatile(&raw const (*kept()).mark) };
    // SAFETY: as above.
    unsafe { ptr::write_volatile(&raw mut (*kept()).mark, 0) };
    match mark {
        BOOTLOADER => {
            // SAFETY: the caller promises the address; the chip is as reset left it but for VTOR,
            // which start-up code has pointed at this program's vectors.
            unsafe {
                (*SCB::PTR).vtor.write(rom as u32);
                cortex_m::asm::bootload(ptr::with_exposed_provenance(rom))
            }
        }
        PANICKED => {
            // SAFETY: the mark shows that both were written.
            let (length, text) = unsafe { ((*kept()).length, (*kept()).text) };
            let text = text.get(..length.min(MESSAGE)).unwrap_or_default();
            let valid = text.utf8_chunks().next().map_or("", |chunk| chunk.valid());
            String::try_from(valid).ok()
        }
        _ => None,
    }
}

/// Resets into the ROM bootloader, where `dfu-util` finds the chip.
pub fn enter_bootloader() -> ! {
    cortex_m::interrupt::disable();
    // SAFETY: nothing runs any more.
    unsafe { ptr::write_volatile(&raw mut (*kept()).mark, BOOTLOADER) };
    SCB::sys_reset()
}

/// Records the place of a panic and resets; the next start reports it.
///
/// There is no message, because one that is read brings the code that formats all of them.
#[inline(never)]
pub fn panic(place: Option<&Location>) -> ! {
    let mut note = Note::default();
    if let Some(at) = place {
        // The end of a path identifies the file, its beginning does not.
        let file = at.file().as_bytes();
        note.write(file.get(file.len().saturating_sub(MESSAGE / 2)..).unwrap_or_default());
        note.write(b":");
        note.decimal(at.line());
    }
    note.reset()
}

/// Handles a hard fault: a wrong access, or a stack overflow into addresses without memory.
///
/// With an overflow the stack pointer is outside the memory, and the stacked registers are lost.
///
/// # Safety
/// Only the hardware calls it.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() {
    naked_asm!(
        "mov r3, sp",
        "ldr r2, =_stack_start",
        "mov sp, r2",
        // A push that no longer fits may leave room for the frame.
        "ldr r2, =_stack_end + 128",
        "cmp r3, r2",
        "blo {overflow}",
        // Program counter and link register of the exception's frame.
        "ldr r0, [r3, #24]",
        "ldr r1, [r3, #20]",
        "b {fault}",
        overflow = sym overflow,
        fault = sym fault,
    )
}

/// Records a stack overflow, and resets.
extern "C" fn overflow() -> ! {
    let mut note = Note::default();
    note.write(b"stack overflow");
    note.reset()
}

/// Records a fault's program counter and link register, and resets.
extern "C" fn fault(pc: u32, lr: u32) -> ! {
    let mut note = Note::default();
    note.write(b"fault at 0x");
    note.hexadecimal(pc);
    note.write(b", called from 0x");
    note.hexadecimal(lr);
    note.reset()
}

/// Text kept over the reset.
struct Note {
    text: [u8; MESSAGE],
    length: usize,
}

impl Default for Note {
    fn default() -> Self {
        Self { text: [0; MESSAGE], length: 0 }
    }
}

impl Note {
    /// Appends bytes, cut at [`MESSAGE`].
    fn write(&mut self, bytes: &[u8]) {
        let room = self.text.get_mut(self.length..).unwrap_or_default();
        room.iter_mut().zip(bytes).for_each(|(place, byte)| *place = *byte);
        self.length += room.len().min(bytes.len());
    }

    fn decimal(&mut self, number: u32) {
        let mut unit = 1_000_000_000;
        while unit > 1 && number / unit == 0 {
            unit /= 10;
        }
        while unit > 0 {
            self.write(&[b'0' + (number / unit % 10) as u8]);
            unit /= 10;
        }
    }

    fn hexadecimal(&mut self, number: u32) {
        for nibble in (0..8).rev().map(|place| (number >> (4 * place) & 0xF) as u8) {
            self.write(&[if nibble < 10 { b'0' + nibble } else { b'a' - 10 + nibble }]);
        }
    }

    fn reset(self) -> ! {
        cortex_m::interrupt::disable();
        let Self { text, length } = self;
        // SAFETY: nothing runs any more.
        unsafe { ptr::write_volatile(kept(), Kept { mark: PANICKED, length, text }) };
        SCB::sys_reset()
    }
}
