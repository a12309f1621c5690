//! Recording of a stream into files, with facts about its finger.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use taxel::calibration::Calibration;
use taxel::frame::Fields;
use taxel::wire::message::Info;
use taxel_files::frames::{Cell, Column, cells, columns};
use taxel_files::recording::{Existing, Header, Recorder, host_columns};
use taxel_files::{FileError, calibration};

use taxel_client::{Client, LinkError, Problem, Received, Timestamps, fields};

/// Interval between flushes. A killed program loses at most this much.
const FLUSH: Duration = Duration::from_millis(500);

/// Recording of one stream into several files.
pub struct Files {
    recorders: Vec<Recorder>,
    fields: Fields,
    row: Vec<Cell>,
    stamps: Timestamps,
    /// Number of the connection, from 1.
    connection: u64,
    flushed: Instant,
}

impl Files {
    /// Creates files for the stream of `client`, with its present settings.
    ///
    /// A file cannot be written, or the finger does not reply.
    pub fn create(
        client: &Client,
        paths: &[PathBuf],
        existing: Existing,
    ) -> Result<Self, LinkError> {
        // Checked before the first file is created, so that a failure leaves no file behind.
        paths
            .iter()
            .try_for_each(|path| Recorder::check(path, existing))
            .map_err(LinkError::device)?;
        let info = client.info()?;
        let header = header(client, &info)?;
        let columns = row_columns(info.fields);
        let create = |path: &PathBuf| Recorder::create(path, &header, &columns, existing);
        let recorders = paths.iter().map(create).collect::<Result<_, FileError>>();
        let recorders = recorders.map_err(LinkError::device)?;
        Ok(Self {
            recorders,
            fields: info.fields,
            row: Vec::new(),
            stamps: Timestamps::default(),
            connection: 1,
            flushed: Instant::now(),
        })
    }

    /// Marks a reconnect: the following frames come after a gap.
    pub fn reconnected(&mut self) {
        self.connection += 1;
        self.stamps.reconnected();
    }

    /// Adds a round-trip time; see [`Timestamps::echo`].
    pub fn echo(&mut self, echo: Duration) {
        self.stamps.echo(echo);
    }

    /// Writes one frame.
    ///
    /// A file cannot be written. The other files still have the frame.
    pub fn write(&mut self, received: &Received) -> Result<(), FileError> {
        self.stamps.frame(received);
        row(received, self.fields, &self.stamps, self.connection, &mut self.row);
        let flush = received.at.saturating_duration_since(self.flushed) >= FLUSH;
        if flush {
            self.flushed = received.at;
        }
        let mut written = Ok(());
        for recorder in &mut self.recorders {
            let done = recorder.write(&self.row);
            written = written.and(if flush { done.and_then(|()| recorder.flush()) } else { done });
        }
        written
    }

    /// Finishes every file, even if one fails.
    ///
    /// Error of the first file that could not be finished.
    pub fn finish(self) -> Result<(), FileError> {
        let ends = self.recorders.into_iter().map(Recorder::finish);
        ends.fold(Ok(()), Result::and)
    }
}

/// Lists the columns of a recording of these fields: the frame's own and the host's.
#[must_use]
pub fn row_columns(fields: Fields) -> Vec<Column> {
    columns(fields).into_iter().chain(host_columns()).collect()
}

/// Fills `row` with a frame's cells, one for each of [`row_columns`].
pub fn row(
    received: &Received,
    fields: Fields,
    stamps: &Timestamps,
    connection: u64,
    row: &mut Vec<Cell>,
) {
    row.clear();
    cells(&received.frame, fields, row);
    let micros = |unix: Duration| Cell::Whole(unix.as_micros() as u64);
    let scanned = stamps.scanned(received.frame.time);
    row.extend([
        micros(stamps.unix(received.at)),
        scanned.map_or(Cell::Empty, |(unix, _)| micros(unix)),
        scanned.map_or(Cell::Empty, |(_, error)| micros(error)),
        Cell::Whole(connection),
    ]);
}

/// Collects identity, settings and calibration of the finger.
fn header(client: &Client, info: &Info) -> Result<Header, LinkError> {
    let identity = &info.identity;
    let bias = match info.biased.then(|| client.read_bias()).transpose() {
        Ok(bias) => bias,
        // The finger is a playback of a recording without the bias.
        Err(error) if matches!(error.problem(), Some(Problem::Refusal { .. })) => None,
        Err(error) => return Err(error),
    };
    let rate_hz = f64::from(info.rate_millihertz) / 1000.0;
    let [major, minor, patch] = client.version().firmware;
    let mut header = Header::default()
        .with("board", &identity.board)
        .with("serial", &identity.serial)
        .with("build", &identity.build)
        .with("firmware", format!("{major}.{minor}.{patch}"))
        .with("scan_hz", identity.scan_hz)
        .with("full_scale", identity.full_scale.top().0)
        .with("fields", fields::list(info.fields))
        .with("biased", info.biased)
        .with("port", client.port())
        .with("started", humantime::format_rfc3339_millis(SystemTime::now()))
        .with_settings(rate_hz, info.filter_hz, info.point_method, bias.as_ref().map(|b| &b.bias));
    if let Some(id) = &info.calibration {
        let date = UNIX_EPOCH + Duration::from_secs(id.date);
        header = header
            .with("calibration_serial", &id.serial)
            .with("calibration_date", humantime::format_rfc3339_seconds(date))
            .with("calibration_crc", format!("{:08x}", id.crc));
        let record = client.download_calibration()?;
        let place = Path::new("the finger's calibration");
        header.calibration = Calibration::from_bytes(&record)
            .ok()
            .map(|calibration| calibration::to_text(place, &calibration))
            .transpose()
            .map_err(LinkError::device)?;
    }
    Ok(header)
}
