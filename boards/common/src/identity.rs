//! Identity of a board.

use core::hint::black_box;

use heapless::String;
use taxel::units::FullScale;
use taxel::wire::message::Identity;

/// Name of the build, from the variable `TAXEL_BUILD`, with spaces behind it.
pub const BUILD: &str = match option_env!("TAXEL_BUILD") {
    Some(build) => build,
    None => "unknown",
};

/// Identity of a board, by its name in `boards/` and its chip's serial number.
///
/// A text that is too long is left empty.
#[must_use]
pub fn identity(
    board: &str,
    serial: &str,
    scan_hz: u16,
    full_scale: FullScale,
    tick_hz: u32,
) -> Identity {
    Identity {
        board: board.try_into().unwrap_or_default(),
        serial: serial.try_into().unwrap_or_default(),
        build: build(),
        scan_hz,
        full_scale,
        tick_hz,
    }
}

/// Returns the name of the build.
///
/// The compiler would write a known text as immediate values, and each build's name would move the
/// code behind it, and so its cycles.
#[inline(never)]
fn build<const N: usize>() -> String<N> {
    black_box(BUILD).trim_ascii_end().try_into().unwrap_or_default()
}
