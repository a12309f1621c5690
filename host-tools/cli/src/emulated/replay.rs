//! A trace on the pins of an emulated board, heard by the ordinary client: converters, scan, USB and all.
//!
//! The board scans as often as the trace has scans, and sees one of them in each; of a trace slower than its
//! slowest scan, each several times. Time waits for the client, so that nothing is lost on this side; what
//! the board's own link cannot carry is lost there, and is an error.

use std::ops::ControlFlow;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Fields, Frame, Status};
use taxel::scan::{Scan, ScanSettings};
use taxel::units::{FullScale, Micros};
use taxel::wire::message::Refusal;
use taxel_client::{Client, Problem};
use taxel_files::trace::{Sample, TraceHeader, TraceWriter, Truth};
use tempfile::NamedTempFile;

use super::{Board, Emulated};

/// Samples added up for a reading: as many as the rate leaves time for.
const OVERSAMPLING: [u16; 4] = [8, 4, 2, 1];
/// A board that says nothing for so long has nothing more to say.
const PATIENCE: Duration = Duration::from_secs(10);

/// Settings of a board that replays; its rate is the trace's.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Fields of its frames.
    pub fields: Fields,
    /// Corner of the low-pass in hertz; 0 for none.
    pub filter_hz: u16,
    /// Method of the contact point.
    pub point_method: PointMethod,
}

/// A replay that is about to begin.
pub struct Replay {
    client: Client,
    settings: ScanSettings,
    full_scale: FullScale,
    /// Number of scans in the trace.
    scans: usize,
    begin: Micros,
    // The emulator has read the trace, and ends with this.
    _board: Emulated,
}

impl Replay {
    /// Starts the board, with a calibration record if there is one, and sets it to scan as the trace does.
    ///
    /// # Errors
    /// The board does not start, does not scan that fast, or refuses the calibration.
    pub fn prepare(
        board: Board,
        scans: &[Scan],
        record: Option<&[u8]>,
        wanted: &Settings,
    ) -> anyhow::Result<Self> {
        let hz = rate_hz(scans)?;
        let each = board.slowest_hz().div_ceil(hz);
        let trace = written(scans, each)?;
        let board = Emulated::replaying(board, trace.path())?;
        let client = Client::open(board.port())?;
        if let Some(record) = record {
            client.upload_calibration(record, |_| ControlFlow::Continue(()))?;
        }
        let settings = scanning(&client, hz.saturating_mul(each))?;
        client.set_fields(wanted.fields)?;
        client.set_rate(hz)?;
        client.set_filter(wanted.filter_hz)?;
        // It begins with the default, for which an image without the model takes the next best; to ask for the
        // model by name it would refuse.
        if wanted.point_method != PointMethod::default() {
            client.set_point_method(wanted.point_method)?;
        }
        let full_scale = client.info()?.identity.full_scale;
        let begin = scans.first().map_or(Micros(0), |scan| scan.time);
        let scans = scans.len();
        Ok(Self { client, settings, full_scale, scans, begin, _board: board })
    }

    /// Full scale of the codes in its frames.
    pub fn full_scale(&self) -> FullScale {
        self.full_scale
    }

    /// Plays the trace: calls `frame` with a frame for each scan, in order, until it breaks.
    ///
    /// Times are the board's own, counted from the trace's first.
    ///
    /// # Errors
    /// The board's link could not carry all frames, or broke.
    pub fn run(self, mut frame: impl FnMut(&Frame) -> ControlFlow<()>) -> anyhow::Result<()> {
        self.client.stream(true)?;
        // The scan that follows a standstill says so; those before it may not.
        self.skip_to(|status| !status.contains(Status::OVERRUN))?;
        self.client.set_scan(self.settings)?;
        let mut next = self.skip_to(|status| status.contains(Status::OVERRUN))?;
        let first = next;
        for received in 0..self.scans {
            if next.seq.wrapping_sub(first.seq) as usize != received {
                return Err(self.lost(received));
            }
            let since = next.time.0.saturating_sub(first.time.0);
            let time = Micros(self.begin.0 + since);
            if frame(&Frame { seq: received as u32, time, ..next }).is_break() {
                break;
            }
            if received + 1 < self.scans {
                next = self.next(received + 1)?;
            }
        }
        Ok(())
    }

    fn skip_to(&self, wanted: impl Fn(Status) -> bool) -> anyhow::Result<Frame> {
        loop {
            let frame = self.next(0)?;
            if wanted(frame.status) {
                return Ok(frame);
            }
        }
    }

    fn next(&self, received: usize) -> anyhow::Result<Frame> {
        let next = self.client.next(PATIENCE)?;
        next.map(|next| next.frame).ok_or_else(|| self.lost(received))
    }

    fn lost(&self, received: usize) -> anyhow::Error {
        anyhow!(
            "the board's link carried {received} of {} frames before one was lost; ask for fewer --fields",
            self.scans
        )
    }
}

/// Scans a second, by their times; one where there is only one scan.
fn rate_hz(scans: &[Scan]) -> anyhow::Result<u16> {
    let (Some(first), Some(last)) = (scans.first(), scans.last()) else {
        bail!("the trace has no scans; give one that has")
    };
    let duration = last.time.0.saturating_sub(first.time.0).max(1);
    let hz = ((scans.len() as u64 - 1) * 1_000_000 + duration / 2) / duration;
    Ok(u16::try_from(hz).unwrap_or(u16::MAX).max(1))
}

/// Writes a trace of these scans, each so often.
fn written(scans: &[Scan], each: u16) -> anyhow::Result<NamedTempFile> {
    let file = NamedTempFile::with_suffix(".csv").context("making a temporary file")?;
    let first = scans.first().context("the trace has no scans")?.codes;
    let header = TraceHeader {
        full_scale: first.full_scale,
        rows: if first.taxels.is_some() { taxel::scan::ROWS } else { 0 },
        bridges: first.bridges.map(|bridge| bridge.is_some()),
        reference: first.reference.is_some(),
        temperature: first.temperature.is_some(),
        truth: false,
        sensor_truth: false,
    };
    let mut writer = TraceWriter::create(file.path(), header)?;
    for (i, scan) in (0..).zip(scans.iter().flat_map(|scan| (0..each).map(move |_| scan))) {
        let scan = Scan { time: Micros(i), ..*scan };
        writer.write(&Sample { scan, truth: Truth::default() })?;
    }
    writer.finish()?;
    Ok(file)
}

/// Has the board scan `hz` times a second, as it otherwise does.
fn scanning(client: &Client, scan_hz: u16) -> anyhow::Result<ScanSettings> {
    let now = client.health()?.scan.context("the board does not say how it scans")?;
    let mut most = 0;
    for oversampling in OVERSAMPLING {
        let settings = ScanSettings { scan_hz, oversampling, ..now };
        match client.set_scan(settings) {
            Ok(()) => return Ok(settings),
            Err(error) => match error.problem() {
                Some(Problem::Refusal { refusal: Refusal::Scan { high, .. }, .. }) => most = *high,
                _ => return Err(error.into()),
            },
        }
    }
    bail!(
        "the trace has {scan_hz} scans a second, and the board scans {most} times at most; replay it on the host"
    )
}

#[cfg(test)]
mod tests {
    use taxel::scan::Codes;

    use super::*;

    fn scans(count: u64, period: u64) -> Vec<Scan> {
        let codes = Codes {
            full_scale: FullScale::BITS_12,
            taxels: None,
            bridges: [None; 4],
            reference: None,
            temperature: None,
        };
        let scan = |i| Scan { time: Micros(1_000 + i * period), lost: 0, codes };
        (0..count).map(scan).collect()
    }

    #[test]
    fn rate_is_that_of_the_times() {
        for (period, hz) in [(2_000, 500), (250, 4_000), (2_999, 333)] {
            assert_eq!(rate_hz(&scans(1_000, period)).unwrap(), hz);
        }
        // One scan, and scans that all carry the same time, have no rate to state; it must not be zero.
        assert_eq!(rate_hz(&scans(1, 0)).unwrap(), 1);
        assert_eq!(rate_hz(&scans(9, 0)).unwrap(), u16::MAX);
        let error = rate_hz(&[]).unwrap_err().to_string();
        assert_eq!(error, "the trace has no scans; give one that has");
    }
}
