//! A board's own firmware on the emulator, with its USB port behind TCP.
//!
//! The emulator is a separate program because unicorn's licence (GPL-2.0) binds every program that
//! links it. `cargo xtask emulator` builds the program and the images of the boards into one
//! folder.

mod replay;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::{Context, bail};
use taxel_client::Port;

pub use replay::{Replay, Settings};

/// Environment variable that names the emulator's folder.
const VARIABLE: &str = "TAXEL_EMULATOR";
/// File name of the emulator's program.
const PROGRAM: &str = if cfg!(windows) { "taxel-emulator.exe" } else { "taxel-emulator" };

/// Boards whose firmware the emulator runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Board {
    /// The product.
    #[value(name = "stm32g431")]
    Stm32G431,
    /// Black Pill, a development board.
    #[value(name = "stm32f411")]
    Stm32F411,
}

impl Board {
    /// Name of the board's folder in `boards/`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stm32G431 => "stm32g431",
            Self::Stm32F411 => "stm32f411",
        }
    }

    /// Lowest scan rate in Hz: TIM1 counts a step, a fifth of a scan, in 16 bits at 85 MHz or 48
    /// MHz.
    const fn slowest_hz(self) -> u16 {
        match self {
            Self::Stm32G431 => 260,
            Self::Stm32F411 => 147,
        }
    }
}

/// Running board. Dropping it ends the emulator.
pub struct Emulated {
    child: Child,
    port: Port,
    scene_us: u64,
}

impl Emulated {
    /// Starts the firmware on a finger that repeats the trace of a file in real time.
    ///
    /// # Errors
    /// The emulator or the image is missing, or does not start.
    pub fn start(board: Board, trace: &Path) -> anyhow::Result<Self> {
        Self::serving(board, trace, &[])
    }

    /// Starts the firmware for a replay: each board scan reads the next scan of the trace.
    ///
    /// The trace begins when the board begins to scan, and time waits for the client.
    ///
    /// # Errors
    /// As [`Self::start`].
    fn replaying(board: Board, trace: &Path) -> anyhow::Result<Self> {
        Self::serving(board, trace, &["--replay"])
    }

    fn serving(board: Board, trace: &Path, more: &[&str]) -> anyhow::Result<Self> {
        let folder = folder();
        let (program, image) =
            (folder.join(PROGRAM), folder.join(board.name()).with_extension("elf"));
        if let Some(missing) = [&program, &image].into_iter().find(|path| !path.is_file()) {
            bail!(
                "{}: no such file; run `cargo xtask emulator` in the repository, or set {VARIABLE} to the \
                 folder that it filled",
                missing.display()
            );
        }
        let mut command = Command::new(&program);
        command.args(["serve", "--board", board.name()]).arg(&image).arg("--trace").arg(trace);
        // With --attached the emulator ends with this process, even a killed one, because its
        // standard input closes.
        command.arg("--attached").args(more).stdin(Stdio::piped()).stdout(Stdio::piped());
        #[cfg(unix)]
        // Ctrl-C must reach only this process: the board runs until its last frame is written.
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().with_context(|| program.display().to_string())?;
        let mut greeting = String::new();
        if let Some(stdout) = child.stdout.take() {
            let read = BufReader::new(stdout).read_line(&mut greeting);
            read.context("reading from the emulator")?;
        }
        let Some((port, scene_us)) = understand(greeting.trim()) else {
            // The program has ended, or is not the emulator.
            let _ = child.kill();
            let _ = child.wait();
            bail!("the emulator did not start; its own message is above")
        };
        Ok(Self { child, port, scene_us })
    }

    /// Port of the board.
    pub fn port(&self) -> &Port {
        &self.port
    }

    /// Start of the trace by the board's own clock, in microseconds.
    pub fn scene_us(&self) -> u64 {
        self.scene_us
    }
}

impl Drop for Emulated {
    fn drop(&mut self) {
        // Both fail only if the emulator has ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns the folder of the program and the images: `$TAXEL_EMULATOR`, else `../emulator` from
/// this program's own folder. For a program built by cargo that is `target/emulator`.
fn folder() -> PathBuf {
    let default = || {
        let own = std::env::current_exe().unwrap_or_default();
        own.ancestors().nth(2).unwrap_or(Path::new("")).join("emulator")
    };
    std::env::var_os(VARIABLE).map_or_else(default, PathBuf::from)
}

/// Parses `tcp:HOST:PORT scene at N us`.
fn understand(greeting: &str) -> Option<(Port, u64)> {
    let (port, began) = greeting.split_once(" scene at ")?;
    Some((port.parse().ok()?, began.strip_suffix(" us")?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn greeting_gives_port_and_start_of_the_scene() {
        let (port, began) = understand("tcp:127.0.0.1:4711 scene at 1234 us").unwrap();
        assert_eq!((port.to_string().as_str(), began), ("tcp:127.0.0.1:4711", 1234));
        for other in ["", "tcp:127.0.0.1:4711", "error", "tcp:x scene at 1 us"] {
            assert_eq!(understand(other), None, "{other}");
        }
    }
}
