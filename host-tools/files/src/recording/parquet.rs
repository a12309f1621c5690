//! Recordings in Parquet, for tables.
//!
//! Whole numbers are INT64 and real ones FLOAT. After a measured column `fx_n` comes
//! `fx_n_withheld`, the reason in words for a missing value. Facts and calibration are key-value
//! metadata.
//!
//! A Parquet file is unreadable without its end, so it is unsafe to write while a stream runs:
//! `spooled.rs` keeps the rows meanwhile.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::FileError;
use crate::frames::{Cell, Column, Kind, reason};
use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, FloatType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::{KeyValue, RowGroupMetaData};
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::serialized_reader::ReadOptionsBuilder;
use parquet::file::statistics::Statistics;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::record::{Field, Row};
use parquet::schema::types::{Type, TypePtr};
use taxel::measured::NoValue;

use crate::recording::header::Header;
use crate::recording::{Existing, Recording, Sink, begin, in_order};

const WITHHELD: &str = "_withheld";
const CALIBRATION: &str = "calibration";
/// Rows in memory before a write: four seconds of the fastest stream.
const GROUP: usize = 16_384;

/// Writer of a table, which is unreadable before its end.
pub(crate) struct Writer {
    path: PathBuf,
    columns: Vec<Column>,
    file: SerializedFileWriter<BufWriter<File>>,
    group: Vec<Vec<Cell>>,
}

impl Writer {
    pub(crate) fn create(
        path: &Path,
        header: &Header,
        columns: &[Column],
        existing: Existing,
    ) -> Result<Self, FileError> {
        let failed = |error: ParquetError| failed(path, error);
        let file = begin(path, existing)?;
        let facts = header.facts.clone().into_iter();
        let calibration = header.calibration.clone().map(|text| (CALIBRATION.to_owned(), text));
        let pairs =
            facts.chain(calibration).map(|(key, value)| KeyValue { key, value: Some(value) });
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_created_by(concat!("taxel ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_key_value_metadata(Some(pairs.collect()))
            .build();
        let schema = schema(columns).map_err(failed)?;
        let file = SerializedFileWriter::new(BufWriter::new(file), schema, Arc::new(properties))
            .map_err(failed)?;
        let group = Vec::with_capacity(GROUP);
        Ok(Self { path: path.to_owned(), columns: columns.to_owned(), file, group })
    }

    fn end_group(&mut self) -> Result<(), FileError> {
        let mut written = || {
            let mut group = self.file.next_row_group()?;
            write_group(&mut group, &self.columns, &self.group)?;
            group.close()
        };
        written().map_err(|error| failed(&self.path, error))?;
        self.group.clear();
        Ok(())
    }
}

impl Sink for Writer {
    fn write(&mut self, row: &[Cell]) -> Result<(), FileError> {
        self.group.push(row.to_owned());
        if self.group.len() == GROUP { self.end_group() } else { Ok(()) }
    }

    /// Does nothing, because a file without its end holds nothing readable.
    fn flush(&mut self) -> Result<(), FileError> {
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), FileError> {
        if !self.group.is_empty() {
            self.end_group()?;
        }
        let Self { path, file, .. } = *self;
        file.close().map(drop).map_err(|error| failed(&path, error))
    }
}

fn schema(columns: &[Column]) -> Result<TypePtr, ParquetError> {
    let optional = |name: &str, physical, logical| {
        Type::primitive_type_builder(name, physical)
            .with_repetition(Repetition::OPTIONAL)
            .with_logical_type(logical)
            .build()
            .map(Arc::new)
    };
    let mut fields = Vec::new();
    for column in columns {
        let physical = if column.kind == Kind::Whole { Physical::INT64 } else { Physical::FLOAT };
        fields.push(optional(&column.name, physical, None)?);
        if column.kind == Kind::Measured {
            let name = format!("{}{WITHHELD}", column.name);
            fields.push(optional(&name, Physical::BYTE_ARRAY, Some(LogicalType::String))?);
        }
    }
    Type::group_type_builder("frame").with_fields(fields).build().map(Arc::new)
}

fn write_group(
    group: &mut SerializedRowGroupWriter<'_, BufWriter<File>>,
    columns: &[Column],
    rows: &[Vec<Cell>],
) -> Result<(), ParquetError> {
    for (at, column) in columns.iter().enumerate() {
        let cells = rows.iter().map(|row| row.get(at).copied().unwrap_or(Cell::Empty));
        if column.kind == Kind::Whole {
            write_column::<Int64Type>(group, cells, |cell| match cell {
                Cell::Whole(whole) => i64::try_from(whole).ok(),
                _ => None,
            })?;
            continue;
        }
        write_column::<FloatType>(group, cells.clone(), |cell| match cell {
            Cell::Real(real) => Some(real),
            _ => None,
        })?;
        if column.kind == Kind::Measured {
            write_column::<ByteArrayType>(group, cells, |cell| match cell {
                Cell::Withheld(why) => Some(ByteArray::from(reason(why))),
                _ => None,
            })?;
        }
    }
    Ok(())
}

fn write_column<T: parquet::data_type::DataType>(
    group: &mut SerializedRowGroupWriter<'_, BufWriter<File>>,
    cells: impl Iterator<Item = Cell>,
    value: impl Fn(Cell) -> Option<T::T>,
) -> Result<(), ParquetError> {
    let cells: Vec<_> = cells.map(value).collect();
    let levels: Vec<i16> = cells.iter().map(|cell| cell.is_some().into()).collect();
    let values: Vec<_> = cells.into_iter().flatten().collect();
    let Some(mut writer) = group.next_column()? else {
        return Err(ParquetError::General("fewer columns than cells".to_owned()));
    };
    writer.typed::<T>().write_batch(&values, Some(&levels), None)?;
    writer.close()
}

fn failed(path: &Path, error: ParquetError) -> FileError {
    match error {
        ParquetError::External(source) => match source.downcast::<std::io::Error>() {
            Ok(error) => FileError::io(path, &error),
            Err(error) => FileError::new(path, error.to_string()),
        },
        error => FileError::new(path, error.to_string()),
    }
}

/// Opens a Parquet recording.
pub(crate) fn open(path: &Path) -> Result<Recording, FileError> {
    open_at(path, None)
}

/// Opens a Parquet recording at the row group in which a device time in µs lies, or at its start if
/// that cannot be found.
pub(crate) fn open_from(path: &Path, micros: u64) -> Result<Recording, FileError> {
    open_at(path, Some(micros))
}

fn open_at(path: &Path, micros: Option<u64>) -> Result<Recording, FileError> {
    let unreadable = |error: ParquetError| {
        failed(path, error)
            .mend("is it a whole Parquet file? One that was cut short cannot be read")
    };
    let file = File::open(path).map_err(|error| FileError::io(path, &error))?;
    let open = |first: usize| {
        let file = file.try_clone()?;
        let rows = ReadOptionsBuilder::new().with_predicate(Box::new(move |_, at| at >= first));
        guarded(|| SerializedFileReader::new_with_options(file, rows.build()))
    };
    let mut reader = open(0).map_err(unreadable)?;
    let group = micros.and_then(|micros| group_before(reader.metadata().row_groups(), micros));
    if let Some(group) = group {
        reader = open(group).map_err(unreadable)?;
    }
    let metadata = reader.metadata().file_metadata();
    let mut header = Header::default();
    for pair in metadata.key_value_metadata().into_iter().flatten() {
        match &pair.value {
            Some(text) if pair.key == CALIBRATION => header.calibration = Some(text.clone()),
            Some(value) => drop(header.facts.insert(pair.key.clone(), value.clone())),
            None => {}
        }
    }
    let fields = metadata.schema().get_fields();
    let columns = columns(fields).filter(|columns| columns.iter().any(|c| c.name == "t_us"));
    let Some(columns) = columns else {
        return Err(FileError::new(path, "holds no taxel frames")
            .mend("`taxel record` and `taxel export` write one"));
    };
    let path = path.to_owned();
    let kinds = columns.clone();
    let mut rows = reader.into_iter();
    let mut over = false;
    // The reader stops at an error, because the library repeats it forever.
    let rows = std::iter::from_fn(move || {
        let next = if over { None } else { guarded(|| rows.next().transpose()).transpose() };
        let row = next?;
        over = row.is_err();
        Some(row.map(|row| cells(&row, &kinds)).map_err(|error| failed(&path, error)))
    });
    Ok(Recording { header, columns, whole: true, rows: Box::new(rows) })
}

/// Returns the last group whose first row is not after `micros` of device time, by the groups'
/// statistics. `None` if they do not tell, or if the finger restarted.
fn group_before(groups: &[RowGroupMetaData], micros: u64) -> Option<usize> {
    let (first, last) = (groups.first()?, groups.last()?);
    if !in_order(|name| Some((bounds(first, name)?.0, bounds(last, name)?.1))) {
        return None;
    }
    let times: Option<Vec<_>> = groups.iter().map(|group| bounds(group, "t_us")).collect();
    let times = times.filter(|times| times.is_sorted_by(|before, next| before.1 < next.0))?;
    times.partition_point(|(begin, _)| *begin <= micros).checked_sub(1)
}

/// Returns the least and the largest number of a group's column.
fn bounds(group: &RowGroupMetaData, name: &str) -> Option<(u64, u64)> {
    let column = group.columns().iter().find(|column| column.column_path().string() == name)?;
    let Some(Statistics::Int64(numbers)) = column.statistics() else { return None };
    Some((u64::try_from(*numbers.min_opt()?).ok()?, u64::try_from(*numbers.max_opt()?).ok()?))
}

/// Turns panics of the library on a damaged file into errors.
fn guarded<T>(read: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, ParquetError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(read))
        .unwrap_or_else(|_| Err(ParquetError::General("damaged".to_owned())))
}

/// Recovers the columns from their [`schema`].
fn columns(fields: &[TypePtr]) -> Option<Vec<Column>> {
    let mut columns: Vec<Column> = Vec::new();
    for field in fields {
        let name = field.name();
        if !field.is_primitive() {
            return None;
        }
        let kind = match field.get_physical_type() {
            Physical::INT64 => Kind::Whole,
            Physical::FLOAT => Kind::Real,
            Physical::BYTE_ARRAY => {
                let last =
                    columns.last_mut().filter(|c| name.strip_suffix(WITHHELD) == Some(&c.name))?;
                last.kind = Kind::Measured;
                continue;
            }
            _ => return None,
        };
        columns.push(Column { name: name.to_owned(), kind });
    }
    Some(columns)
}

fn cells(row: &Row, columns: &[Column]) -> Vec<Cell> {
    let mut fields = row.get_column_iter().map(|(_, field)| field);
    let mut next = || fields.next().unwrap_or(&Field::Null);
    let cell = |column: &Column| {
        let value = next();
        let why = if column.kind == Kind::Measured { next() } else { &Field::Null };
        match (value, why) {
            (Field::Long(whole), _) => Cell::Whole(whole.unsigned_abs()),
            (Field::Float(real), _) => Cell::Real(*real),
            (_, Field::Str(words)) => {
                let why = NoValue::ALL.into_iter().find(|why| reason(*why) == words);
                why.map_or(Cell::Empty, Cell::Withheld)
            }
            _ => Cell::Empty,
        }
    };
    columns.iter().map(cell).collect()
}
