//! Opens the page in the user's browser.

use std::env::var_os;

use crate::output;

/// Opens the page if this session has a local display.
pub fn open(url: &str) {
    if !display() {
        return;
    }
    if let Err(error) = open::that_detached(url) {
        output::note(format_args!("no browser could be opened ({error}): open {url}"));
    }
}

/// Whether a display is set and the session is local. A display forwarded over SSH is not the one
/// of the user's own browser.
fn display() -> bool {
    let set = |name| var_os(name).is_some_and(|value| !value.is_empty());
    let has_one =
        !cfg!(all(unix, not(target_os = "macos"))) || set("DISPLAY") || set("WAYLAND_DISPLAY");
    has_one && !set("SSH_CONNECTION")
}
