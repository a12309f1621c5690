//! Ctrl-C, as a question that loops ask.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Set once the user has had enough.
#[derive(Clone)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// From now on Ctrl-C and termination only set the flag; a second one ends the program at once.
    ///
    /// # Errors
    /// The operating system does not allow it.
    pub fn watch() -> anyhow::Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        let set = Arc::clone(&flag);
        ctrlc::set_handler(move || {
            if set.swap(true, Ordering::Relaxed) {
                // What a shell expects of a program that Ctrl-C ended.
                std::process::exit(130);
            }
        })?;
        Ok(Self(flag))
    }

    /// The flag itself, for libraries that look at one.
    pub fn flag(&self) -> &AtomicBool {
        &self.0
    }

    /// Whether Ctrl-C was pressed.
    pub fn came(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
