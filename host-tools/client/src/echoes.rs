//! Round-trip times of a link, measured during the stream.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryIter, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::steady::ReconnectingClient;

/// Interval between measurements.
const EVERY: Duration = Duration::from_secs(1);

/// Measures the round trip once a second in its own thread. A measurement waits for its reply,
/// which the thread that takes frames must not. Dropping it stops the thread.
pub struct RoundTrips {
    echoes: Receiver<Duration>,
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl RoundTrips {
    /// Starts measuring.
    #[must_use]
    pub fn of(finger: &Arc<ReconnectingClient>) -> Self {
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
        // Without a thread the finger's clock stays unknown.
        let thread = std::thread::Builder::new().name("taxel-echoes".to_owned()).spawn(ask).ok();
        Self { echoes, stop: Some(stop), thread }
    }

    /// Round-trip times since the last call.
    pub fn try_iter(&self) -> TryIter<'_, Duration> {
        self.echoes.try_iter()
    }
}

impl Drop for RoundTrips {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was reported when it happened.
            let _ = thread.join();
        }
    }
}
