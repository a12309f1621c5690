//! Helpers that run the command in a folder.
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
#[cfg(target_os = "linux")]
use std::process::Child;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use taxel::scan::{ROWS, SENSORS};
use taxel::units::FullScale;
use taxel_files::recording::Recording;
use taxel_files::trace::{Sample, TraceHeader, TraceWriter};

/// Result of a run: exit code, standard output, standard error.
pub struct Ran {
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
}

impl Ran {
    pub fn of(output: Output) -> Self {
        Self {
            code: output.status.code(),
            out: String::from_utf8(output.stdout).unwrap(),
            err: String::from_utf8(output.stderr).unwrap(),
        }
    }
}

/// Whether `TAXEL_LONG=1` asks for the long form of a test.
pub fn long_form() -> bool {
    std::env::var_os("TAXEL_LONG").is_some()
}

pub fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}

/// Scene of twelve seconds with 24 presses, enough for a fit of the whole finger.
pub const SHORT_PRESSES: &str = "\
effects = ['noise', 'gain-spread', 'optical-crosstalk', 'bridge-mismatch']
[scan]
rate_hz = 200
duration_s = 13
[device]
seed = 3
bits = 16
[indenter]
radius_mm = 6
[friction]
mu = 0.8
[[random]]
at_s = 1
presses = 24
each_s = 0.5
x_mm = [-2, 2]
y_mm = [-2, 2]
fz_n = [0.4, 2]
shear_of_limit = [0, 0.6]
";

/// Reads a terminal until its other end is closed.
#[cfg(unix)]
pub fn read_terminal(mut master: std::fs::File) -> String {
    let (mut said, mut bytes) = (Vec::new(), [0; 4096]);
    // Linux reports the closed other end as an error.
    while let Ok(read @ 1..) = std::io::Read::read(&mut master, &mut bytes) {
        said.extend_from_slice(&bytes[..read]);
    }
    String::from_utf8(said).unwrap()
}

/// Waits for an event of another process, which tells nobody of it: looks every two milliseconds.
///
/// Fails after two minutes, which only a failing test reaches.
pub fn until(what: &str, mut came: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !came() {
        assert!(begun.elapsed() < Duration::from_secs(120), "never came: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Command that ends with its test, which may fail before the command does.
#[cfg(target_os = "linux")]
pub struct Running(pub Child);

#[cfg(target_os = "linux")]
impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Processor time of a child, a measure of its progress independent of other load.
#[cfg(target_os = "linux")]
pub fn worked(child: &Child) -> Duration {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    // utime and stime, fields 14 and 15 of proc(5), in hundredths of a second.
    let fields = after_name.split_whitespace().skip(11).take(2);
    Duration::from_millis(10 * fields.filter_map(|field| field.parse::<u64>().ok()).sum::<u64>())
}

/// Counts the rows that a recording has so far.
pub fn rows_so_far(path: &Path) -> usize {
    Recording::open(path).map_or(0, |rows| rows.map_while(Result::ok).count())
}

/// Folder in which the command runs.
pub struct In<'f>(pub &'f Path);

impl In<'_> {
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_taxel"));
        command.current_dir(self.0).args(args);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    pub fn taxel(&self, args: &[&str]) -> Ran {
        Ran::of(self.command(args).output().unwrap())
    }

    /// Lists the folder: names of all files, and texts where they are text.
    pub fn files(&self) -> BTreeMap<String, Option<String>> {
        let entries = std::fs::read_dir(self.0).unwrap().map(|entry| entry.unwrap());
        let text = |path: PathBuf| {
            path.metadata()
                .is_ok_and(|file| file.is_file())
                .then(|| String::from_utf8_lossy(&std::fs::read(path).unwrap()).into_owned())
        };
        entries
            .map(|entry| (entry.file_name().into_string().unwrap(), text(entry.path())))
            .collect()
    }

    /// Asserts a failure: one line on standard error, which it returns, and no standard output.
    pub fn fails(&self, code: i32, args: &[&str]) -> String {
        let ran = self.taxel(args);
        assert_eq!(ran.code, Some(code), "{}{}", ran.out, ran.err);
        assert_eq!(ran.out, "");
        assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
        assert!(ran.err.ends_with('\n'));
        ran.err
    }

    pub fn succeeds(&self, args: &[&str]) -> String {
        let ran = self.taxel(args);
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        ran.out
    }
}

/// Writes a trace of a finger with all its channels; returns its name.
pub fn write_trace(directory: &Path, name: &str, samples: &[Sample], truth: bool) -> String {
    let header = TraceHeader {
        full_scale: FullScale::BITS_16,
        rows: ROWS,
        bridges: [true; SENSORS],
        reference: true,
        temperature: false,
        truth,
        sensor_truth: truth,
    };
    let mut writer = TraceWriter::create(directory.join(name), header).unwrap();
    samples.iter().for_each(|sample| writer.write(sample).unwrap());
    writer.finish().unwrap();
    name.to_owned()
}
