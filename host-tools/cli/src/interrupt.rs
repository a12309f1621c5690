//! Ctrl-C as a flag that loops check.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Flag that Ctrl-C sets.
#[derive(Clone)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Installs the handler: Ctrl-C and termination set the flag; a second one ends the program.
    ///
    /// # Errors
    /// The operating system does not allow it.
    pub fn watch() -> anyhow::Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        let set = Arc::clone(&flag);
        ctrlc::set_handler(move || {
            if set.swap(true, Ordering::Relaxed) {
                // 128 + SIGINT, the exit code of a program that Ctrl-C ended.
                std::process::exit(130);
            }
        })?;
        Ok(Self(flag))
    }

    /// Returns the flag itself, for libraries that check one.
    #[cfg(feature = "full")]
    pub fn flag(&self) -> &AtomicBool {
        &self.0
    }

    /// Whether Ctrl-C was pressed.
    pub fn came(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
