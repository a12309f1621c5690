//! Device time in host time.
//!
//! A frame is received at least one link delay after its scan, sometimes much more. The earliest
//! frames bound the clock: the closest line below all of them has the device's rate as slope (lower
//! convex hull; Moon, Skelly and Towsley, INFOCOM 1999). The line is one link delay late, between
//! zero and a round trip. Half the shortest round trip is subtracted and counted as error.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use taxel::units::Micros;

/// Seconds per interval, of which only the earliest frame is kept, and number of intervals.
const BUCKET: f64 = 1.0;
const KEPT: usize = 120;
/// Seconds before the rate is estimated; until then it counts as right within [`UNKNOWN_RATE`].
const LEAST_SPAN: f64 = 10.0;
/// Largest difference in rate before it is estimated: two crystals at 100 ppm over temperature.
const UNKNOWN_RATE: f64 = 200e-6;

/// Device clock estimated from received frames.
#[derive(Clone, Debug, Default)]
pub struct DeviceClock {
    /// First frame: device seconds, and its time of reception.
    origin: Option<(f64, Instant)>,
    /// Device seconds since the first frame, and delay of the frame against that clock in seconds.
    earliest: VecDeque<(f64, f64)>,
    last: f64,
    echo: Option<f64>,
    line: Line,
}

#[derive(Clone, Copy, Debug, Default)]
struct Line {
    offset: f64,
    /// Slope; `None` before [`LEAST_SPAN`].
    slope: Option<f64>,
    /// Time of the earliest frame of all, which the line touches.
    touches: f64,
    /// Median height of the earliest frames above the line, in seconds.
    spread: f64,
}

/// Moment of the device in host time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HostTime {
    /// Host time.
    pub at: Instant,
    /// Bound on the error, from the link's delays.
    pub error: Duration,
}

impl DeviceClock {
    /// Adds a frame of this device time, received at `at`.
    pub fn frame(&mut self, device: Micros, at: Instant) {
        let device = device.0 as f64 * 1e-6;
        let (start, received) = *self.origin.get_or_insert((device, at));
        let time = device - start;
        if time < self.last {
            // The device restarted.
            *self = Self { echo: self.echo, ..Self::default() };
            self.origin = Some((device, at));
            self.earliest.push_back((0.0, 0.0));
            return;
        }
        self.last = time;
        let late = at.saturating_duration_since(received).as_secs_f64()
            - received.saturating_duration_since(at).as_secs_f64()
            - time;
        match self.earliest.back_mut() {
            Some(last) if (last.0 / BUCKET).floor() == (time / BUCKET).floor() => {
                if late < last.1 {
                    *last = (time, late);
                }
            }
            _ => {
                self.fit();
                if self.earliest.len() == KEPT {
                    self.earliest.pop_front();
                }
                self.earliest.push_back((time, late));
            }
        }
    }

    /// Adds a round-trip time.
    pub fn echo(&mut self, echo: Duration) {
        let echo = echo.as_secs_f64();
        self.echo = Some(self.echo.map_or(echo, |least| least.min(echo)));
    }

    /// Converts device time to host time. `None` before the first round trip and the first seconds
    /// of frames.
    #[must_use]
    pub fn host(&self, device: Micros) -> Option<HostTime> {
        let (start, received) = self.origin?;
        let echo = self.echo?;
        if self.earliest.len() < 2 {
            return None;
        }
        let time = device.0 as f64 * 1e-6 - start;
        let line = &self.line;
        let late = line.offset + line.slope.unwrap_or_default() * time - echo / 2.0;
        let apart = match line.slope {
            Some(_) => 0.0,
            None => UNKNOWN_RATE * (time - line.touches).abs(),
        };
        let at = time + late;
        let at = match at >= 0.0 {
            true => received + Duration::from_secs_f64(at),
            false => received.checked_sub(Duration::from_secs_f64(-at))?,
        };
        Some(HostTime { at, error: Duration::from_secs_f64(echo / 2.0 + line.spread + apart) })
    }

    /// Rate of the device's clock over the host's, in ppm, once it is known.
    #[must_use]
    pub fn drift_ppm(&self) -> Option<f64> {
        self.line.slope.map(|slope| -slope * 1e6)
    }

    fn span(&self) -> f64 {
        let (first, last) = (self.earliest.front(), self.earliest.back());
        first.zip(last).map_or(0.0, |(first, last)| last.0 - first.0)
    }

    /// Fits the line below the earliest frames of all complete intervals.
    fn fit(&mut self) {
        let least = self.earliest.iter().min_by(|a, b| a.1.total_cmp(&b.1));
        let (touches, offset) = least.copied().unwrap_or_default();
        let mut line = Line { offset, slope: None, touches, spread: 0.0 };
        if self.span() >= LEAST_SPAN
            && let Some(((t0, y0), (t1, y1))) = self.edge()
        {
            let slope = (y1 - y0) / (t1 - t0);
            line.offset = y0 - slope * t0;
            line.slope = Some(slope);
        }
        let above = self
            .earliest
            .iter()
            .map(|(t, late)| late - line.offset - line.slope.unwrap_or_default() * t);
        // The median, because an interval with late frames only carries no information on the
        // clock.
        let mut above: Vec<f64> = above.collect();
        above.sort_by(f64::total_cmp);
        line.spread = above.get(above.len() / 2).copied().unwrap_or_default();
        self.line = line;
    }

    /// Edge of the lower convex hull at the middle of the time: the closest line below all points.
    fn edge(&self) -> Option<((f64, f64), (f64, f64))> {
        let mut hull: Vec<(f64, f64)> = Vec::new();
        for point in &self.earliest {
            while let [.., a, b] = hull.as_slice()
                && (b.0 - a.0) * (point.1 - a.1) <= (point.0 - a.0) * (b.1 - a.1)
            {
                hull.pop();
            }
            hull.push(*point);
        }
        let middle =
            self.earliest.iter().map(|(time, _)| time).sum::<f64>() / self.earliest.len() as f64;
        hull.windows(2).find_map(|edge| match edge {
            [a, b] if (a.0..=b.0).contains(&middle) => Some((*a, *b)),
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Delays of a link in seconds: 0.2 ms at least, and a tail.
    fn delay(i: u64) -> f64 {
        let noise =
            (i.wrapping_mul(6_364_136_223_846_793_005) >> 33) as f64 / f64::from(1u32 << 31);
        2e-4 + 3e-3 * noise.powi(4) + if i.is_multiple_of(97) { 0.02 } else { 0.0 }
    }

    /// Streams `seconds` at 1 kHz with a clock that is `ppm` fast. Returns error and stated bound
    /// of the map for every frame that has one.
    fn stream(ppm: f64, seconds: u64) -> (Vec<(f64, f64)>, DeviceClock) {
        let start = Instant::now();
        let mut clock = DeviceClock::default();
        clock.echo(Duration::from_micros(900));
        clock.echo(Duration::from_micros(500));
        let mut errors = Vec::new();
        for i in 0..seconds * 1000 {
            let true_time = i as f64 * 1e-3;
            let device = Micros((5e6 + true_time * 1e6 * (1.0 + ppm * 1e-6)).round() as u64);
            clock.frame(device, start + Duration::from_secs_f64(true_time + delay(i)));
            if let Some(host) = clock.host(device) {
                let early = start.saturating_duration_since(host.at).as_secs_f64();
                let found = host.at.saturating_duration_since(start).as_secs_f64() - early;
                errors.push(((found - true_time).abs(), host.error.as_secs_f64()));
            }
        }
        (errors, clock)
    }

    #[test]
    fn error_stays_within_bound_for_any_drift() {
        for ppm in [-200.0, -100.0, -50.0, 0.0, 80.0, 200.0] {
            let (errors, clock) = stream(ppm, 60);
            // The first second has no estimate yet.
            assert!((58_900..59_100).contains(&errors.len()), "{}", errors.len());
            for (i, (error, stated)) in errors.iter().enumerate() {
                assert!(error <= stated, "{ppm} ppm, frame {i}: off by {error}, said {stated}");
            }
            let most = |from: usize| errors.iter().skip(from).map(|e| e.1).fold(0.0, f64::max);
            // Half of the shortest echo, 0.25 ms, plus the unknown part of the rate.
            assert!(most(15_000) < 3e-4 && most(0) < 4e-3, "{} {}", most(15_000), most(0));
            assert!((clock.drift_ppm().unwrap() - ppm).abs() < 3.0, "{:?}", clock.drift_ppm());
        }
    }

    #[test]
    fn clock_is_unknown_at_start_and_after_restart() {
        let mut clock = DeviceClock::default();
        let now = Instant::now();
        clock.frame(Micros(0), now);
        assert_eq!(clock.host(Micros(0)), None);
        let (_, mut clock) = stream(0.0, 20);
        assert!(clock.host(Micros(6_000_000)).is_some());
        clock.frame(Micros(10), now + Duration::from_secs(30));
        assert_eq!(clock.host(Micros(10)), None);
        assert_eq!(clock.drift_ppm(), None);
    }
}
