//! Recordings in MCAP, which Foxglove opens.
//!
//! A file has one channel of protobuf messages ([`crate::recording::schema`]), the facts as
//! metadata and the calibration as an attachment. Messages lie in compressed chunks, each with its
//! CRC. A flush ends the chunk, so a killed writer's file lacks only its summary and unflushed
//! rows. A damaged chunk loses its own rows.

use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Cursor, ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::FileError;
use crate::frames::{Cell, Column};
use mcap::records::{self, MessageHeader, Record};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Attachment, Compression, McapError, WriteOptions};

use crate::recording::header::Header;
use crate::recording::{Existing, HOST_TIME, Recording, Sink, begin, schema};

/// Name of the metadata and of the attached calibration.
const METADATA: &str = "taxel";
const CALIBRATION: &str = "calibration.toml";
/// Longest accepted chunk in bytes, far above this writer's own.
const LONGEST: usize = 64 << 20;

pub(crate) struct Writer {
    path: PathBuf,
    mcap: mcap::Writer<BufWriter<File>>,
    channel: u16,
    /// Position of a row's time and its unit in nanoseconds: host time, else device time.
    time: Option<usize>,
    sequence: u32,
    message: Vec<u8>,
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
        let metadata = header.facts.clone();
        mcap.write_metadata(&records::Metadata { name: METADATA.to_owned(), metadata })
            .map_err(failed)?;
        if let Some(calibration) = &header.calibration {
            mcap.attach(&Attachment {
                log_time: 0,
                create_time: 0,
                name: CALIBRATION.to_owned(),
                media_type: "application/toml".to_owned(),
                data: Cow::Borrowed(calibration.as_bytes()),
            })
            .map_err(failed)?;
        }
        let schema = mcap.add_schema(schema::NAME, "protobuf", &schema::descriptor(columns));
        let serial = header.facts.get("serial").map_or("finger", String::as_str);
        let channel = mcap
            .add_channel(
                schema.map_err(failed)?,
                &schema::topic(serial),
                "protobuf",
                &BTreeMap::new(),
            )
            .map_err(failed)?;
        let find = |name| columns.iter().position(|column| column.name == name);
        let time = find(HOST_TIME).or_else(|| find("t_us"));
        let (path, message) = (path.to_owned(), Vec::new());
        let mut writer = Self { path, mcap, channel, time, sequence: 0, message };
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
        let header = MessageHeader {
            channel_id: self.channel,
            sequence: self.sequence,
            log_time: nanos,
            publish_time: nanos,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let written = self.mcap.write_to_known_channel(&header, &self.message);
        written.map_err(|error| no_writing(&self.path, error))
    }

    fn flush(&mut self) -> Result<(), FileError> {
        self.mcap.flush().map_err(|error| no_writing(&self.path, error))
    }

    fn finish(mut self: Box<Self>) -> Result<(), FileError> {
        self.mcap.finish().map_err(|error| no_writing(&self.path, error))?;
        // The library leaves the last bytes in its buffer.
        let Self { mcap, path, .. } = *self;
        std::io::Write::flush(&mut mcap.into_inner()).map_err(|error| FileError::io(&path, &error))
    }
}

fn no_writing(path: &Path, error: McapError) -> FileError {
    match error {
        McapError::Io(error) => FileError::io(path, &error),
        error => FileError::new(path, error.to_string()),
    }
}

/// Decodes the records in a chunk.
fn contents(chunk: &[u8]) -> Result<Vec<Record<'static>>, McapError> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(LONGEST);
    let mut reader = LinearReader::new_with_options(options);
    let length = (chunk.len() as u64).to_le_bytes();
    let bytes = [&[records::op::CHUNK], length.as_slice(), chunk].concat();
    let mut file = Cursor::new(bytes);
    let mut records = Vec::new();
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::Record { opcode, data } => {
                records.push(mcap::parse_record(opcode, data)?.into_owned());
            }
            LinearReadEvent::ReadRequest(wanted) => {
                let read = file.read(reader.insert(wanted))?;
                reader.notify_read(read);
            }
        }
    }
    Ok(records)
}

/// Returns whether the file ends as every whole one does; true for a pipe, which cannot seek.
fn ends(file: &mut File) -> io::Result<bool> {
    let mut last = [0; mcap::MAGIC.len()];
    let read =
        file.seek(SeekFrom::End(-(last.len() as i64))).and_then(|_| file.read_exact(&mut last));
    match file.rewind() {
        Err(error) if error.kind() != ErrorKind::NotSeekable => Err(error),
        Err(_) => Ok(true),
        Ok(()) => Ok(read.is_ok() && last.as_slice() == mcap::MAGIC),
    }
}

/// Opens a file and reads to its first row.
pub(crate) fn open(path: &Path) -> Result<Recording, FileError> {
    let mut file = File::open(path).map_err(|error| FileError::io(path, &error))?;
    let whole = ends(&mut file).map_err(|error| FileError::io(path, &error))?;
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_skip_end_magic(true)
        .with_record_length_limit(LONGEST);
    let mut rows = Rows {
        path: path.to_owned(),
        file: BufReader::new(file),
        reader: LinearReader::new_with_options(options),
        header: Header::default(),
        schemas: BTreeMap::new(),
        channel: None,
        ready: VecDeque::new(),
        given: 0,
        over: false,
    };
    while rows.ready.is_empty() && !rows.over {
        rows.record();
    }
    let Some((_, columns)) = rows.channel.clone() else {
        return Err(match rows.ready.pop_front() {
            Some(Err(error)) => error,
            _ => FileError::new(path, "holds no channel of taxel frames")
                .mend("`taxel record` and `taxel export` write one"),
        });
    };
    Ok(Recording { header: rows.header.clone(), columns, whole, rows: Box::new(rows) })
}

struct Rows {
    path: PathBuf,
    file: BufReader<File>,
    reader: LinearReader,
    header: Header,
    schemas: BTreeMap<u16, Vec<u8>>,
    /// First channel of frames with its columns.
    channel: Option<(u16, Vec<Column>)>,
    ready: VecDeque<Result<Vec<Cell>, FileError>>,
    given: u64,
    over: bool,
}

impl Iterator for Rows {
    type Item = Result<Vec<Cell>, FileError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.ready.is_empty() && !self.over {
            self.record();
        }
        let row = self.ready.pop_front()?;
        self.given += u64::from(row.is_ok());
        Some(row)
    }
}

impl Rows {
    /// Reads one record of the file.
    fn record(&mut self) {
        let (opcode, data) = loop {
            match self.reader.next_event() {
                None => {
                    self.over = true;
                    return;
                }
                Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                    break (opcode, data.to_vec());
                }
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    match self.file.read(self.reader.insert(wanted)) {
                        Ok(read) => self.reader.notify_read(read),
                        Err(error) => return self.end(FileError::io(&self.path, &error)),
                    }
                }
                // A killed writer's file ends early and still holds all flushed rows.
                Some(Err(McapError::UnexpectedEof)) if self.channel.is_some() => {
                    self.over = true;
                    return;
                }
                Some(Err(error)) => return self.end(self.damaged(&error)),
            }
        };
        if opcode == records::op::CHUNK {
            return self.chunk(&data);
        }
        match mcap::parse_record(opcode, &data) {
            Ok(record) => {
                let mut rows = Vec::new();
                self.item(record, &mut rows);
                self.ready.extend(rows);
            }
            Err(error) => self.end(self.damaged(&error)),
        }
    }

    /// Reads a chunk after its CRC is checked: all of its rows or none.
    fn chunk(&mut self, chunk: &[u8]) {
        let mut rows = Vec::new();
        match contents(chunk) {
            Ok(records) => records.into_iter().for_each(|record| self.item(record, &mut rows)),
            Err(error) => rows.push(Err(self.damaged(&error))),
        }
        self.ready.extend(rows);
    }

    fn item(&mut self, record: Record, rows: &mut Vec<Result<Vec<Cell>, FileError>>) {
        match record {
            Record::Metadata(metadata) if metadata.name == METADATA => {
                self.header.facts = metadata.metadata;
            }
            Record::Attachment { header, data, .. } if header.name == CALIBRATION => {
                self.header.calibration = String::from_utf8(data.into_owned()).ok();
            }
            Record::Schema { header, data } if header.name == schema::NAME => {
                self.schemas.insert(header.id, data.into_owned());
            }
            Record::Channel(channel) if self.channel.is_none() => {
                let columns = self.schemas.get(&channel.schema_id).and_then(|s| schema::columns(s));
                self.channel = columns.map(|columns| (channel.id, columns));
            }
            Record::Message { header, data } => {
                let Some((id, columns)) = &self.channel else { return };
                if header.channel_id == *id {
                    let row = schema::decode(&data, columns);
                    rows.push(row.ok_or_else(|| {
                        FileError::new(&self.path, "a message does not match its schema")
                            .mend("this row is left out")
                    }));
                }
            }
            _ => {}
        }
    }

    fn damaged(&self, error: &McapError) -> FileError {
        let after = self.given + self.ready.iter().filter(|row| row.is_ok()).count() as u64;
        FileError::new(&self.path, format!("damaged after row {after}: {error}"))
            .mend("`taxel export` saves what can still be read")
    }

    /// Ends the reading with an error.
    fn end(&mut self, error: FileError) {
        self.over = true;
        self.ready.push_back(Err(error));
    }
}
