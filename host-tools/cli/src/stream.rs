//! A stretch of a finger's stream, watched from start to end.

use std::time::{Duration, Instant};

use anyhow::anyhow;
use taxel_link::{Client, Problem, Received};

use crate::interrupt::Interrupt;

/// How often the loop looks whether it should end.
const LOOK: Duration = Duration::from_millis(100);
/// A stream that brings nothing for so long is none.
const DRY: Duration = Duration::from_secs(5);

/// What came.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Summary {
    /// Frames received.
    pub frames: u64,
    /// Frames that never came: lost on the way, or by this program.
    pub lost: u64,
    /// Packets that could not be read.
    pub bad_packets: u64,
    /// Frames a second by this host's clock; 0 for fewer than two frames.
    pub rate_hz: f64,
    /// Device time from the first frame to the last, in seconds.
    pub duration_s: f64,
}

/// A stream that has ended, and why if not as planned.
pub struct Ended {
    /// What came until then.
    pub summary: Summary,
    /// The finger went away, or fell silent.
    pub broken: Option<anyhow::Error>,
}

/// Starts the stream and hands each frame to `each`, for `duration` of device time or until Ctrl-C.
///
/// # Errors
/// What `each` said, or the start. A link that breaks later is no error here: see [`Ended`].
pub fn run(
    client: &Client,
    duration: Option<f64>,
    interrupt: &Interrupt,
    mut each: impl FnMut(&Received) -> anyhow::Result<()>,
) -> anyhow::Result<Ended> {
    client.stream(true)?;
    let mut span: Option<(Received, Received)> = None;
    let mut taken = 0;
    let mut heard = Instant::now();
    let broken = loop {
        if interrupt.came() {
            break None;
        }
        let received = match client.next(LOOK) {
            Ok(Some(received)) => received,
            Ok(None) if heard.elapsed() < DRY => continue,
            Ok(None) => {
                let dry = DRY.as_secs();
                break Some(anyhow!("{}: no frame for {dry} s; plug it in again", client.port()));
            }
            Err(error) if error.problem() == Some(&Problem::Ended) => break None,
            Err(error) => break Some(error.into()),
        };
        heard = received.at;
        let (first, _) = *span.get_or_insert((received, received));
        let elapsed = received.frame.time.0.saturating_sub(first.frame.time.0);
        if duration.is_some_and(|duration| elapsed as f64 >= duration * 1e6) {
            break None;
        }
        span = Some((first, received));
        taken += 1;
        each(&received)?;
    };
    // What came until here is counted; what is still on its way is not.
    let counts = client.counts();
    if broken.is_none() {
        // A finger that goes now is no matter any more.
        let _ = client.stream(false);
    }
    let summary = Summary {
        frames: taken,
        lost: counts.lost + counts.overflow,
        bad_packets: counts.bad_packets,
        rate_hz: span.map_or(0.0, |(first, last)| rate(&first, &last, taken)),
        duration_s: span.map_or(0.0, |(first, last)| {
            last.frame.time.0.saturating_sub(first.frame.time.0) as f64 / 1e6
        }),
    };
    Ok(Ended { summary, broken })
}

fn rate(first: &Received, last: &Received, frames: u64) -> f64 {
    let span = last.at.duration_since(first.at).as_secs_f64();
    if span > 0.0 { frames.saturating_sub(1) as f64 / span } else { 0.0 }
}

/// A positive number of seconds, as `--duration` takes it.
///
/// # Errors
/// It is none.
pub fn seconds(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|seconds: &f64| seconds.is_finite() && *seconds > 0.0)
        .ok_or_else(|| "expected seconds above 0".to_owned())
}
