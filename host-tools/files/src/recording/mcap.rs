//! Recordings in MCAP, which Foxglove opens.
//!
//! A file has one channel of protobuf messages ([`crate::recording::schema`]), those of Foxglove's
//! own schemas ([`crate::recording::foxglove`]), which are for viewers alone, the facts as metadata
//! and the calibration as an attachment. Messages lie in compressed chunks, each with its
//! CRC. A flush ends the chunk, so a killed writer's file lacks only its summary and unflushed
//! rows. A damaged chunk loses its own rows. Facts and calibration stand at both ends of the file,
//! and MCAP repeats the channel in its summary, so that one damaged place loses none of them.

mod chunk;
mod container;
mod read;
mod seek;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use crate::FileError;
use crate::frames::{Cell, Column};
use crc::{CRC_32_ISO_HDLC, Crc};
use mcap::records::{self, MessageHeader};
use mcap::{Attachment, Compression, McapError, WriteOptions};

use crate::recording::foxglove::{self, Standard, TOPICS};
use crate::recording::header::Header;
use crate::recording::scene;
use crate::recording::{Existing, HOST_TIME, Sink, begin, schema};

pub(crate) use read::{open, open_from};

/// Name of the metadata and of the attached calibration.
const METADATA: &str = "taxel";
const CALIBRATION: &str = "calibration.toml";
/// Key of the facts' CRC among them, because MCAP's metadata has none.
const FACTS_CRC: &str = "facts_crc";

pub(crate) struct Writer {
    path: PathBuf,
    mcap: mcap::Writer<BufWriter<File>>,
    channel: Channel,
    /// Channels of [`TOPICS`], their encoder and its columns; `None` for rows that are no frames.
    standard: Option<(Vec<Channel>, Standard, scene::Columns)>,
    /// Position of a row's time and its unit in nanoseconds: host time, else device time.
    time: Option<usize>,
    message: Vec<u8>,
    header: Header,
}

/// Channel with the number of its next message.
struct Channel {
    id: u16,
    sequence: u32,
}

impl Channel {
    fn put(
        &mut self,
        mcap: &mut mcap::Writer<BufWriter<File>>,
        message: &[u8],
        nanos: u64,
    ) -> Result<(), McapError> {
        let header = MessageHeader {
            channel_id: self.id,
            sequence: self.sequence,
            log_time: nanos,
            publish_time: nanos,
        };
        self.sequence = self.sequence.wrapping_add(1);
        mcap.write_to_known_channel(&header, message)
    }
}

impl Writer {
    pub(crate) fn create(
        path: &Path,
        header: &Header,
        columns: &[Column],
        existing: Existing,
    ) -> Result<Self, FileError> {
        let failed = |error: McapError| no_writing(path, error);
        let file = begin(path, existing)?;
        let options = WriteOptions::new()
            .compression(Some(Compression::Lz4))
            .library(concat!("taxel ", env!("CARGO_PKG_VERSION")))
            // A device file, such as a pipe, cannot seek.
            .disable_seeking(true);
        let mut mcap = options.create(BufWriter::new(file)).map_err(failed)?;
        write_header(&mut mcap, header).map_err(failed)?;
        let mut channel = |topic: &str, name, descriptor: &[u8]| {
            let schema = mcap.add_schema(name, "protobuf", descriptor)?;
            let id = mcap.add_channel(schema, topic, "protobuf", &BTreeMap::new())?;
            Ok(Channel { id, sequence: 0 })
        };
        let serial = header.facts.get("serial").map_or("finger", String::as_str);
        let topic = schema::topic(serial);
        let frames = channel(&topic, schema::NAME, &schema::descriptor(columns)).map_err(failed)?;
        let standard = match scene::Columns::of(columns) {
            None => None,
            Some(drawn) => {
                let channels = TOPICS.iter().enumerate().map(|(at, (end, name))| {
                    channel(&format!("{topic}{end}"), name, &foxglove::descriptor(at))
                });
                let channels = channels.collect::<Result<_, _>>().map_err(failed)?;
                Some((channels, Standard::new(serial), drawn))
            }
        };
        let find = |name| columns.iter().position(|column| column.name == name);
        let time = find(HOST_TIME).or_else(|| find("t_us"));
        let (path, message, header) = (path.to_owned(), Vec::new(), header.clone());
        let mut writer = Self { path, mcap, channel: frames, standard, time, message, header };
        writer.flush()?;
        Ok(writer)
    }
}

impl Sink for Writer {
    fn write(&mut self, row: &[Cell]) -> Result<(), FileError> {
        schema::encode(row, &mut self.message);
        let nanos = match self.time.and_then(|at| row.get(at)) {
            Some(Cell::Whole(micros)) => micros.saturating_mul(1000),
            _ => 0,
        };
        let Self { mcap, channel, standard, message, path, .. } = self;
        let mut written = channel.put(mcap, message, nanos);
        if let (Ok(()), Some((channels, standard, columns))) = (&written, standard) {
            let frame = columns.frame(row);
            written = standard.messages(&frame, nanos, |topic, message| {
                channels[topic].put(mcap, message, nanos)
            });
        }
        written.map_err(|error| no_writing(path, error))
    }

    fn flush(&mut self) -> Result<(), FileError> {
        self.mcap.flush().map_err(|error| no_writing(&self.path, error))
    }

    fn finish(mut self: Box<Self>) -> Result<(), FileError> {
        let Self { mcap, header, .. } = &mut *self;
        let ended = write_header(mcap, header).and_then(|()| mcap.finish());
        ended.map_err(|error| no_writing(&self.path, error))?;
        // The library leaves the last bytes in its buffer.
        let Self { mcap, path, .. } = *self;
        std::io::Write::flush(&mut mcap.into_inner()).map_err(|error| FileError::io(&path, &error))
    }
}

/// Writes facts and calibration; done at both ends of a file.
fn write_header(
    mcap: &mut mcap::Writer<BufWriter<File>>,
    header: &Header,
) -> Result<(), McapError> {
    let mut metadata = header.facts.clone();
    metadata.insert(FACTS_CRC.to_owned(), facts_crc(&header.facts));
    mcap.write_metadata(&records::Metadata { name: METADATA.to_owned(), metadata })?;
    let Some(calibration) = &header.calibration else { return Ok(()) };
    mcap.attach(&Attachment {
        log_time: 0,
        create_time: 0,
        name: CALIBRATION.to_owned(),
        media_type: "application/toml".to_owned(),
        data: Cow::Borrowed(calibration.as_bytes()),
    })
}

/// Computes the CRC of the facts, in hexadecimal.
fn facts_crc(facts: &BTreeMap<String, String>) -> String {
    let crc = Crc::<u32>::new(&CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    for (name, value) in facts {
        digest.update(format!("{name}={value}\n").as_bytes());
    }
    format!("{:08x}", digest.finalize())
}

fn no_writing(path: &Path, error: McapError) -> FileError {
    match error {
        McapError::Io(error) => FileError::io(path, &error),
        error => FileError::new(path, error.to_string()),
    }
}
