//! The page in the user's browser.

use std::env::var_os;

use crate::output;

/// Opens the page, if there is a display here and the user sits at it.
pub fn open(url: &str) {
    if !display() {
        return;
    }
    if let Err(error) = open::that_detached(url) {
        output::note(format_args!("no browser could be opened ({error}): open {url}"));
    }
}

/// Over SSH even a display that is there is another one than the user's own browser has.
fn display() -> bool {
    let set = |name| var_os(name).is_some_and(|value| !value.is_empty());
    let has_one =
        !cfg!(all(unix, not(target_os = "macos"))) || set("DISPLAY") || set("WAYLAND_DISPLAY");
    has_one && !set("SSH_CONNECTION")
}
