//! Replay of a trace on the pins of an emulated board, through the ordinary client. Converters,
//! scan and USB take part.
//!
//! The board scans at the trace's rate and reads one of its scans each time. A trace slower than
//! the board's lowest rate has each scan read several times. Time waits for the client, so that
//! nothing is lost on this side, and two replays give the same frames. A frame that the board's own
//! link loses is an error.

use std::net::{Shutdown, TcpStream};
use std::ops::ControlFlow;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Fields, Frame, Status};
use taxel::scan::{Scan, ScanSettings};
use taxel::units::{FullScale, Micros};
use taxel::wire::message::Refusal;
use taxel_client::{Client, Link, Port, Problem};
use taxel_files::trace::{Sample, TraceHeader, TraceWriter, Truth};
use tempfile::NamedTempFile;

use super::{Board, Emulated};

/// Oversampling to try, highest first; the rate limits it.
const OVERSAMPLING: [u16; 4] = [8, 4, 2, 1];
/// Settle times to try, in quarters of the board's own, longest first; the rate limits it.
///
/// After six quarters a reading keeps less than a tenth of a code of the one before it.
const SETTLE_QUARTERS: [u32; 3] = [8, 6, 4];
/// Silence after which a board counts as stopped.
const PATIENCE: Duration = Duration::from_secs(10);
/// Interval at which the client looks whether to stop reading.
const POLL: Duration = Duration::from_millis(50);

/// Settings of a replaying board; its rate is the trace's.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Fields of the board's frames.
    pub fields: Fields,
    /// Corner of the low-pass in hertz; 0 for none.
    pub filter_hz: u16,
    /// Method of the contact point.
    pub point_method: PointMethod,
    /// Whether a reading is a single conversion instead of as many as the rate allows.
    pub single: bool,
}

/// Replay that is ready to run.
pub struct Replay {
    client: Client,
    link: TcpStream,
    settings: ScanSettings,
    full_scale: FullScale,
    /// Number of scans in the trace.
    scans: usize,
    begin: Micros,
    // Dropping this ends the emulator.
    _board: Emulated,
}

impl Replay {
    /// Starts the board, uploads the calibration record if given, and sets the trace's scan rate.
    ///
    /// The board does not start, cannot scan that fast, or refuses the calibration.
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
        let (client, link) = connected(board.port())?;
        if let Some(record) = record {
            client.upload_calibration(record, |_| ControlFlow::Continue(()))?;
        }
        let settings = scanning(&client, hz.saturating_mul(each), wanted.single)?;
        client.set_fields(wanted.fields)?;
        client.set_rate(hz)?;
        client.set_filter(wanted.filter_hz)?;
        // The board starts with the default method. An image without the model replaces the default
        // by the next best, but would refuse the model by name.
        if wanted.point_method != PointMethod::default() {
            client.set_point_method(wanted.point_method)?;
        }
        let full_scale = client.info()?.identity.full_scale;
        let begin = scans.first().map_or(Micros(0), |scan| scan.time);
        let scans = scans.len();
        Ok(Self { client, link, settings, full_scale, scans, begin, _board: board })
    }

    /// Full scale of the codes in the frames.
    pub fn full_scale(&self) -> FullScale {
        self.full_scale
    }

    /// Plays the trace: calls `frame` for each scan, in order, until the callback breaks.
    ///
    /// Frame times are the board's own, from the trace's first time on.
    ///
    /// # Errors
    /// The board's link could not carry all frames, or broke.
    pub fn run(self, mut frame: impl FnMut(&Frame) -> ControlFlow<()>) -> anyhow::Result<()> {
        self.client.stream(true)?;
        // The first scan after a standstill has the flag OVERRUN; earlier ones must not. The
        // board's time passes by requests alone until there are no more.
        let begins = |frame: &Frame| frame.status.contains(Status::OVERRUN);
        while self.client.next(Duration::ZERO)?.is_none_or(|next| begins(&next.frame)) {
            self.client.info()?;
        }
        self.client.set_scan(self.settings)?;
        self.link.shutdown(Shutdown::Write).context("ending the requests to the emulator")?;
        let mut next = self.next(0)?;
        while !begins(&next) {
            next = self.next(0)?;
        }
        let first = next;
        for received in 0..self.scans {
            if next.seq.wrapping_sub(first.seq) as usize != received {
                return Err(self.lost(received));
            }
            let since = next.time.0.saturating_sub(first.time.0);
            let time = Micros(self.begin.0 + since);
            let mut status = next.status;
            if received == 0 {
                // The board stood still before its first scan, the trace did not.
                status.remove(Status::OVERRUN);
            }
            if frame(&Frame { seq: received as u32, time, status, ..next }).is_break() {
                break;
            }
            if received + 1 < self.scans {
                next = self.next(received + 1)?;
            }
        }
        Ok(())
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

/// Connects so that each replay sends the same bytes. Returns the link, too, whose sending side
/// ends the requests.
fn connected(port: &Port) -> anyhow::Result<(Client, TcpStream)> {
    let Port::Tcp { host, port: number } = port else { bail!("{port}: not a TCP port") };
    let reader =
        TcpStream::connect((host.as_str(), *number)).context("connecting to the emulator")?;
    reader.set_nodelay(true)?;
    reader.set_read_timeout(Some(POLL))?;
    let (writer, link) = (reader.try_clone()?, reader.try_clone()?);
    let ends = Link::over(Box::new(reader), Box::new(writer)).with_first_tag(0);
    Ok((Client::over(port, ends)?, link))
}

/// Computes the scan rate in Hz from the times; 1 for a single scan.
fn rate_hz(scans: &[Scan]) -> anyhow::Result<u16> {
    let (Some(first), Some(last)) = (scans.first(), scans.last()) else {
        bail!("the trace has no scans; give one that has")
    };
    let duration = last.time.0.saturating_sub(first.time.0).max(1);
    let hz = ((scans.len() as u64 - 1) * 1_000_000 + duration / 2) / duration;
    Ok(u16::try_from(hz).unwrap_or(u16::MAX).max(1))
}

/// Writes a trace that repeats each scan `each` times.
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

/// Sets the scan rate, with the highest oversampling and then the longest settle time that the
/// board accepts.
fn scanning(client: &Client, scan_hz: u16, single: bool) -> anyhow::Result<ScanSettings> {
    let now = client.health()?.scan.context("the board does not say how it scans")?;
    let mut most = 0;
    let oversampling = OVERSAMPLING.into_iter().filter(|samples| !single || *samples == 1);
    let pairs =
        oversampling.flat_map(|samples| SETTLE_QUARTERS.map(|quarters| (samples, quarters)));
    for (oversampling, quarters) in pairs {
        let settle_ns = now.settle_ns / 4 * quarters;
        let settings = ScanSettings { scan_hz, oversampling, settle_ns };
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
    fn rate_follows_from_scan_times() {
        for (period, hz) in [(2_000, 500), (250, 4_000), (2_999, 333)] {
            assert_eq!(rate_hz(&scans(1_000, period)).unwrap(), hz);
        }
        // One scan, or scans of equal time, have no rate; the result must not be zero.
        assert_eq!(rate_hz(&scans(1, 0)).unwrap(), 1);
        assert_eq!(rate_hz(&scans(9, 0)).unwrap(), u16::MAX);
        let error = rate_hz(&[]).unwrap_err().to_string();
        assert_eq!(error, "the trace has no scans; give one that has");
    }
}
