//! Ctrl-C as a flag that loops check, with a deadline for work that cannot.
//!
//! A read of a pipe or a wait for a silent finger sees no flag. The process ends at the deadline
//! all the same, unless the command has said that it finishes its files.

use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use crate::output;

/// Time from Ctrl-C to the end of the process, so that it ends within a second on a busy machine
/// too; held by the tests in `ctrl_c.rs`.
pub const DEADLINE: Duration = Duration::from_millis(700);
/// Longest farewell to a finger after Ctrl-C.
const FAREWELL: Duration = Duration::from_millis(400);
/// Interval at which a farewell is checked for its end.
const LOOK: Duration = Duration::from_millis(5);
/// Exit code of a program that Ctrl-C ended: 128 + SIGINT.
const INTERRUPTED: i32 = 130;

/// Flag that Ctrl-C sets.
#[derive(Clone)]
pub struct Interrupt(Arc<Shared>);

#[derive(Default)]
struct Shared {
    came: AtomicBool,
    work: Mutex<Work>,
}

/// Progress of the command, locked while the deadline ends the process.
#[derive(Default)]
struct Work {
    /// Whether the files are being finished, which no deadline cuts short.
    finishing: bool,
    /// Outcome if the deadline ends the process now.
    outcome: &'static str,
}

impl Interrupt {
    /// Installs the handler: Ctrl-C and termination set the flag; a second one ends the program.
    ///
    /// # Errors
    /// The operating system does not allow it.
    pub fn watch() -> anyhow::Result<Self> {
        let shared = Arc::new(Shared::default());
        let handled = Arc::clone(&shared);
        ctrlc::set_handler(move || {
            if handled.came.swap(true, Ordering::Relaxed) {
                end();
            }
            let at_deadline = Arc::clone(&handled);
            thread::spawn(move || at_deadline.expire());
        })?;
        Ok(Self(shared))
    }

    /// Returns the flag itself, for libraries that check one.
    #[cfg(feature = "full")]
    pub fn flag(&self) -> &AtomicBool {
        &self.0.came
    }

    /// Whether Ctrl-C was pressed.
    pub fn came(&self) -> bool {
        self.0.came.load(Ordering::Relaxed)
    }

    /// Declares that only files are finished from now on, however long that takes.
    pub fn finishing(&self) {
        self.0.work().finishing = true;
    }

    /// Sets the sentence that tells the outcome if the deadline ends the process from now on.
    #[cfg(feature = "full")]
    pub fn outcome(&self, outcome: &'static str) {
        self.0.work().outcome = outcome;
    }

    /// Takes leave of a finger in a thread; after Ctrl-C for at most [`FAREWELL`].
    ///
    /// The values that `leave` owns are dropped there too, because dropping a client or a page
    /// waits for its threads.
    pub fn farewell(&self, leave: impl FnOnce() + Send + 'static) {
        let begun = Instant::now();
        let leaving = thread::spawn(leave);
        let enough = || self.came() && begun.elapsed() >= FAREWELL;
        while !leaving.is_finished() && !enough() {
            thread::sleep(LOOK);
        }
    }
}

impl Shared {
    fn work(&self) -> MutexGuard<'_, Work> {
        self.work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the process at the deadline. The lock makes a command wait that would begin to finish.
    fn expire(&self) {
        thread::sleep(DEADLINE);
        let work = self.work();
        if !work.finishing {
            output::note(format_args!("taxel: interrupted{}", work.outcome));
            end();
        }
    }
}

/// Ends the process, and leaves no half-written file behind.
fn end() -> ! {
    taxel_files::discard_pending();
    exit(INTERRUPTED)
}
