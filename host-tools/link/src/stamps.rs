//! When a frame was received and when it was scanned, in microseconds since 1970.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use taxel::units::Micros;

use crate::client::Received;
use crate::clock::DeviceClock;

/// The frames of one finger in this host's time. What the wall clock said when it began holds: a clock that is
/// set meanwhile tears no recording apart.
#[derive(Debug)]
pub struct Stamps {
    epoch: (Instant, Duration),
    clock: DeviceClock,
}

impl Default for Stamps {
    fn default() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { epoch: (Instant::now(), unix), clock: DeviceClock::default() }
    }
}

impl Stamps {
    /// Learns from a frame.
    pub fn frame(&mut self, received: &Received) {
        self.clock.frame(received.frame.time, received.at);
    }

    /// Learns from a question and its answer.
    pub fn echo(&mut self, echo: Duration) {
        self.clock.echo(echo);
    }

    /// A moment of this host.
    #[must_use]
    pub fn unix(&self, at: Instant) -> Duration {
        let (began, unix) = self.epoch;
        match at.checked_duration_since(began) {
            Some(since) => unix + since,
            None => unix.saturating_sub(began.saturating_duration_since(at)),
        }
    }

    /// A moment of the finger, and how far off that may be; `None` before its clock is known.
    #[must_use]
    pub fn scanned(&self, device: Micros) -> Option<(Duration, Duration)> {
        let host = self.clock.host(device)?;
        Some((self.unix(host.at), host.error))
    }
}
