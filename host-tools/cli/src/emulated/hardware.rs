//! The image of a board with hardware on the emulator that has all of its chip: `host-tools/emulator`, a program of
//! its own because of its licence, with the board's USB port behind TCP.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command as Process, Stdio};

use super::{EmulatedError, checkout, firmware};
use taxel_client::Port;

/// The boards with hardware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hardware {
    /// The product.
    Stm32G431,
    /// The Black Pill.
    Stm32F411,
}

impl Hardware {
    /// Its name, as in `boards/`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stm32G431 => "stm32g431",
            Self::Stm32F411 => "stm32f411",
        }
    }

    /// Least scans a second: TIM1 counts a step, a fifth of a scan, in 16 bits at 170 MHz or 96 MHz.
    pub(super) const fn slowest_hz(self) -> u16 {
        match self {
            Self::Stm32G431 => 519,
            Self::Stm32F411 => 293,
        }
    }
}

/// A running board. Dropping it ends it.
#[derive(Debug)]
pub struct ServedBoard {
    child: Child,
    port: Port,
    scene_us: u64,
}

impl ServedBoard {
    /// Starts the firmware on a finger that sees the trace at `trace`, over and over, in real time. The
    /// emulator is built where it has not been, which takes minutes.
    ///
    /// # Errors
    /// There is no checkout of the repository here, or something does not build or start.
    pub fn start(board: Hardware, trace: &Path) -> Result<Self, EmulatedError> {
        Self::serving(board, trace, &[])
    }

    /// The same, for a replay: the finger sees a scan of the trace in each of the board's, from the first
    /// whenever the board begins to scan, and time waits for the client.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub(super) fn replaying(board: Hardware, trace: &Path) -> Result<Self, EmulatedError> {
        Self::serving(board, trace, &["--replay"])
    }

    fn serving(board: Hardware, trace: &Path, more: &[&str]) -> Result<Self, EmulatedError> {
        // The emulator runs in a folder of its own.
        let place =
            |path| std::path::absolute(path).map_err(EmulatedError::system("finding a file"));
        let (firmware, trace) = (place(firmware(board.name())?)?, place(trace.to_owned())?);
        let root = checkout().ok_or(EmulatedError::NoFirmware(board.name()))?;
        let mut cargo = Process::new("cargo");
        cargo.args(["run", "--quiet", "--locked"]);
        // Beside the rest, unless the user has a place of his own.
        if std::env::var_os("CARGO_TARGET_DIR").is_none() {
            cargo.arg("--target-dir").arg(root.join("target"));
        }
        cargo.args(["--", "serve", "--board", board.name()]).arg(firmware);
        cargo.arg("--trace").arg(trace).args(more);
        let mut child = cargo
            .current_dir(root.join("host-tools/emulator"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(EmulatedError::system("starting the emulator"))?;
        let mut greeting = String::new();
        if let Some(stdout) = child.stdout.take() {
            let read = BufReader::new(stdout).read_line(&mut greeting);
            read.map_err(EmulatedError::system("reading from the emulator"))?;
        }
        match understand(greeting.trim()) {
            Some((port, scene_us)) => Ok(Self { child, port, scene_us }),
            None => {
                // It has ended, or is nothing that can be talked to.
                let _ = child.kill();
                let _ = child.wait();
                Err(EmulatedError::Stopped("it does not come up; see above".to_owned()))
            }
        }
    }

    /// Where its serial port is.
    #[must_use]
    pub fn port(&self) -> &Port {
        &self.port
    }

    /// By the board's own clock, when the trace began, in microseconds.
    #[must_use]
    pub fn scene_us(&self) -> u64 {
        self.scene_us
    }
}

/// `tcp:HOST:PORT scene at N us`
fn understand(greeting: &str) -> Option<(Port, u64)> {
    let (port, began) = greeting.split_once(" scene at ")?;
    Some((port.parse().ok()?, began.strip_suffix(" us")?.parse().ok()?))
}

impl Drop for ServedBoard {
    fn drop(&mut self) {
        // Both fail only where it has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_emulators_greeting_is_understood_and_nothing_else_is() {
        let (port, began) = understand("tcp:127.0.0.1:4711 scene at 1234 us").unwrap();
        assert_eq!((port.to_string().as_str(), began), ("tcp:127.0.0.1:4711", 1234));
        for other in ["", "tcp:127.0.0.1:4711", "error", "tcp:x scene at 1 us"] {
            assert_eq!(understand(other), None, "{other}");
        }
    }
}
