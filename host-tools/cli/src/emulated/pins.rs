//! A trace on the pins of an emulated board, heard by the ordinary client: converters, scan, USB and all.
//!
//! The board scans as often as the trace has scans, and sees one of them in each; of a trace slower than its
//! slowest scan, each several times. Time waits for the client, so that nothing is lost on this side; what
//! the board's own link cannot carry is lost there, and is an error.

use std::ops::ControlFlow;
use std::time::Duration;

use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Frame, Status};
use taxel::scan::{Scan, ScanSettings};
use taxel::units::{FullScale, Micros};
use taxel::wire::message::Refusal;
use taxel_files::trace::{Sample, TraceHeader, TraceWriter, Truth};
use tempfile::NamedTempFile;

use super::{EmulatedError, Hardware, ServedBoard, Settings, rate_hz};
use taxel_client::Client;
use taxel_client::{LinkError, Problem};

/// Samples added up for a reading: as many as the rate leaves time for.
const OVERSAMPLING: [u16; 4] = [8, 4, 2, 1];
/// A board that says nothing for so long has nothing more to say.
const PATIENCE: Duration = Duration::from_secs(10);

/// A replay that is about to begin.
pub struct OnPins {
    client: Client,
    settings: ScanSettings,
    full_scale: FullScale,
    /// Of the trace.
    scans: usize,
    begin: Micros,
    // The emulator has read the trace, and ends with this.
    _board: ServedBoard,
}

impl OnPins {
    /// Starts the board, with a calibration record if there is one, and sets it to scan as the trace does.
    ///
    /// # Errors
    /// The board does not start, does not scan that fast, or refuses the calibration.
    pub fn prepare(
        board: Hardware,
        scans: &[Scan],
        record: Option<&[u8]>,
        wanted: &Settings,
    ) -> Result<Self, EmulatedError> {
        let hz = rate_hz(scans)?;
        let each = board.slowest_hz().div_ceil(hz);
        let trace = written(scans, each)?;
        let board = ServedBoard::replaying(board, trace.path())?;
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

    /// What the codes of its frames are fractions of.
    #[must_use]
    pub fn full_scale(&self) -> FullScale {
        self.full_scale
    }

    /// Plays the trace. `frame` is given a frame for each of its scans, in order, and may end the replay.
    /// Their times are the board's own, counted from the trace's first.
    ///
    /// # Errors
    /// The board's link could not carry all frames, or broke.
    pub fn run(
        self,
        mut frame: impl FnMut(&Frame) -> ControlFlow<()>,
    ) -> Result<(), EmulatedError> {
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

    fn skip_to(&self, wanted: impl Fn(Status) -> bool) -> Result<Frame, EmulatedError> {
        loop {
            let frame = self.next(0)?;
            if wanted(frame.status) {
                return Ok(frame);
            }
        }
    }

    fn next(&self, received: usize) -> Result<Frame, EmulatedError> {
        let next = self.client.next(PATIENCE)?;
        next.map(|next| next.frame).ok_or_else(|| self.lost(received))
    }

    fn lost(&self, received: usize) -> EmulatedError {
        EmulatedError::Overflowed { received, expected: self.scans }
    }
}

/// A trace of these scans, each so often.
fn written(scans: &[Scan], each: u16) -> Result<NamedTempFile, EmulatedError> {
    let system = EmulatedError::system("making a temporary file");
    let file = NamedTempFile::with_suffix(".csv").map_err(system)?;
    let first = scans.first().ok_or(EmulatedError::Empty)?.codes;
    let header = TraceHeader {
        full_scale: first.full_scale,
        rows: if first.taxels.is_some() { taxel::scan::ROWS } else { 0 },
        bridges: first.bridges.map(|bridge| bridge.is_some()),
        reference: first.reference.is_some(),
        temperature: first.temperature.is_some(),
        truth: false,
        sensor_truth: false,
    };
    let mut writer = TraceWriter::create(file.path(), header).map_err(LinkError::device)?;
    for (i, scan) in (0..).zip(scans.iter().flat_map(|scan| (0..each).map(move |_| scan))) {
        let scan = Scan { time: Micros(i), ..*scan };
        writer.write(&Sample { scan, truth: Truth::default() }).map_err(LinkError::device)?;
    }
    writer.finish().map_err(LinkError::device)?;
    Ok(file)
}

/// Has the board scan `hz` times a second, as it otherwise does.
fn scanning(client: &Client, scan_hz: u16) -> Result<ScanSettings, EmulatedError> {
    let now = client.health()?.scan.ok_or(EmulatedError::Finger(Problem::Confused("health")))?;
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
    Err(EmulatedError::TooFast { hz: scan_hz, most })
}
