//! Identity of a board.

use taxel::units::FullScale;
use taxel::wire::message::Identity;

/// Name of the build, from the variable `TAXEL_BUILD`.
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
        build: BUILD.try_into().unwrap_or_default(),
        scan_hz,
        full_scale,
        tick_hz,
    }
}
