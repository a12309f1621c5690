//! Reader of traces.

use std::collections::HashSet;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use csv::StringRecord;
use taxel::scan::{COLS, Codes, Midpoints, ROWS, SENSORS, Scan, TaxelCodes};
use taxel::units::{Code, FullScale, Micros};

use super::{
    SIMULATED_KEY, Sample, TRUTH_COLUMNS, Truth, bridge_names, is_code, sensor_truth_names,
    taxel_names,
};
use crate::error::FileError;
use crate::lines::Lines;
use crate::number;
use crate::stretch::Stretch;

const FULL_SCALE_KEY: &str = "full_scale";

/// Reader of a trace, line by line.
pub struct TraceReader<R> {
    lines: Lines<R>,
    columns: Columns,
    names: StringRecord,
    record: StringRecord,
    last_time: Option<u64>,
}

impl<R> TraceReader<R> {
    /// Returns the full scale of the codes.
    pub fn full_scale(&self) -> FullScale {
        self.columns.full_scale
    }

    /// Returns the trace's channels.
    pub fn channels(&self) -> Channels {
        Channels {
            rows: self.columns.taxels.as_ref().map_or(0, |(lit, _)| lit.len()),
            bridges: self.columns.bridges.map(|bridge| bridge.is_some()),
        }
    }
}

/// Channels of a trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channels {
    /// Rows of the optical matrix: [`ROWS`], 1 for a line of taxels, 0 without it.
    pub rows: usize,
    /// Presence of each force sensor.
    pub bridges: [bool; SENSORS],
}

impl TraceReader<BufReader<File>> {
    /// Opens a trace and reads its header.
    ///
    /// # Errors
    /// The file cannot be read, or its header is not that of a trace.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        let file = File::open(path).map_err(|error| FileError::io(path, &error))?;
        Self::new(BufReader::new(file), path)
    }
}

impl<R: BufRead> TraceReader<R> {
    /// Reads the header from `source`; `path` is only for messages.
    ///
    /// # Errors
    /// The header is not that of a trace.
    pub fn new(source: R, path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        let mut lines = Lines::new(source, path);
        let mut names = StringRecord::new();
        let mut full_scale = FullScale::BITS_12;
        let header = lines.next(&mut names, |comment, line| {
            if let Some((key, value)) = comment.split_once('=')
                && key.trim() == FULL_SCALE_KEY
            {
                full_scale = parse_full_scale(value, path, line)?;
            }
            Ok(())
        })?;
        let Some(line) = header else {
            return Err(empty(path));
        };
        let columns = Columns::find(&Header { names: &names, path, line }, full_scale)?;
        Ok(Self { lines, columns, names, record: StringRecord::new(), last_time: None })
    }

    fn read(&mut self) -> Result<Option<Sample>, FileError> {
        let Some(line) = self.lines.next_row(&mut self.record, self.names.len())? else {
            return Ok(None);
        };
        let path = self.lines.path();
        let cells = Cells { record: &self.record, names: &self.names, path, line };
        if self.columns.recorded && self.last_time.is_none() {
            self.columns.leave_out_empty(&cells);
        }
        let sample = self.columns.sample(&cells)?;
        let time = sample.scan.time.0;
        if let Some(last) = self.last_time.replace(time)
            && time <= last
        {
            return Err(cells
                .error(self.columns.time, format!("time {time} does not come after {last}"))
                .mend(match restarted(last, time) {
                    Some(end) => format!("the finger restarted here; give FILE@..{end} (seconds)"),
                    None => "sort the lines by t_us".to_owned(),
                }));
        }
        Ok(Some(sample))
    }
}

impl<R: BufRead> Iterator for TraceReader<R> {
    type Item = Result<Sample, FileError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read().transpose()
    }
}

/// End in seconds of what precedes a restart; `None` if the time does not fall back to near zero.
fn restarted(last: u64, time: u64) -> Option<u64> {
    const NEAR_ZERO_US: u64 = 5_000_000;
    const SECOND_US: u64 = 1_000_000;
    let fallen = last.saturating_sub(time) >= SECOND_US && time < NEAR_ZERO_US.min(last / 2);
    fallen.then_some(last / SECOND_US)
}

fn empty(path: &Path) -> FileError {
    FileError::new(path, "no header: the file is empty")
        .mend("a trace starts with a line of column names, `t_us,lit_r0c0,…`")
}

fn parse_full_scale(value: &str, path: &Path, line: u64) -> Result<FullScale, FileError> {
    value.trim().parse().ok().and_then(FullScale::new).ok_or_else(|| {
        FileError::new(path, format!("expected a whole number 1…65535, found `{value}`"))
            .line(line)
            .column(FULL_SCALE_KEY)
            .mend("write `# full_scale=4095` or `# full_scale=65535`")
    })
}

/// Selects the samples in a time range; stops reading at its end.
pub fn cut<S: Iterator<Item = Result<Sample, FileError>>>(
    samples: S,
    stretch: &Stretch,
) -> impl Iterator<Item = Result<Sample, FileError>> + use<S> {
    let seconds = |sample: &Sample| Stretch::seconds(sample.scan.time.0);
    let (wanted, ended) = (stretch.clone(), stretch.clone());
    samples
        .take_while(move |s| s.as_ref().map_or(true, |s| !ended.ended(seconds(s))))
        .filter(move |s| s.as_ref().map_or(true, |s| wanted.contains(seconds(s))))
}

/// Returns whether a file's header is a trace's and not another CSV's.
///
/// # Errors
/// The file cannot be read, or is empty.
pub fn is_trace(path: impl AsRef<Path>) -> Result<bool, FileError> {
    let names = header(path.as_ref())?;
    Ok(names.iter().any(|name| name == "t_us")
        && names.iter().any(|name| name.starts_with("lit_r") || name.starts_with("bridge_s")))
}

/// Columns of a trace besides codes and truth.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Others {
    /// Names that a trace does not know.
    Unknown(Vec<String>),
    /// Estimates of recorded frames.
    Frames,
}

/// Lists the columns of a trace that its reader skips.
///
/// # Errors
/// The file cannot be read.
pub fn other_columns(path: impl AsRef<Path>) -> Result<Others, FileError> {
    let names = header(path.as_ref())?;
    if names.iter().any(|name| name == "seq") {
        return Ok(Others::Frames);
    }
    let sensors: Vec<String> = (0..SENSORS).flat_map(sensor_truth_names).collect();
    let known = |name: &str| {
        name == "t_us"
            || is_code(name)
            || TRUTH_COLUMNS.contains(&name)
            || sensors.iter().any(|sensor| sensor == name)
    };
    Ok(Others::Unknown(names.iter().filter(|name| !known(name)).map(str::to_owned).collect()))
}

/// Reads the header line of a table or trace.
fn header(path: &Path) -> Result<StringRecord, FileError> {
    let file = File::open(path).map_err(|error| FileError::io(path, &error))?;
    let mut names = StringRecord::new();
    let header = Lines::new(BufReader::new(file), path).next(&mut names, |_, _| Ok(()))?;
    header.ok_or_else(|| empty(path)).map(|_| names)
}

/// Returns how a table or trace was simulated; `None` unless its comments say so.
///
/// # Errors
/// The file cannot be read.
pub fn simulated(path: impl AsRef<Path>) -> Result<Option<String>, FileError> {
    let path = path.as_ref();
    let file = File::open(path).map_err(|error| FileError::io(path, &error))?;
    for line in BufReader::new(file).lines() {
        let line = line.map_err(|error| FileError::io(path, &error))?;
        let Some(comment) = line.strip_prefix('#') else { break };
        if let Some((key, value)) = comment.split_once('=')
            && key.trim() == SIMULATED_KEY
        {
            return Ok(Some(value.trim().to_owned()));
        }
    }
    Ok(None)
}

/// Position of each channel in a line.
struct Columns {
    full_scale: FullScale,
    /// True for frames of a finger that include its codes.
    recorded: bool,
    time: usize,
    taxels: Option<(Vec<[usize; COLS]>, [usize; COLS])>,
    bridges: [Option<[usize; 4]>; SENSORS],
    reference: Option<usize>,
    temperature: Option<usize>,
    truth: [Option<usize>; TRUTH_COLUMNS.len()],
    sensors: [[Option<usize>; 3]; SENSORS],
}

impl Columns {
    fn find(header: &Header, full_scale: FullScale) -> Result<Self, FileError> {
        header.names_are_unique()?;
        let time = header.find("t_us").ok_or_else(|| {
            header.missing("t_us").mend("a trace needs device time in microseconds")
        })?;
        // Columns beyond row 0 and the dark codes belong to the other rows.
        let line = taxel_names(1);
        let mut others = taxel_names(ROWS).into_iter().filter(|name| !line.contains(name));
        let rows = if others.any(|name| header.find(&name).is_some()) { ROWS } else { 1 };
        let taxels = header.group(&taxel_names(rows))?.map(|at| {
            let (lit, dark) = at.split_at(rows * COLS);
            let lit = lit.chunks_exact(COLS).map(|row| std::array::from_fn(|c| row[c]));
            (lit.collect(), std::array::from_fn(|c| dark[c]))
        });
        let mut bridges = [None; SENSORS];
        for (i, bridge) in bridges.iter_mut().enumerate() {
            *bridge = header.group(&bridge_names(i))?.map(|at| std::array::from_fn(|k| at[k]));
        }
        if taxels.is_none() && bridges.iter().all(Option::is_none) {
            return Err(header.missing("lit_r0c0").mend(
                "a trace has lit_r0c0…lit_r3c3 with dark_c0…dark_c3, or bridge_s0_a…, or both",
            ));
        }
        // A finger's estimates are no truth, whatever their columns are called.
        let recorded = header.find("seq").is_some();
        let truth = |name: &str| if recorded { None } else { header.find(name) };
        Ok(Self {
            full_scale,
            recorded,
            time,
            taxels,
            bridges,
            reference: header.find("aux_vref"),
            temperature: header.find("aux_temp"),
            truth: TRUTH_COLUMNS.map(truth),
            sensors: std::array::from_fn(|i| sensor_truth_names(i).map(|name| truth(&name))),
        })
    }

    /// Drops channels that the finger lacks: all their cells are empty, also the first row's.
    fn leave_out_empty(&mut self, cells: &Cells) {
        let empty = |at: usize| cells.text(at).is_empty();
        self.taxels
            .take_if(|(lit, dark)| lit.iter().chain([&*dark]).flatten().all(|at| empty(*at)));
        for bridge in &mut self.bridges {
            bridge.take_if(|midpoints| midpoints.iter().all(|at| empty(*at)));
        }
        self.reference.take_if(|at| empty(*at));
        self.temperature.take_if(|at| empty(*at));
    }

    fn sample(&self, cells: &Cells) -> Result<Sample, FileError> {
        let code = |at: usize| cells.code(at, self.full_scale);
        let taxels = match &self.taxels {
            None => None,
            Some((lit, dark)) => {
                let mut read = [Code(0); COLS];
                let mut row = |at: &[usize; COLS]| -> Result<[Code; COLS], FileError> {
                    for (slot, at) in read.iter_mut().zip(at) {
                        *slot = code(*at)?;
                    }
                    Ok(read)
                };
                let mut codes = TaxelCodes::default();
                for (slot, at) in codes.lit.iter_mut().zip(lit) {
                    *slot = row(at)?;
                }
                codes.dark = row(dark)?;
                // A row without LEDs reads the dark codes.
                codes.lit.iter_mut().skip(lit.len()).for_each(|row| *row = codes.dark);
                Some(codes)
            }
        };
        let mut bridges = [None; SENSORS];
        for (bridge, at) in bridges.iter_mut().zip(&self.bridges) {
            if let Some([a, b, c, d]) = *at {
                *bridge = Some(Midpoints { a: code(a)?, b: code(b)?, c: code(c)?, d: code(d)? });
            }
        }
        let codes = Codes {
            full_scale: self.full_scale,
            taxels,
            bridges,
            reference: self.reference.map(code).transpose()?,
            temperature: self.temperature.map(code).transpose()?,
        };
        let scan = Scan { time: Micros(cells.time(self.time)?), lost: 0, codes };
        Ok(Sample { scan, truth: self.truth(cells)? })
    }

    fn truth(&self, cells: &Cells) -> Result<Truth, FileError> {
        let [fx, fy, fz, x, y, torsion, contact, slip] = self.truth;
        let mut sensors = [[None; 3]; SENSORS];
        for (value, at) in sensors.iter_mut().flatten().zip(self.sensors.iter().flatten()) {
            *value = cells.number(*at)?;
        }
        Ok(Truth {
            force: [cells.number(fx)?, cells.number(fy)?, cells.number(fz)?],
            point: [cells.number(x)?, cells.number(y)?],
            point_sigma: None,
            torsion: cells.number(torsion)?,
            contact: cells.flag(contact)?,
            slip: cells.flag(slip)?,
            sensors,
        })
    }
}

/// Header line with the place for its errors.
struct Header<'a> {
    names: &'a StringRecord,
    path: &'a Path,
    line: u64,
}

impl Header<'_> {
    fn find(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|other| other == name)
    }

    fn missing(&self, name: &str) -> FileError {
        FileError::new(self.path, "the column is missing").line(self.line).column(name)
    }

    fn names_are_unique(&self) -> Result<(), FileError> {
        let mut seen = HashSet::new();
        match self.names.iter().find(|name| !seen.insert(*name)) {
            None => Ok(()),
            Some(name) => Err(FileError::new(self.path, "duplicate column")
                .line(self.line)
                .column(name)
                .mend("remove one of them")),
        }
    }

    /// Finds channels that come all together or not at all.
    fn group(&self, wanted: &[String]) -> Result<Option<Vec<usize>>, FileError> {
        let found: Vec<_> = wanted.iter().map(|name| self.find(name)).collect();
        if found.iter().all(Option::is_none) {
            return Ok(None);
        }
        found
            .into_iter()
            .zip(wanted)
            .map(|(at, name)| {
                at.ok_or_else(|| {
                    self.missing(name).mend(format!(
                        "add it, or leave out all of {} … {}",
                        wanted.first().map_or("", String::as_str),
                        wanted.last().map_or("", String::as_str)
                    ))
                })
            })
            .collect::<Result<Vec<_>, _>>()
            .map(Some)
    }
}

/// Cells of a line with the place for their errors.
struct Cells<'a> {
    record: &'a StringRecord,
    names: &'a StringRecord,
    path: &'a Path,
    line: u64,
}

impl Cells<'_> {
    fn text(&self, at: usize) -> &str {
        self.record.get(at).unwrap_or_default()
    }

    fn error(&self, at: usize, problem: impl Into<String>) -> FileError {
        FileError::new(self.path, problem)
            .line(self.line)
            .column(self.names.get(at).unwrap_or_default())
    }

    fn time(&self, at: usize) -> Result<u64, FileError> {
        self.text(at).parse().map_err(|_| {
            self.error(at, format!("expected whole microseconds, found `{}`", self.text(at)))
                .mend("times are counted from 0 upwards, without decimals")
        })
    }

    fn code(&self, at: usize, full_scale: FullScale) -> Result<Code, FileError> {
        let top = full_scale.top().0;
        let code: u32 = self.text(at).parse().map_err(|_| {
            self.error(at, format!("expected a whole code 0…{top}, found `{}`", self.text(at)))
                .mend("codes are what the ADC read; a sensor that is absent has no column")
        })?;
        match u16::try_from(code) {
            Ok(code) if code <= top => Ok(Code(code)),
            _ => Err(self.error(at, format!("code {code} is above full scale {top}")).mend(
                "if the codes are scaled to 16 bits, make `# full_scale=65535` the first line",
            )),
        }
    }

    /// Parses a number of the truth; an empty cell is unknown.
    fn number(&self, at: Option<usize>) -> Result<Option<f64>, FileError> {
        let Some(at) = at else { return Ok(None) };
        match self.text(at) {
            "" => Ok(None),
            text => number::measured(text).map(Some).map_err(|problem| {
                self.error(at, problem).mend("leave the cell empty where the value is not known")
            }),
        }
    }

    fn flag(&self, at: Option<usize>) -> Result<Option<bool>, FileError> {
        let Some(at) = at else { return Ok(None) };
        match self.text(at) {
            "" => Ok(None),
            "0" => Ok(Some(false)),
            "1" => Ok(Some(true)),
            text => Err(self
                .error(at, format!("expected 0 or 1, found `{text}`"))
                .mend("leave the cell empty where it is not known")),
        }
    }
}
