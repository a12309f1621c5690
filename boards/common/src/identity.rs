//! Who a board is.

use taxel::units::FullScale;
use taxel::wire::message::Identity;

/// Which build this is, as whoever built it called it.
pub const BUILD: &str = match option_env!("TAXEL_BUILD") {
    Some(build) => build,
    None => "unknown",
};

/// A board by its name in `boards/` and its chip's serial number. A name that is too long is left out.
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
        build: BUILD.try_into().unwrap_or_default(),
        scan_hz,
        full_scale,
        tick_hz,
    }
}
