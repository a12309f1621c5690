//! Recordings for the subcommands: whole or in stretches, optionally with another clock's
//! reference.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use serde::Serialize;
use taxel::condition::LagCompensation;
use taxel_calibrate::finger::Channel;
use taxel_calibrate::moments::WRENCH;
use taxel_calibrate::recording::Recording;
use taxel_calibrate::reference::DOUBTFUL;
use taxel_files::recording::{Header, Scans};
use taxel_files::stretch::Stretch;
use taxel_files::{table, trace};
use taxel_regress::align::Alignment;
use taxel_regress::table::TableRecording;

use crate::output;

/// Recordings, and the alignment of each reference's clock.
pub struct Read<T> {
    pub recordings: Vec<T>,
    pub alignments: Vec<Aligned>,
}

impl<T> Read<T> {
    /// Prints the alignments on standard error.
    pub fn note(&self) {
        for aligned in &self.alignments {
            output::note(format_args!("taxel: {}", aligned.describe()));
        }
    }
}

/// Alignment of a reference's clock: t′ = offset + (1 + rate)·t, in seconds.
#[derive(Serialize)]
pub struct Aligned {
    reference: PathBuf,
    #[serde(skip)]
    alignment: Alignment,
    offset_s: f64,
    rate: f64,
    residual_s: f64,
    correlation: f64,
    /// Lag of the finger behind its reference; `None` if none was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    lag_s: Option<f64>,
    /// Rows whose contact point and torsion come from the reference's moments.
    #[serde(skip_serializing_if = "Option::is_none")]
    placed_rows: Option<usize>,
    /// Columns of the reference that nothing reads.
    #[serde(skip)]
    unused: Vec<String>,
    /// Reason why its moments are not used.
    #[serde(skip)]
    no_moments: Option<&'static str>,
    /// Whether the reference is of a finger, not of a table.
    #[serde(skip)]
    finger: bool,
}

impl Aligned {
    fn new(reference: &Path, found: Alignment) -> Self {
        let Alignment { offset, rate, residual, correlation } = found;
        let reference = reference.to_owned();
        Self {
            reference,
            alignment: found,
            offset_s: offset,
            rate,
            residual_s: residual,
            correlation,
            lag_s: None,
            placed_rows: None,
            unused: Vec::new(),
            no_moments: None,
            finger: false,
        }
    }

    /// Whether the offset of the reference's clock may hide a lag of the finger.
    pub fn hides_lag(&self) -> bool {
        self.finger && self.lag_s.is_none()
    }

    pub fn describe(&self) -> String {
        let finger = match self.lag_s {
            Some(lag) => format!("; finger {:.1} ms behind", 1e3 * lag),
            None if self.hides_lag() => {
                "; no lag of the finger found, the clock's offset may hide one".to_owned()
            }
            None => String::new(),
        };
        let placed = self.placed_rows.map_or_else(String::new, |rows| {
            format!("; contact point of {rows} rows from its moments")
        });
        format!(
            "{}: clock {:+.4} s, {:+.3} % fast, within {:.1} ms; correlation {:.4}{finger}{placed}",
            self.reference.display(),
            self.offset_s,
            1e2 * self.rate,
            1e3 * self.residual_s,
            self.correlation
        )
    }
}

/// Place of a six-axis load cell.
#[derive(Clone, Copy, clap::Args)]
pub struct Cell {
    /// Origin of the reference's moments mx_nmm, my_nmm, mz_nmm in millimetres from the middle of
    /// the skin's surface: 0,0,25 is 25 mm under it [default: 0,0,0].
    #[arg(long, value_name = "X,Y,Z", value_parser = millimetres, allow_hyphen_values = true, requires = "references")]
    cell_at: Option<[f64; 3]>,
}

fn millimetres(text: &str) -> Result<[f64; 3], String> {
    let values: Vec<f64> = text.split(',').map_while(|value| value.trim().parse().ok()).collect();
    match values[..] {
        [x, y, z] if text.split(',').count() == 3 && values.iter().all(|mm| mm.abs() < 1000.0) => {
            Ok([x, y, z])
        }
        _ => Err("expected three numbers of millimetres, as in 0,0,25".to_owned()),
    }
}

/// Columns of a six-axis load cell besides the forces.
const MOMENTS: &[&str] = WRENCH.split_at(3).1;

/// Columns of the references besides forces and time: moments, and all others.
pub fn other_reference_columns(alignments: &[Aligned]) -> impl Iterator<Item = Channel> {
    let mut names: Vec<&str> = Vec::new();
    for name in alignments.iter().flat_map(|aligned| &aligned.unused) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let (moments, others): (Vec<&str>, Vec<&str>) =
        names.into_iter().partition(|name| MOMENTS.contains(name));
    let placed = alignments.iter().any(|aligned| aligned.placed_rows.is_some());
    let labels = || vec!["x_mm, y_mm, torsion_nmm of the rows".to_owned()];
    let used = placed.then(|| Channel::new(&MOMENTS.join(", "), labels(), ""));
    let why = alignments.iter().find_map(|aligned| aligned.no_moments);
    let incomplete = "a contact point needs all of mx_nmm, my_nmm, mz_nmm";
    let moments = used.or_else(|| leftover(&moments, why.unwrap_or(incomplete)));
    let others = leftover(&others, "of a --reference log, forces, moments and the time are read");
    moments.into_iter().chain(others)
}

/// Entry for columns that nothing uses; `None` without any.
fn leftover(columns: &[&str], why: &str) -> Option<Channel> {
    (!columns.is_empty()).then(|| Channel::new(&columns.join(", "), Vec::new(), why))
}

/// Columns of the recordings that are neither codes nor labels.
///
/// A file cannot be read.
pub fn other_columns(data: &[Stretch]) -> anyhow::Result<Vec<Channel>> {
    let mut names: Vec<String> = Vec::new();
    let mut estimates = false;
    for path in data.iter().map(|stretch| &stretch.path) {
        if is_packed(path) {
            estimates = true;
            continue;
        }
        match trace::other_columns(path)? {
            trace::Others::Unknown(unknown) => names.extend(unknown),
            trace::Others::Frames => estimates = true,
        }
    }
    names.sort();
    names.dedup();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let frames: &[&str] = if estimates { &["estimates recorded with the codes"] } else { &[] };
    let computed = leftover(frames, "they are computed again, with this calibration");
    Ok(leftover(&names, "no such column of a trace is known").into_iter().chain(computed).collect())
}

/// Reads traces of a finger, or recordings of its codes. Each must have rows. `references` is
/// empty, or has one for each; `cell` is the place of their moments. `lag` is that of the finger's
/// calibration, if there is one.
pub fn traces(
    stretches: &[Stretch],
    (references, cell): (&[PathBuf], Cell),
    lag: Option<LagCompensation>,
) -> anyhow::Result<Read<Recording>> {
    let mut read = Read { recordings: Vec::new(), alignments: Vec::new() };
    for (stretch, reference) in paired(stretches, references)? {
        anyhow::ensure!(
            is_packed(&stretch.path) || trace::is_trace(&stretch.path)?,
            "{}:1: not a taxel trace; name the columns of other files with --inputs and --targets",
            stretch.path.display()
        );
        let scans = Scans::open_from(&stretch.path, stretch.from())?;
        scans.remarks.iter().for_each(output::note);
        let name = stretch.path.display().to_string();
        let samples = trace::cut(scans.samples, stretch).collect::<Result<Vec<_>, _>>()?;
        if samples.is_empty() {
            anyhow::bail!(stretch.without_rows(span(&stretch.path)?));
        }
        let mut recording = Recording { name, samples };
        if let Some(path) = reference {
            read.alignments.push(aligned(&mut recording, path, lag)?);
        }
        read.recordings.push(recording);
    }
    // Recordings that do not show the finger's lag have that of the others.
    let found: Vec<f64> = read.alignments.iter().filter_map(|aligned| aligned.lag_s).collect();
    let mean = (found.iter().sum::<f64>() / found.len() as f64) as f32;
    let lag = (!found.is_empty()).then_some(LagCompensation { taxels: mean, sensors: mean });
    let unknown = read.recordings.iter_mut().zip(&mut read.alignments).zip(references);
    for ((recording, own), path) in
        unknown.filter(|((_, own), _)| own.lag_s.is_none() && lag.is_some())
    {
        *own = aligned(recording, path, lag)?;
    }
    for (recording, own) in read.recordings.iter_mut().zip(&mut read.alignments) {
        locate(recording, own, cell)?;
    }
    for (recording, aligned) in read.recordings.iter().zip(&read.alignments) {
        let (of, found) = (aligned.reference.display(), aligned.correlation);
        if found < DOUBTFUL {
            output::note(format_args!(
                "taxel: warning: {of}: its correlation with {} is {found:.3}, where a log of the same presses \
                 usually has {DOUBTFUL} or more; look whether it is this recording's, and for a load cell that came off",
                recording.name
            ));
        }
    }
    Ok(read)
}

/// Takes the forces of a recording from its reference.
fn aligned(
    recording: &mut Recording,
    path: &Path,
    lag: Option<LagCompensation>,
) -> anyhow::Result<Aligned> {
    let reference = table::read(&Stretch::whole(path), &["f*_n"])?;
    let (found, late) = recording.align(&reference, lag)?;
    let unused = reference.others;
    Ok(Aligned { lag_s: late, unused, finger: true, ..Aligned::new(path, found) })
}

/// Takes contact points from the moments of the recording's reference, if it has them.
fn locate(recording: &mut Recording, own: &mut Aligned, cell: Cell) -> anyhow::Result<()> {
    if !MOMENTS.iter().all(|moment| own.unused.iter().any(|column| column == moment)) {
        return Ok(());
    }
    let log = table::read(&Stretch::whole(&own.reference), &WRENCH)?;
    let cell_at = cell.cell_at.unwrap_or_default();
    let Some(located) = recording.locate(&log, &own.alignment, cell_at) else {
        own.no_moments = Some("the recording has x_mm, y_mm of its own");
        return Ok(());
    };
    if let Some(warning) = located.warning {
        output::note(format_args!("taxel: warning: {warning}"));
    }
    if located.rows == 0 {
        own.no_moments = Some("they tell the contact point in too few rows");
    } else {
        own.placed_rows = Some(located.rows);
        own.unused.retain(|column| !MOMENTS.contains(&column.as_str()));
    }
    Ok(())
}

/// Reads CSV files of any sensor, with references as in [`traces`].
pub fn tables(
    stretches: &[Stretch],
    references: &[PathBuf],
    inputs: &[String],
    targets: &[String],
) -> anyhow::Result<Read<TableRecording>> {
    let (inputs, targets) = (words(inputs), words(targets));
    let mut read = Read { recordings: Vec::new(), alignments: Vec::new() };
    for (stretch, reference) in paired(stretches, references)? {
        let file = stretch.path.display();
        anyhow::ensure!(
            !is_packed(&stretch.path),
            "{file}: --inputs and --targets name columns of a CSV; `taxel export {file} --out columns.csv` makes one"
        );
        let recording = match reference {
            None => TableRecording::read(stretch, &inputs, &targets)?,
            Some(path) => {
                let reference = table::read(&Stretch::whole(path), &targets)?;
                let sensor = table::read(stretch, &inputs)?;
                let (recording, found) = TableRecording::aligned(sensor, reference)?;
                read.alignments.push(Aligned::new(path, found));
                recording
            }
        };
        read.recordings.push(recording);
    }
    Ok(read)
}

/// Returns the times in seconds of the first and the last scan of a file.
fn span(path: &Path) -> anyhow::Result<Option<(f64, f64)>> {
    let mut times = Scans::open(path)?.samples.map(|sample| Ok(sample?.scan.time.0 as f64 / 1e6));
    let Some(first) = times.next().transpose()? else { return Ok(None) };
    times.try_fold(Some((first, first)), |_, time: anyhow::Result<f64>| Ok(Some((first, time?))))
}

/// Whether the file is a binary recording.
fn is_packed(path: &Path) -> bool {
    let extension = path.extension().and_then(OsStr::to_str);
    matches!(extension, Some("mcap" | "parquet"))
}

fn paired<'a>(
    stretches: &'a [Stretch],
    references: &'a [PathBuf],
) -> anyhow::Result<impl Iterator<Item = (&'a Stretch, Option<&'a PathBuf>)>> {
    anyhow::ensure!(
        references.is_empty() || references.len() == stretches.len(),
        "{} --reference for {} --data; give one for each",
        references.len(),
        stretches.len()
    );
    Ok(stretches.iter().enumerate().map(|(i, stretch)| (stretch, references.get(i))))
}

fn words(list: &[String]) -> Vec<&str> {
    list.iter().map(String::as_str).collect()
}

/// Sentences on those recordings that say that they were simulated.
///
/// A file cannot be read.
pub fn simulated(data: &[Stretch]) -> anyhow::Result<Vec<String>> {
    let mut notes = Vec::new();
    for Stretch { path, .. } in data {
        let commented = if is_packed(path) { None } else { trace::simulated(path)? };
        let origin = match commented {
            None if is_packed(path) || trace::is_trace(path)? => {
                recorded(&Scans::open(path)?.header)
            }
            commented => commented,
        };
        if let Some(origin) = origin {
            let note = format!("{} is simulated: {origin}", path.display());
            if !notes.contains(&note) {
                notes.push(note);
            }
        }
    }
    Ok(notes)
}

/// Returns how a recording was simulated; `None` for that of a real finger.
fn recorded(header: &Header) -> Option<String> {
    match (header.fact("simulated"), header.fact("board")) {
        ("", "virtual") => Some(format!("virtual finger {}", header.fact("serial"))),
        ("", _) => None,
        (origin, _) => Some(origin.to_owned()),
    }
}
