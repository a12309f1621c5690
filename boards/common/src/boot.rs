//! What a reset leaves standing: the last panic, and a wish to go to the ROM bootloader.
//!
//! Both lie in RAM that start-up does not touch. After power-up it holds anything, so that each is known
//! by a mark.

use core::cell::UnsafeCell;
use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr;

use cortex_m::peripheral::SCB;
use heapless::String;

/// Longest message that is kept.
pub const MESSAGE: usize = 96;

const PANICKED: u32 = 0x7061_6e63;
const BOOTLOADER: u32 = 0x6466_7521;

struct Kept {
    mark: u32,
    length: usize,
    text: [u8; MESSAGE],
}

struct Uninit(UnsafeCell<MaybeUninit<Kept>>);

// SAFETY: touched only before the first task runs and, with every interrupt off, on the way to a reset.
unsafe impl Sync for Uninit {}

#[unsafe(link_section = ".uninit.boot")]
static KEPT: Uninit = Uninit(UnsafeCell::new(MaybeUninit::uninit()));

fn kept() -> *mut Kept {
    KEPT.0.get().cast()
}

/// Call first of all in `main`, before a clock is set: goes to the ROM bootloader if that is what the
/// last reset was for; else the last panic, once.
///
/// # Safety
/// `rom` is where the chip's ROM bootloader has its vector table, and nothing runs yet.
pub unsafe fn resume(rom: usize) -> Option<String<MESSAGE>> {
    // SAFETY: plain words, valid whatever they hold; nothing else runs.
    let mark = unsafe { ptr::read_volatile(&raw const (*kept()).mark) };
    // SAFETY: as above.
    unsafe { ptr::write_volatile(&raw mut (*kept()).mark, 0) };
    match mark {
        BOOTLOADER => {
            // SAFETY: the caller says so; the chip is as reset left it.
            unsafe { cortex_m::asm::bootload(ptr::with_exposed_provenance(rom)) }
        }
        PANICKED => {
            // SAFETY: the mark says that both were written.
            let (length, text) = unsafe { ((*kept()).length, (*kept()).text) };
            let text = text.get(..length.min(MESSAGE)).unwrap_or_default();
            let valid = text.utf8_chunks().next().map_or("", |chunk| chunk.valid());
            String::try_from(valid).ok()
        }
        _ => None,
    }
}

/// Resets into the ROM bootloader: there `dfu-util` finds it.
pub fn enter_bootloader() -> ! {
    cortex_m::interrupt::disable();
    // SAFETY: nothing runs any more.
    unsafe { ptr::write_volatile(&raw mut (*kept()).mark, BOOTLOADER) };
    SCB::sys_reset()
}

/// Writes the message down and resets; `info` of the next start shows it.
pub fn panic(info: &PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    // SAFETY: nothing runs any more.
    let kept = unsafe { &mut *kept().cast::<MaybeUninit<Kept>>() };
    let kept = kept.write(Kept { mark: 0, length: 0, text: [0; MESSAGE] });
    // A message that is too long is cut.
    let _ = match info.location() {
        Some(at) => write!(Cut(kept), "{}:{} {}", at.file(), at.line(), info.message()),
        None => write!(Cut(kept), "{}", info.message()),
    };
    kept.mark = PANICKED;
    SCB::sys_reset()
}

struct Cut<'k>(&'k mut Kept);

impl Write for Cut<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for byte in text.bytes() {
            let place = self.0.text.get_mut(self.0.length).ok_or(fmt::Error)?;
            *place = byte;
            self.0.length += 1;
        }
        Ok(())
    }
}
