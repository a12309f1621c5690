//! Times of frames in host time, as durations since 1970.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use taxel::units::Micros;

use crate::client::Received;
use crate::clock::DeviceClock;

/// Host times of one finger's frames. The wall clock is read once, so that setting it does not
/// break a recording.
#[derive(Debug)]
pub struct Timestamps {
    epoch: (Instant, Duration),
    clock: DeviceClock,
}

impl Default for Timestamps {
    fn default() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { epoch: (Instant::now(), unix), clock: DeviceClock::default() }
    }
}

impl Timestamps {
    /// Forgets the device's clock, after a reconnect.
    pub fn reconnected(&mut self) {
        self.clock = DeviceClock::default();
    }

    /// Adds a frame.
    pub fn frame(&mut self, received: &Received) {
        self.clock.frame(received.frame.time, received.at);
    }

    /// Adds a round-trip time.
    pub fn echo(&mut self, echo: Duration) {
        self.clock.echo(echo);
    }

    /// Converts a moment of this host.
    #[must_use]
    pub fn unix(&self, at: Instant) -> Duration {
        let (began, unix) = self.epoch;
        match at.checked_duration_since(began) {
            Some(since) => unix + since,
            None => unix.saturating_sub(began.saturating_duration_since(at)),
        }
    }

    /// Converts a moment of the device, with its error bound; `None` before the clock is known.
    #[must_use]
    pub fn scanned(&self, device: Micros) -> Option<(Duration, Duration)> {
        let host = self.clock.host(device)?;
        Some((self.unix(host.at), host.error))
    }
}

#[cfg(test)]
mod tests {
    use taxel::frame::Frame;

    use super::*;

    #[test]
    fn clock_jump_after_reconnect_is_learned() {
        let mut stamps = Timestamps::default();
        let begin = Instant::now();
        // Streams one frame per millisecond, from `device` seconds on, `after` seconds after the
        // beginning.
        let stream = |stamps: &mut Timestamps, device: u64, after: u64, frames: u64| {
            for i in 0..frames {
                let time = Micros(device * 1_000_000 + i * 1000);
                let at = begin + Duration::from_micros(after * 1_000_000 + i * 1000 + 200);
                stamps.frame(&Received { frame: Frame { time, ..Frame::default() }, at });
            }
            Micros(device * 1_000_000 + (frames - 1) * 1000)
        };
        stamps.echo(Duration::from_micros(400));
        let last = stream(&mut stamps, 5, 0, 20_000);
        assert!(stamps.scanned(last).is_some());
        // Another hour by the device's clock, a minute by the host's.
        stamps.reconnected();
        assert_eq!(stamps.scanned(last), None);
        stamps.echo(Duration::from_micros(400));
        let last = stream(&mut stamps, 3600, 60, 3000);
        let (at, error) = stamps.scanned(last).unwrap();
        let truth = stamps.unix(begin + Duration::from_micros(60_000_000 + 2_999_000));
        assert!(at.abs_diff(truth) <= error && error < Duration::from_millis(1), "{error:?}");
    }
}
