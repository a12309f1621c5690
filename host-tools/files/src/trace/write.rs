//! Writer of traces.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use taxel::scan::SENSORS;
use taxel::units::{Code, FullScale};

use super::{SIMULATED_KEY, Sample, TRUTH_COLUMNS, bridge_names, sensor_truth_names, taxel_names};
use crate::error::FileError;

/// Columns of a trace to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceHeader {
    /// Full scale of the codes.
    pub full_scale: FullScale,
    /// Rows of the optical matrix: [`taxel::scan::ROWS`], 1 for a line of taxels, 0 without it.
    pub rows: usize,
    /// Presence of each force sensor.
    pub bridges: [bool; SENSORS],
    /// Presence of the reference channel.
    pub reference: bool,
    /// Presence of the temperature channel.
    pub temperature: bool,
    /// Presence of the finger's truth.
    pub truth: bool,
    /// Presence of the truth of each force sensor with columns.
    pub sensor_truth: bool,
}

/// Writer of a trace, line by line.
pub struct TraceWriter {
    path: PathBuf,
    header: TraceHeader,
    records: csv::Writer<BufWriter<File>>,
    row: Vec<String>,
}

impl TraceWriter {
    /// Creates the file and writes its header.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: impl AsRef<Path>, header: TraceHeader) -> Result<Self, FileError> {
        Self::create_commented(path.as_ref().to_owned(), header, None)
    }

    /// Creates the file of a simulation and writes its header; `origin` is one line that says
    /// which.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create_simulated(
        path: impl AsRef<Path>,
        header: TraceHeader,
        origin: &str,
    ) -> Result<Self, FileError> {
        Self::create_commented(path.as_ref().to_owned(), header, Some(origin))
    }

    fn create_commented(
        path: PathBuf,
        header: TraceHeader,
        origin: Option<&str>,
    ) -> Result<Self, FileError> {
        let mut file =
            BufWriter::new(File::create(&path).map_err(|error| FileError::io(&path, &error))?);
        if header.full_scale != FullScale::BITS_12 {
            writeln!(file, "# full_scale={}", header.full_scale.top().0)
                .map_err(|error| FileError::io(&path, &error))?;
        }
        if let Some(origin) = origin {
            writeln!(file, "# {SIMULATED_KEY}={origin}")
                .map_err(|error| FileError::io(&path, &error))?;
        }
        let mut writer =
            Self { path, header, records: csv::Writer::from_writer(file), row: Vec::new() };
        writer.row.push("t_us".to_owned());
        if header.rows > 0 {
            writer.row.extend(taxel_names(header.rows));
        }
        let present = (0..SENSORS).filter(|i| header.bridges[*i]);
        writer.row.extend(present.clone().flat_map(bridge_names));
        writer.row.extend(header.reference.then(|| "aux_vref".to_owned()));
        writer.row.extend(header.temperature.then(|| "aux_temp".to_owned()));
        if header.truth {
            writer.row.extend(TRUTH_COLUMNS.map(str::to_owned));
        }
        if header.sensor_truth {
            writer.row.extend(present.flat_map(sensor_truth_names));
        }
        writer.flush_row()?;
        Ok(writer)
    }

    /// Writes one line.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&mut self, sample: &Sample) -> Result<(), FileError> {
        let header = self.header;
        let codes = &sample.scan.codes;
        let row = &mut self.row;
        let code = |code: Option<Code>| code.map(|code| code.0.to_string()).unwrap_or_default();
        row.push(sample.scan.time.0.to_string());
        if header.rows > 0 {
            let taxels = codes.taxels.unwrap_or_default();
            let lit = taxels.lit.iter().take(header.rows).flatten();
            row.extend(lit.chain(&taxels.dark).map(|c| c.0.to_string()));
        }
        let present = (0..SENSORS).filter(|i| header.bridges[*i]);
        for i in present.clone() {
            let arms = codes.bridges[i].unwrap_or_default();
            row.extend([arms.a, arms.b, arms.c, arms.d].map(|c| c.0.to_string()));
        }
        row.extend(header.reference.then(|| code(codes.reference)));
        row.extend(header.temperature.then(|| code(codes.temperature)));
        // Micronewtons and nanometres: far below any noise, and the same text on every machine.
        let number = |value: &Option<f64>| value.map(|v| format!("{v:.6}")).unwrap_or_default();
        if header.truth {
            let truth = &sample.truth;
            row.extend(truth.force.iter().chain(&truth.point).map(number));
            row.push(number(&truth.torsion));
            let flag = |f: Option<bool>| f.map(|f| u8::from(f).to_string()).unwrap_or_default();
            row.extend([flag(truth.contact), flag(truth.slip)]);
        }
        if header.sensor_truth {
            row.extend(present.flat_map(|i| sample.truth.sensors[i].each_ref().map(number)));
        }
        self.flush_row()
    }

    fn flush_row(&mut self) -> Result<(), FileError> {
        let written = self.records.write_record(&self.row);
        self.row.clear();
        written.map_err(|error| FileError::csv(&self.path, error))
    }

    /// Ends the file.
    ///
    /// A dropped writer cannot report that the disk was full.
    ///
    /// # Errors
    /// The last lines cannot be written.
    pub fn finish(mut self) -> Result<(), FileError> {
        self.records.flush().map_err(|error| FileError::io(&self.path, &error))
    }
}
