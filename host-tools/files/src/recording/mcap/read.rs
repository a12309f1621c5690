//! Reads rows, facts and calibration of an MCAP file, damaged or not.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::{Record, op};

use super::chunk::{Chunk, Records};
use super::container::{Container, Found};
use super::{CALIBRATION, FACTS_CRC, METADATA, facts_crc, seek};
use crate::FileError;
use crate::frames::{Cell, Column};
use crate::recording::header::Header;
use crate::recording::{Recording, schema};

/// Opens a file and reads to its first row.
pub(crate) fn open(path: &Path) -> Result<Recording, FileError> {
    open_at(path, None)
}

/// Opens a file at the chunk in which a device time in µs lies, or at its start if that cannot be
/// found.
pub(crate) fn open_from(path: &Path, micros: u64) -> Result<Recording, FileError> {
    open_at(path, Some(micros))
}

fn open_at(path: &Path, micros: Option<u64>) -> Result<Recording, FileError> {
    let failed = |error: io::Error| FileError::io(path, &error);
    let container = File::open(path).and_then(Container::new).map_err(failed)?;
    let (begins, whole) = (container.begins, container.ends);
    let mut rows = Rows {
        path: path.to_owned(),
        container,
        chunk: None,
        about: About::default(),
        ready: None,
        given: 0,
        moved: false,
        over: false,
    };
    let mut damage = (!begins).then(|| rows.damaged("Bad magic number"));
    while rows.ready.is_none() && !rows.over {
        rows.ready = rows.step();
        if let Some(Err(error)) = rows.ready.take_if(|row| row.is_err()) {
            damage.get_or_insert(error);
        }
    }
    if damage.is_some() || !rows.about.sound || rows.about.calibration.is_none() {
        rows.about.complete(path).map_err(failed)?;
    }
    let Some(channel) = rows.about.channel.clone() else {
        // Without the columns no row can be read.
        let damage = damage.map(|error| error.mend("no frame of it can be read: record again"));
        return Err(damage.unwrap_or_else(|| {
            FileError::new(path, "holds no channel of taxel frames")
                .mend("`taxel record` and `taxel export` write one")
        }));
    };
    if !rows.about.sound && (rows.about.checked || rows.about.facts.is_empty()) {
        let problem = "the finger's settings are damaged, and so may be what is computed from them";
        damage.get_or_insert_with(|| rows.damaged(problem));
    }
    if let Some(micros) = micros.filter(|_| damage.is_none())
        && let Some(start) = seek::chunk_before(path, micros, &channel).map_err(failed)?
    {
        rows.jump(start).map_err(failed)?;
    }
    let (_, columns) = channel;
    let header =
        Header { facts: rows.about.facts.clone(), calibration: rows.about.calibration.take() };
    let rows = damage.map(Err).into_iter().chain(rows);
    Ok(Recording { header, columns, whole, rows: Box::new(rows) })
}

/// Facts about the finger and the columns of its frames, as far as they were found.
#[derive(Default)]
struct About {
    facts: BTreeMap<String, String>,
    calibration: Option<String>,
    schemas: BTreeMap<u16, Vec<u8>>,
    /// First channel of frames with its columns.
    channel: Option<(u16, Vec<Column>)>,
    /// Whether the facts agree with their CRC.
    sound: bool,
    /// Whether there is such a CRC; recordings of taxel 0.1 have none.
    checked: bool,
}

impl About {
    /// Takes what a record tells, unless it is known.
    fn learn(&mut self, record: Record) {
        match record {
            Record::Metadata(metadata) if metadata.name == METADATA && !self.sound => {
                self.facts = metadata.metadata;
                let stated = self.facts.remove(FACTS_CRC);
                self.checked |= stated.is_some();
                self.sound = stated.is_some_and(|crc| crc == facts_crc(&self.facts));
            }
            Record::Attachment { header, data, .. }
                if header.name == CALIBRATION && self.calibration.is_none() =>
            {
                self.calibration = String::from_utf8(data.into_owned()).ok();
            }
            Record::Schema { header, data } if header.name == schema::NAME => {
                self.schemas.insert(header.id, data.into_owned());
            }
            Record::Channel(channel) if self.channel.is_none() => {
                let columns = self.schemas.get(&channel.schema_id).and_then(|s| schema::columns(s));
                self.channel = columns.map(|columns| (channel.id, columns));
            }
            _ => {}
        }
    }

    /// Takes what a record outside the chunks tells.
    fn told(&mut self, opcode: u8, data: &[u8]) -> Result<(), McapError> {
        if [op::METADATA, op::ATTACHMENT, op::SCHEMA, op::CHANNEL].contains(&opcode) {
            self.learn(mcap::parse_record(opcode, data)?);
        }
        Ok(())
    }

    /// Looks for what is missing in the whole file: all of it stands again at the end.
    fn complete(&mut self, path: &Path) -> io::Result<()> {
        let mut container = Container::new(File::open(path)?)?;
        while let Some(found) = container.next()? {
            // A damaged record outside the chunks may stand whole again.
            if let Found::Other { opcode, data } = found {
                let _ = self.told(opcode, &data);
            }
        }
        Ok(())
    }
}

struct Rows {
    path: PathBuf,
    container: Container,
    /// Rest of the chunk that is read.
    chunk: Option<Records>,
    about: About,
    ready: Option<Result<Vec<Cell>, FileError>>,
    given: u64,
    /// Whether the rows before a stretch were left out.
    moved: bool,
    over: bool,
}

impl Iterator for Rows {
    type Item = Result<Vec<Cell>, FileError>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut row = self.ready.take();
        while row.is_none() && !self.over {
            row = self.step();
        }
        self.given += u64::from(matches!(row, Some(Ok(_))));
        row
    }
}

impl Rows {
    /// Continues at the record that begins at `start`.
    fn jump(&mut self, start: u64) -> io::Result<()> {
        self.container.jump(start)?;
        (self.chunk, self.ready, self.over, self.moved) = (None, None, false, true);
        Ok(())
    }

    /// Reads one record, which may be a row.
    fn step(&mut self) -> Option<Result<Vec<Cell>, FileError>> {
        if let Some(chunk) = &mut self.chunk {
            match chunk.next() {
                Some(Ok(record)) => return self.item(record),
                Some(Err(error)) => {
                    self.chunk = None;
                    return Some(Err(self.damaged(error)));
                }
                None => self.chunk = None,
            }
        }
        match self.container.next() {
            Ok(Some(Found::Chunk(chunk))) => self.begin(&chunk),
            Ok(Some(Found::Other { opcode: op::DATA_END, .. }) | None) => {
                self.over = true;
                None
            }
            Ok(Some(Found::Other { opcode: op::MESSAGE, data })) => {
                match mcap::parse_record(op::MESSAGE, &data) {
                    Ok(record) => self.item(record),
                    Err(error) => Some(Err(self.damaged(error))),
                }
            }
            Ok(Some(Found::Other { opcode, data })) => {
                self.about.told(opcode, &data).err().map(|error| Err(self.loss(error)))
            }
            Ok(Some(Found::Damage(problem))) => Some(Err(self.loss(problem))),
            Err(error) => {
                self.over = true;
                Some(Err(FileError::io(&self.path, &error)))
            }
        }
    }

    /// Begins a chunk whose CRC is right, else loses all of its rows.
    fn begin(&mut self, chunk: &Chunk) -> Option<Result<Vec<Cell>, FileError>> {
        match chunk.records() {
            Ok(records) => {
                self.chunk = Some(records);
                None
            }
            Err(error) => Some(Err(self.loss(error))),
        }
    }

    /// Returns the error of lost bytes, which may have held the channel.
    fn loss(&mut self, problem: impl std::fmt::Display) -> FileError {
        if self.about.channel.is_none()
            && let Err(error) = self.about.complete(&self.path)
        {
            return FileError::io(&self.path, &error);
        }
        self.damaged(problem)
    }

    fn item(&mut self, record: Record) -> Option<Result<Vec<Cell>, FileError>> {
        let Record::Message { header, data } = record else {
            self.about.learn(record);
            return None;
        };
        let (_, columns) =
            self.about.channel.as_ref().filter(|(id, _)| *id == header.channel_id)?;
        let row = schema::decode(&data, columns);
        Some(row.ok_or_else(|| {
            FileError::new(&self.path, "a message does not match its schema")
                .mend("this row is left out")
        }))
    }

    fn damaged(&self, problem: impl std::fmt::Display) -> FileError {
        let (given, part) = (self.given, if self.moved { " of what was read" } else { "" });
        FileError::new(&self.path, format!("damaged after row {given}{part}: {problem}"))
            .mend("`taxel export` saves what can still be read")
    }
}
