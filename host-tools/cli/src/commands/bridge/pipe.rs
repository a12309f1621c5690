//! The program that speaks Zenoh, `host-tools/bridge`, at the other end of a pipe.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, bail};
use taxel_link::emulated::checkout;

use crate::output;

// The other side's own file, so that the two cannot disagree.
#[path = "../../../../bridge/src/order.rs"]
mod order;

pub use order::Order;

const PROGRAM: &str = if cfg!(windows) { "taxel-bridge.exe" } else { "taxel-bridge" };

/// A Zenoh session. Dropping it closes it.
pub struct Pipe {
    child: Child,
    input: Mutex<Option<ChildStdin>>,
}

impl Pipe {
    /// Starts the program with a Zenoh configuration, and waits for the session to be open.
    ///
    /// # Errors
    /// It is not there and cannot be built, or Zenoh refuses the configuration.
    pub fn open(config: &str) -> anyhow::Result<Self> {
        let mut command = program()?;
        command.arg(config).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        #[cfg(unix)]
        // Ctrl-C is for us: we close the pipe when the last sample is through it.
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().context("starting taxel-bridge")?;
        let mut greeting = String::new();
        if let Some(stdout) = child.stdout.take() {
            BufReader::new(stdout).read_line(&mut greeting).context("taxel-bridge")?;
        }
        let input = Mutex::new(child.stdin.take());
        let mut pipe = Self { child, input };
        if greeting.trim() != "ready" {
            bail!("Zenoh: {}; check --connect and --listen", pipe.last_words());
        }
        Ok(pipe)
    }

    /// Gives orders, all of them or none.
    ///
    /// # Errors
    /// The other side has gone.
    pub fn send(&self, orders: &[Order<'_>]) -> io::Result<()> {
        let mut bytes = Vec::new();
        orders.iter().try_for_each(|order| order.append(&mut bytes))?;
        match self.input.lock().unwrap_or_else(PoisonError::into_inner).as_mut() {
            Some(input) => input.write_all(&bytes),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }

    /// Why the program ended, once it did.
    pub fn last_words(&mut self) -> String {
        self.close();
        let mut words = String::new();
        if let Some(mut stderr) = self.child.stderr.take() {
            // Without words its end has to do.
            let _ = stderr.read_to_string(&mut words);
        }
        match words.trim() {
            "" => "it ended without a word".to_owned(),
            words => words.to_owned(),
        }
    }

    fn close(&mut self) {
        drop(self.input.lock().unwrap_or_else(PoisonError::into_inner).take());
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        self.close();
        // Closed, it tells everybody that we are gone, and ends.
        let _ = self.child.wait();
    }
}

/// Beside this program, where it was installed or built; else in a checkout, which is built first.
fn program() -> anyhow::Result<Command> {
    let beside = std::env::current_exe().ok().and_then(|own| Some(own.parent()?.join(PROGRAM)));
    if let Some(program) = beside.filter(|program| program.is_file()) {
        return Ok(Command::new(program));
    }
    let Some(root) = checkout() else {
        bail!(
            "taxel-bridge is not beside this program; from a checkout of the repository run `cargo \
             install --path host-tools/bridge`"
        )
    };
    build(&root).map(Command::new)
}

fn build(root: &Path) -> anyhow::Result<PathBuf> {
    output::note("building taxel-bridge, which takes minutes the first time");
    let target = match std::env::var_os("CARGO_TARGET_DIR") {
        Some(target) => std::path::absolute(target)?,
        None => root.join("target"),
    };
    let mut cargo = Command::new("cargo");
    cargo.current_dir(root.join("host-tools/bridge")).args(["build", "--quiet", "--locked"]);
    cargo.args(["--release", "--target-dir"]).arg(&target).stdin(Stdio::null());
    let built = cargo.status().context("cargo, which builds taxel-bridge")?;
    if !built.success() {
        bail!("taxel-bridge does not build; see above");
    }
    Ok(target.join("release").join(PROGRAM))
}
