//! The firmware on an emulated microcontroller: QEMU's `mps2-an386`, a Cortex-M4F, playing back a trace.
//!
//! ```text
//! scans ──Image──▶ file ──loader──▶ PSRAM ─▶ the very session of the product ─▶ UART ──▶ stdin/stdout
//! ```
//! A replay ([`replay()`]) is lossless and takes as long as the host needs; virtual time then counts
//! instructions. A live board ([`Emulated::start`] with [`Pace::Live`]) keeps real time.

mod hardware;
mod pins;
mod replay;

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command as Process, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use taxel::estimate::contact_point::PointMethod;
use taxel::frame::Fields;
use taxel::scan::Scan;
use taxel::session::Pace;
use taxel::wire::WireError;
use tempfile::NamedTempFile;

pub use hardware::{Hardware, ServedBoard};
pub use pins::OnPins;
pub use replay::{Replay, replay};

use taxel_client::{LinkError, Problem};

// The board's own file, so that the two sides cannot disagree.
#[path = "../../../boards/mps2-an386/src/image.rs"]
mod image;

/// The board's name, as in `boards/`.
pub const BOARD: &str = "mps2-an386";
/// In a replay an instruction takes 2⁶ ns of virtual time: 1.6 ticks of the board's 25 MHz clock, so
/// that counts of ticks are counts of instructions.
const ICOUNT_SHIFT: u32 = 6;
/// How long a read waits before it says that nothing came.
const POLL: Duration = Duration::from_millis(50);

/// How a board that replays is set; its rate is the trace's.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Of its frames.
    pub fields: Fields,
    /// Corner of the low-pass in hertz; 0 for none.
    pub filter_hz: u16,
    /// How the contact point is found.
    pub point_method: PointMethod,
}

/// What can go wrong with an emulated board.
#[derive(Debug, thiserror::Error)]
pub enum EmulatedError {
    /// There is nothing to play back.
    #[error("the trace has no scans; give one that has")]
    Empty,
    /// The trace is longer than the board's memory.
    #[error(
        "the trace has {scans} scans, of which the emulated board holds {fit}; replay a stretch of it, \
         such as TRACE.csv@0..{seconds}"
    )]
    TooLong {
        /// Scans in the trace.
        scans: usize,
        /// Scans that fit.
        fit: usize,
        /// How long those take, in whole seconds.
        seconds: u64,
    },
    /// The trace is faster than the board can scan.
    #[error(
        "the trace has {hz} scans a second, and the board scans {most} times at most; replay it on the host"
    )]
    TooFast {
        /// Scans a second of the trace.
        hz: u16,
        /// Of the board.
        most: u32,
    },
    /// The board's link did not carry all frames.
    #[error(
        "the board's link carried {received} of {expected} frames before one was lost; ask for fewer --fields"
    )]
    Overflowed {
        /// Frames that came.
        received: usize,
        /// Scans that were played back.
        expected: usize,
    },
    /// QEMU is not installed.
    #[error(
        "qemu-system-arm is not installed; `sudo apt-get install qemu-system-arm` (Debian, Ubuntu) or \
         `brew install qemu` (macOS)"
    )]
    NoQemu,
    /// There is no firmware to run.
    #[error(
        "no firmware for the emulated board; run this inside a checkout of the repository, or point \
         TAXEL_FIRMWARE_DIR to where {0}.elf lies"
    )]
    NoFirmware(&'static str),
    /// The firmware's build failed.
    #[error("the emulated board's firmware does not build; see `cargo xtask firmware {0}`")]
    Build(&'static str),
    /// The operating system refused something.
    #[error("{what}: {error}")]
    System {
        /// What was tried.
        what: &'static str,
        /// What it said.
        error: io::Error,
    },
    /// The emulator or the firmware gave up.
    #[error("the emulated board stopped: {0}")]
    Stopped(String),
    /// It neither stops nor says anything.
    #[error("the emulated board hangs; please report this")]
    Hangs,
    /// Frames of a lossless replay are missing.
    #[error("the emulated board sent {received} of {expected} frames; please report this")]
    Lost {
        /// Frames that came.
        received: usize,
        /// Scans that were played back.
        expected: usize,
    },
    /// A packet could not be read, on a link that damages none.
    #[error("the emulated board sent a packet that cannot be read ({0:?}); please report this")]
    Garbled(WireError),
    /// The finger did not do what it was asked.
    #[error("emulated board: {0}")]
    Finger(Problem),
    /// The client that speaks to it had trouble.
    #[error("emulated board: {0}")]
    Link(#[from] LinkError),
}

impl EmulatedError {
    fn system(what: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::System { what, error }
    }
}

/// Scans a second, by their times; one where there is but one scan.
fn rate_hz(scans: &[Scan]) -> Result<u16, EmulatedError> {
    let (Some(first), Some(last)) = (scans.first(), scans.last()) else {
        return Err(EmulatedError::Empty);
    };
    let duration = last.time.0.saturating_sub(first.time.0).max(1);
    let hz = ((scans.len() as u64 - 1) * 1_000_000 + duration / 2) / duration;
    Ok(u16::try_from(hz).unwrap_or(u16::MAX).max(1))
}

/// Scans as the board wants them in its memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    bytes: Vec<u8>,
    pace: Pace,
    scan_hz: u16,
}

impl Image {
    /// Packs `scans`, to be played back at `pace`.
    ///
    /// # Errors
    /// There are none, or too many.
    pub fn new(scans: &[Scan], pace: Pace) -> Result<Self, EmulatedError> {
        let first = scans.first().ok_or(EmulatedError::Empty)?;
        let scan_hz = rate_hz(scans)?;
        let header = image::Header {
            magic: image::MAGIC,
            version: image::VERSION,
            lossless: pace == Pace::Lossless,
            scan_hz,
            full_scale: first.codes.full_scale,
            scans: u32::try_from(scans.len()).unwrap_or(u32::MAX),
        };
        // Growing a vector is the only thing that these could fail at, and that does not fail.
        let mut bytes = postcard::to_extend(&header, Vec::new()).unwrap_or_default();
        for (fit, scan) in scans.iter().enumerate() {
            bytes = postcard::to_extend(scan, bytes).unwrap_or_default();
            if bytes.len() > image::CAPACITY {
                let seconds = scan.time.0.saturating_sub(first.time.0) / 1_000_000;
                return Err(EmulatedError::TooLong { scans: scans.len(), fit, seconds });
            }
        }
        Ok(Self { bytes, pace, scan_hz })
    }

    /// Scans a second, as the board will state them.
    #[must_use]
    pub fn scan_hz(&self) -> u16 {
        self.scan_hz
    }
}

/// A running emulator. Dropping it ends it.
#[derive(Debug)]
pub struct Emulated {
    child: Child,
    link: Option<(Reader, ChildStdin)>,
    words: Option<JoinHandle<String>>,
    // QEMU reads it when it starts; the file goes with this.
    _image: NamedTempFile,
}

impl Emulated {
    /// Starts the firmware on `image`. It is looked for in `$TAXEL_FIRMWARE_DIR`, else built in the
    /// checkout of the repository around the current directory or this program.
    ///
    /// # Errors
    /// QEMU or the firmware is missing, or something does not start.
    pub fn start(image: &Image) -> Result<Self, EmulatedError> {
        Self::start_firmware(&firmware(BOARD)?, image)
    }

    /// Starts the firmware in the ELF file `firmware` on `image`.
    ///
    /// # Errors
    /// QEMU is missing, or something does not start.
    pub fn start_firmware(firmware: &Path, image: &Image) -> Result<Self, EmulatedError> {
        let mut file =
            NamedTempFile::new().map_err(EmulatedError::system("making a temporary file"))?;
        file.write_all(&image.bytes).map_err(EmulatedError::system("writing the trace's image"))?;
        // In QEMU's options a comma ends a value, and two are one.
        let path = file.path().to_string_lossy().replace(',', ",,");
        let mut qemu = Process::new("qemu-system-arm");
        qemu.args(["-M", BOARD, "-display", "none", "-monitor", "none", "-serial", "stdio"])
            .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
            .arg(firmware)
            .arg("-device")
            .arg(format!("loader,file={path},addr={:#x},force-raw=on", image::ADDRESS))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        if image.pace == Pace::Lossless {
            // Without `sleep=off` the board would wait for real time to catch up. Live boards count no
            // instructions: what they spend on sending would not be in their time.
            qemu.args(["-icount", &format!("shift={ICOUNT_SHIFT},sleep=off")]);
        }
        let mut child = qemu.spawn().map_err(|error| match error.kind() {
            ErrorKind::NotFound => EmulatedError::NoQemu,
            _ => EmulatedError::System { what: "starting qemu-system-arm", error },
        })?;
        let link = child.stdout.take().map(Reader::new).zip(child.stdin.take());
        let words = child.stderr.take().map(|mut stderr| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                // What was said before an error still counts.
                let _ = stderr.read_to_end(&mut bytes);
                String::from_utf8_lossy(&bytes).into_owned()
            })
        });
        Ok(Self { child, link, words, _image: file })
    }

    /// The board's UART, once. Reads return [`ErrorKind::TimedOut`] now and then.
    pub fn take_link(&mut self) -> Option<(Box<dyn Read + Send>, Box<dyn Write + Send>)> {
        let (reader, writer) = self.link.take()?;
        Some((Box::new(reader), Box::new(writer)))
    }

    /// Waits for the firmware's own end. Returns the most bytes of stack that it used.
    ///
    /// # Errors
    /// It did not end well; with what it said last.
    pub fn wait(mut self) -> Result<Option<u32>, EmulatedError> {
        let status =
            self.child.wait().map_err(EmulatedError::system("waiting for qemu-system-arm"))?;
        let words = self.words.take().and_then(|words| words.join().ok()).unwrap_or_default();
        if status.success() {
            let depth =
                |line: &str| line.strip_prefix("stack ")?.strip_suffix(" bytes")?.parse().ok();
            return Ok(words.lines().find_map(depth));
        }
        let words = words.split_whitespace().collect::<Vec<_>>().join(" ");
        Err(EmulatedError::Stopped(if words.is_empty() { status.to_string() } else { words }))
    }
}

impl Drop for Emulated {
    fn drop(&mut self) {
        // Both fail only where it has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The emulator's output, with time-outs, which pipes do not have.
#[derive(Debug)]
struct Reader {
    chunks: Receiver<io::Result<Vec<u8>>>,
    rest: VecDeque<u8>,
}

impl Reader {
    fn new(mut stdout: ChildStdout) -> Self {
        // A host that reads slowly must hold up the board, so this may not grow.
        let (sender, chunks) = sync_channel(16);
        std::thread::spawn(move || {
            loop {
                let mut chunk = vec![0; 4096];
                let read = stdout.read(&mut chunk).map(|length| chunk.truncate(length));
                let last = read.is_err() || chunk.is_empty();
                if sender.send(read.map(|()| chunk)).is_err() || last {
                    return;
                }
            }
        });
        Self { chunks, rest: VecDeque::new() }
    }
}

impl Read for Reader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.rest.is_empty() {
            self.rest = match self.chunks.recv_timeout(POLL) {
                Ok(chunk) => chunk?.into(),
                Err(RecvTimeoutError::Timeout) => return Err(ErrorKind::TimedOut.into()),
                Err(RecvTimeoutError::Disconnected) => return Ok(0),
            };
        }
        self.rest.read(buffer)
    }
}

/// The firmware of a board.
fn firmware(board: &'static str) -> Result<PathBuf, EmulatedError> {
    let name = format!("{board}.elf");
    if let Some(directory) = std::env::var_os("TAXEL_FIRMWARE_DIR") {
        let path = Path::new(&directory).join(name);
        return if path.is_file() { Ok(path) } else { Err(EmulatedError::NoFirmware(board)) };
    }
    let root = checkout().ok_or(EmulatedError::NoFirmware(board))?;
    // Always, not only where it is missing: what runs shall be what is written. It takes a moment when
    // nothing has changed.
    let built = Process::new("cargo")
        .args(["run", "--quiet", "--package", "xtask", "--", "firmware", board])
        .current_dir(&root)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .status();
    match built {
        Ok(status) if status.success() => Ok(root.join("boards/target/firmware").join(name)),
        _ => Err(EmulatedError::Build(board)),
    }
}

/// The repository that this is run in, or was built in.
#[must_use]
pub fn checkout() -> Option<PathBuf> {
    [std::env::current_dir().ok(), std::env::current_exe().ok()].into_iter().flatten().find_map(
        |start| {
            let holds = |path: &&Path| path.join("boards").join(BOARD).join("Cargo.toml").is_file();
            start.ancestors().find(holds).map(Path::to_owned)
        },
    )
}

#[cfg(test)]
mod tests {
    use taxel::scan::Codes;
    use taxel::units::{FullScale, Micros};

    use super::*;

    fn scans(count: u64, period: u64) -> Vec<Scan> {
        let codes = Codes {
            full_scale: FullScale::BITS_12,
            taxels: None,
            bridges: [None; 4],
            reference: None,
            temperature: None,
        };
        let scan = |i| Scan { time: Micros(1_000 + i * period), lost: 0, codes };
        (0..count).map(scan).collect()
    }

    #[test]
    fn the_scan_rate_is_that_of_the_times() {
        for (period, hz) in [(2_000, 500), (250, 4_000), (2_999, 333)] {
            let image = Image::new(&scans(1_000, period), Pace::Lossless).unwrap();
            assert_eq!(image.scan_hz(), hz);
        }
        // One scan, and scans that all carry the same time, have none to state; it must not be zero.
        assert_eq!(Image::new(&scans(1, 0), Pace::Live).unwrap().scan_hz(), 1);
        assert_eq!(Image::new(&scans(9, 0), Pace::Live).unwrap().scan_hz(), u16::MAX);
    }

    #[test]
    fn a_trace_that_does_not_fit_says_which_stretch_would() {
        assert!(matches!(Image::new(&[], Pace::Live), Err(EmulatedError::Empty)));
        let long = scans(2_000_000, 250);
        let Err(EmulatedError::TooLong { scans, fit, seconds }) = Image::new(&long, Pace::Live)
        else {
            panic!("it fits")
        };
        assert_eq!(scans, 2_000_000);
        assert_eq!(seconds, fit as u64 * 250 / 1_000_000);
        assert!(Image::new(&long[..fit], Pace::Live).is_ok());
    }
}
