//! Loop over a finger's stream, from start to end, with counts and a progress bar.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::anyhow;
use indicatif::{ProgressBar, ProgressStyle};
use taxel_client::{Client, Event, LinkError, Received, ReconnectingClient};

use crate::interrupt::Interrupt;
use crate::output;

/// Interval at which the loop checks whether to stop.
const LOOK: Duration = Duration::from_millis(100);
/// Interval of the progress in words.
const TELL: Duration = Duration::from_millis(250);
/// Silence after which a stream counts as broken.
const DRY: Duration = Duration::from_secs(5);

/// Counts and durations of a stream.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Summary {
    /// Frames received.
    pub frames: u64,
    /// Frames lost on the way or dropped by this program; those of a gap are unknown.
    pub lost: u64,
    /// Packets that could not be decoded.
    pub bad_packets: u64,
    /// Number of reconnects.
    pub gaps: u64,
    /// Time without a connection, in seconds.
    pub gap_s: f64,
    /// Frames a second by this host's clock, gaps left out; 0 for fewer than two frames.
    pub rate_hz: f64,
    /// Seconds from the first frame to the last: device time, and this host's for the gaps.
    pub duration_s: f64,
}

/// End of a stream, with the reason if it was unplanned.
pub struct Ended {
    /// Counts until the end.
    pub summary: Summary,
    /// Error, if the finger was unplugged or fell silent.
    pub broken: Option<anyhow::Error>,
}

/// Item of a stream.
pub enum Next<'n> {
    /// Frame received.
    Frame(&'n Received),
    /// Finger that is connected again.
    Again(&'n Client),
    /// Words of the progress, to which more can be added.
    #[cfg_attr(not(feature = "full"), expect(dead_code, reason = "`calibrate record` adds words"))]
    Progress(&'n mut String),
}

/// Passes the frames of a connected finger to `each` until it breaks off, for `duration` or until
/// Ctrl-C. The finger must not stream yet, and streams until [`leave`]. If it is unplugged and
/// `awaited`, it is waited for, with a note on standard error; otherwise the stream ends.
///
/// Errors of `each`, or of starting the stream. A link that breaks later is no error; see
/// [`Ended`].
pub fn run(
    finger: &ReconnectingClient,
    awaited: bool,
    duration: Option<f64>,
    interrupt: &Interrupt,
    mut each: impl FnMut(Next<'_>) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<Ended> {
    let mut client = finger.client();
    client.iter().try_for_each(|client| client.stream(true))?;
    let mut tally = Tally::default();
    let mut heard = Instant::now();
    let mut told = Instant::now();
    let mut gone: Option<LinkError> = None;
    let enough = |seconds: f64| duration.is_some_and(|duration| seconds >= duration);
    let bar = bar(duration, awaited)?;
    // Notes are printed above the bar.
    let note = |text: String| bar.suspend(|| output::note(text));
    let broken = loop {
        if interrupt.came() {
            break None;
        }
        match finger.next(LOOK) {
            Event::Frame(received) => {
                heard = received.at;
                if enough(tally.elapsed(&received)) {
                    break None;
                }
                tally.add(&received);
                bar.set_position(millis(tally.duration_s()));
                if awaited && told.elapsed() >= TELL {
                    told = Instant::now();
                    let mut words = tally.progress(client.as_deref());
                    let _ = each(Next::Progress(&mut words))?;
                    bar.set_message(words);
                }
                if each(Next::Frame(&received))?.is_break() {
                    break None;
                }
            }
            Event::Connecting => {
                if enough(tally.duration_s() + heard.elapsed().as_secs_f64()) {
                    break None;
                }
            }
            Event::Timeout if heard.elapsed() < DRY => {}
            Event::Timeout => {
                let dry = DRY.as_secs();
                break Some(anyhow!("{}: no frame for {dry} s; plug it in again", finger.port()));
            }
            Event::Connected(again) => {
                (gone, heard) = (None, Instant::now());
                note(format!("{}: connected again", finger.port()));
                if finger.bias_lost() {
                    note(format!("{}: the finger lost its bias; take it again", finger.port()));
                }
                let _ = each(Next::Again(&again))?;
                client = Some(again);
            }
            Event::Disconnected(error) if awaited => {
                if let Some(client) = client.take() {
                    tally.end_connection(&client);
                    note(format!("{error}; waiting for it"));
                }
                if enough(tally.duration_s() + heard.elapsed().as_secs_f64()) {
                    break Some(error.into());
                }
                gone = Some(error);
            }
            Event::Disconnected(error) => break Some(error.into()),
            Event::Ended => break None,
        }
    };
    bar.finish_and_clear();
    // Frames received so far are counted; those on their way are not.
    client.iter().for_each(|client| tally.end_connection(client));
    // A recording that ends while its finger is unplugged is incomplete.
    let broken = broken.or(gone.map(anyhow::Error::from));
    Ok(Ended { summary: tally.summary(), broken })
}

/// Stops the stream of a finger. `first` runs before.
pub fn leave(
    finger: Arc<ReconnectingClient>,
    interrupt: &Interrupt,
    first: impl FnOnce(&ReconnectingClient) + Send + 'static,
) {
    interrupt.farewell(move || {
        first(&finger);
        // The stream has ended, so an unplugged finger is no error here.
        finger.client().iter().for_each(|client| drop(client.stream(false)));
    });
}

/// Creates the progress bar, in milliseconds. A stream until Ctrl-C has words alone, or nothing if
/// the command shows its frames itself.
fn bar(duration: Option<f64>, words: bool) -> anyhow::Result<ProgressBar> {
    let Some(seconds) = duration else {
        let style = ProgressStyle::with_template("{msg}")?;
        let spinner = if words { ProgressBar::new_spinner() } else { ProgressBar::hidden() };
        return Ok(spinner.with_style(style));
    };
    let style = ProgressStyle::with_template("{wide_bar} {percent} % {eta} {msg}")?;
    Ok(ProgressBar::new(millis(seconds)).with_style(style))
}

fn millis(seconds: f64) -> u64 {
    (seconds * 1e3) as u64
}

/// Counts over all connections.
#[derive(Default)]
struct Tally {
    summary: Summary,
    first: Option<Received>,
    last: Option<Received>,
    /// First frame of this connection, and its seconds after the first frame of all.
    connection: Option<(Received, f64)>,
}

impl Tally {
    /// Returns the seconds from the first frame of all to `received`.
    fn elapsed(&self, received: &Received) -> f64 {
        match (&self.connection, &self.last) {
            (Some((first, after)), _) => {
                after + received.frame.time.0.saturating_sub(first.frame.time.0) as f64 / 1e6
            }
            // The finger and its clock may have restarted.
            (None, Some(last)) => self.duration_s() + seconds_between(last, received),
            (None, None) => 0.0,
        }
    }

    fn duration_s(&self) -> f64 {
        self.summary.duration_s
    }

    fn add(&mut self, received: &Received) {
        let elapsed = self.elapsed(received);
        if self.connection.is_none() {
            if let Some(last) = &self.last {
                self.summary.gaps += 1;
                self.summary.gap_s += seconds_between(last, received);
            }
            self.connection = Some((*received, elapsed));
        }
        self.summary.frames += 1;
        self.summary.duration_s = elapsed;
        self.first.get_or_insert(*received);
        self.last = Some(*received);
    }

    /// Returns duration and counts so far, in words.
    fn progress(&self, client: Option<&Client>) -> String {
        let counts = client.map(Client::counts).unwrap_or_default();
        let lost = self.summary.lost + counts.lost + counts.overflow;
        format!("{:.0} s, {} frames, {lost} lost", self.duration_s(), self.summary.frames)
    }

    fn end_connection(&mut self, client: &Client) {
        let counts = client.counts();
        self.summary.lost += counts.lost + counts.overflow;
        self.summary.bad_packets += counts.bad_packets;
        self.connection = None;
    }

    fn summary(mut self) -> Summary {
        if let Some((first, last)) = self.first.zip(self.last) {
            let streamed = seconds_between(&first, &last) - self.summary.gap_s;
            // Each connection has one frame more than intervals between frames.
            let steps = self.summary.frames.saturating_sub(1 + self.summary.gaps);
            self.summary.rate_hz = if streamed > 0.0 { steps as f64 / streamed } else { 0.0 };
        }
        self.summary
    }
}

fn seconds_between(earlier: &Received, later: &Received) -> f64 {
    later.at.saturating_duration_since(earlier.at).as_secs_f64()
}

/// Parses a positive number of seconds, as in `--duration`.
///
/// # Errors
/// The text is not such a number.
pub fn seconds(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|seconds: &f64| seconds.is_finite() && *seconds > 0.0)
        .ok_or_else(|| "expected seconds above 0".to_owned())
}
