//! Frames CSV: what the finger said, one line a frame.
//!
//! `t_us seq status`, then a column for every value of the chosen fields, unit in the name; an empty cell
//! is a value that the finger did not give.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use taxel::estimate::slip::Verdict;
use taxel::estimate::{Force, NormalContact};
use taxel::frame::{Fields, Frame, Status};
use taxel::measured::Measured;
use taxel::scan::{ROWS, SENSORS, TAXELS};
use taxel::units::{Millimetres, Newtons};

use crate::error::FileError;
use crate::trace::{bridge_names, sensor_truth_names, taxel_names};

/// Writes frames line by line.
pub struct FramesWriter {
    path: PathBuf,
    fields: Fields,
    records: csv::Writer<BufWriter<File>>,
    row: Vec<String>,
}

impl FramesWriter {
    /// Creates the file and writes its header.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: impl AsRef<Path>, fields: Fields) -> Result<Self, FileError> {
        let path = path.as_ref().to_owned();
        let file = File::create(&path).map_err(|error| FileError::io(&path, &error))?;
        let records = csv::Writer::from_writer(BufWriter::new(file));
        let mut writer = Self { path, fields, records, row: header(fields) };
        writer.flush_row()?;
        Ok(writer)
    }

    /// One line.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&mut self, frame: &Frame) -> Result<(), FileError> {
        let row = &mut self.row;
        row.push(frame.time.0.to_string());
        row.push(frame.seq.to_string());
        row.push(frame.status.0.to_string());
        let on = |field| self.fields.contains(field);
        if on(Fields::FORCE) {
            push_force(row, frame.force);
        }
        if on(Fields::POINT) {
            let point = frame.point.and_then(Result::ok);
            let cell = |value: Option<Millimetres>| value.map(|v| v.0.to_string());
            row.push(cell(point.map(|p| p.x)).unwrap_or_default());
            row.push(cell(point.map(|p| p.y)).unwrap_or_default());
        }
        if on(Fields::TORSION) {
            let torsion = frame.torsion.and_then(Result::ok);
            row.push(torsion.map(|torsion| torsion.0.to_string()).unwrap_or_default());
        }
        row.push(u8::from(frame.status.contains(Status::CONTACT)).to_string());
        if on(Fields::SLIP) {
            row.push(u8::from(frame.status.contains(Status::SLIDES)).to_string());
            let verdict = frame.slip.and_then(Result::ok);
            let cell = |value: fn(&Verdict) -> f32| {
                verdict.as_ref().map(|verdict| value(verdict).to_string()).unwrap_or_default()
            };
            row.extend([cell(|v| v.margin), cell(|v| v.friction), cell(|v| v.grip.0)]);
        }
        if on(Fields::CONTACTS) {
            let contacts = frame.contacts.and_then(Result::ok);
            for i in 0..2 {
                let contact = contacts.map(|contacts| contacts[i]);
                let cell = |value: fn(&NormalContact) -> f32| {
                    contact.as_ref().map(|contact| value(contact).to_string()).unwrap_or_default()
                };
                row.extend([cell(|c| c.point.x.0), cell(|c| c.point.y.0), cell(|c| c.normal.0)]);
            }
        }
        if on(Fields::SENSORS) {
            for i in 0..SENSORS {
                push_force(row, frame.sensors.map(|sensors| sensors[i]));
            }
        }
        if on(Fields::SIGNALS) {
            push_signals(row, frame);
        }
        if on(Fields::CODES) {
            push_codes(row, frame);
        }
        self.flush_row()
    }

    /// Makes what was written so far safe from a crash of this process.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), FileError> {
        self.records.flush().map_err(|error| FileError::io(&self.path, &error))
    }

    /// Ends the file; a writer that is merely dropped cannot say that the disk was full.
    ///
    /// # Errors
    /// The last lines could not be written.
    pub fn finish(mut self) -> Result<(), FileError> {
        self.flush()
    }

    fn flush_row(&mut self) -> Result<(), FileError> {
        let written = self.records.write_record(&self.row);
        self.row.clear();
        written.map_err(|error| FileError::csv(&self.path, error))
    }
}

fn header(fields: Fields) -> Vec<String> {
    let on = |field| fields.contains(field);
    let mut names: Vec<String> = ["t_us", "seq", "status"].map(str::to_owned).into();
    if on(Fields::FORCE) {
        names.extend(["fx_n", "fy_n", "fz_n"].map(str::to_owned));
    }
    if on(Fields::POINT) {
        names.extend(["x_mm", "y_mm"].map(str::to_owned));
    }
    if on(Fields::TORSION) {
        names.push("torsion_nmm".to_owned());
    }
    names.push("contact".to_owned());
    if on(Fields::SLIP) {
        names.extend(["slip", "slip_margin", "friction", "grip_n"].map(str::to_owned));
    }
    if on(Fields::CONTACTS) {
        names.extend((1..=2).flat_map(|i| {
            ["x", "y"]
                .map(|axis| format!("contact{i}_{axis}_mm"))
                .into_iter()
                .chain([format!("contact{i}_fz_n")])
        }));
    }
    if on(Fields::SENSORS) {
        names.extend((0..SENSORS).flat_map(sensor_truth_names));
    }
    if on(Fields::SIGNALS) {
        names.extend((0..TAXELS).map(|k| format!("c_r{}c{}", k / 4, k % 4)));
        names.extend((0..SENSORS).flat_map(|i| ["x", "y", "z"].map(|u| format!("s{i}_u{u}"))));
        names.extend(["saturated", "dead", "bridge_faults"].map(str::to_owned));
    }
    if on(Fields::CODES) {
        names.extend(taxel_names(ROWS));
        names.extend((0..SENSORS).flat_map(bridge_names));
        names.extend(["aux_vref", "aux_temp"].map(str::to_owned));
    }
    names
}

fn push_force(row: &mut Vec<String>, force: Option<Force>) {
    let cell = |component: fn(&Force) -> Measured<Newtons>| {
        let value = force.as_ref().and_then(|force| component(force).ok());
        value.map(|newtons| newtons.0.to_string()).unwrap_or_default()
    };
    row.extend([cell(|f| f.x), cell(|f| f.y), cell(|f| f.z)]);
}

fn push_signals(row: &mut Vec<String>, frame: &Frame) {
    let taxels = frame.signals.and_then(|signals| signals.taxels);
    row.extend((0..TAXELS).map(|k| taxels.map(|c| c[k].to_string()).unwrap_or_default()));
    for i in 0..SENSORS {
        let bridge = frame.signals.and_then(|signals| signals.bridges[i]);
        row.extend((0..3).map(|axis| bridge.map(|u| u[axis].to_string()).unwrap_or_default()));
    }
    let health = frame.signals.map(|signals| signals.health);
    let cell = |bits: Option<u16>| bits.map(|bits| bits.to_string()).unwrap_or_default();
    row.push(cell(health.map(|health| health.saturated)));
    row.push(cell(health.map(|health| health.dead)));
    row.push(cell(health.map(|health| health.bridge_faults.into())));
}

fn push_codes(row: &mut Vec<String>, frame: &Frame) {
    let cell =
        |code: Option<taxel::units::Code>| code.map(|code| code.0.to_string()).unwrap_or_default();
    let taxels = frame.codes.and_then(|codes| codes.taxels);
    let lit = (0..TAXELS).map(|k| taxels.map(|t| t.lit[k / 4][k % 4]));
    let dark = (0..4).map(|c| taxels.map(|t| t.dark[c]));
    row.extend(lit.chain(dark).map(cell));
    for i in 0..SENSORS {
        let bridge = frame.codes.and_then(|codes| codes.bridges[i]);
        row.extend([
            cell(bridge.map(|m| m.a)),
            cell(bridge.map(|m| m.b)),
            cell(bridge.map(|m| m.c)),
            cell(bridge.map(|m| m.d)),
        ]);
    }
    row.push(cell(frame.codes.and_then(|codes| codes.reference)));
    row.push(cell(frame.codes.and_then(|codes| codes.temperature)));
}
