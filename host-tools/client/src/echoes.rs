//! How long a question to a finger and its answer take, asked now and then beside the stream.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryIter, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::steady::Steady;

/// From one question to the next.
const EVERY: Duration = Duration::from_secs(1);

/// Asks a finger once a second, in a thread of its own: whoever takes the frames must not wait for answers.
/// Dropping it ends it.
pub struct Echoes {
    echoes: Receiver<Duration>,
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Echoes {
    /// Begins.
    #[must_use]
    pub fn of(finger: &Arc<Steady>) -> Self {
        let (echo, echoes) = channel();
        let (stop, stopped) = channel::<()>();
        let finger = Arc::clone(finger);
        let ask = move || {
            loop {
                let answered = finger.client().and_then(|client| client.echo().ok());
                if answered.is_some_and(|took| echo.send(took).is_err())
                    || stopped.recv_timeout(EVERY) != Err(RecvTimeoutError::Timeout)
                {
                    return;
                }
            }
        };
        // A system without a thread left goes without: the finger's clock is then not known.
        let thread = std::thread::Builder::new().name("taxel-echoes".to_owned()).spawn(ask).ok();
        Self { echoes, stop: Some(stop), thread }
    }

    /// The answers since the last call.
    pub fn try_iter(&self) -> TryIter<'_, Duration> {
        self.echoes.try_iter()
    }
}

impl Drop for Echoes {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has nothing more to say.
            let _ = thread.join();
        }
    }
}
