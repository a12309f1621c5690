//! The program that speaks to others, `host-tools/bridge`, at the other end of a pipe.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::Mutex;

use anyhow::{Context, bail};

use super::finger::lock;
use crate::output;

// The other side's own file, so that the two cannot disagree.
#[path = "../../../../bridge/src/order.rs"]
mod order;

pub use order::Order;

const PROGRAM: &str = if cfg!(windows) { "taxel-bridge.exe" } else { "taxel-bridge" };

/// The program, running. Dropping it ends what it does.
pub struct Pipe(Mutex<Running>);

struct Running {
    child: Child,
    input: Option<ChildStdin>,
}

impl Pipe {
    /// Starts the program with these words, and waits until it is ready; what it says of that. `hint` is how to
    /// mend it if it does not get ready.
    ///
    /// # Errors
    /// It is not there and cannot be built, or does not get ready.
    pub fn open(words: [&str; 2], hint: &str) -> anyhow::Result<(Self, String)> {
        let mut command = program()?;
        command.args(words).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        #[cfg(unix)]
        // Ctrl-C is for us: we close the pipe when the last sample is through it.
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().context("starting taxel-bridge")?;
        let mut greeting = String::new();
        if let Some(stdout) = child.stdout.take() {
            BufReader::new(stdout).read_line(&mut greeting).context("taxel-bridge")?;
        }
        let input = child.stdin.take();
        let mut running = Running { child, input };
        match greeting.trim().strip_prefix("ready") {
            Some(said) => Ok((Self(Mutex::new(running)), said.trim().to_owned())),
            None => bail!("{}: {}; {hint}", words[0], running.last_words()),
        }
    }

    /// Gives orders, all of them or none.
    ///
    /// # Errors
    /// The other side has gone: its last words.
    pub fn send(&self, orders: &[Order<'_>]) -> anyhow::Result<()> {
        let mut bytes = Vec::new();
        orders.iter().try_for_each(|order| order.append(&mut bytes))?;
        let mut running = lock(&self.0);
        match running.input.as_mut().map(|input| input.write_all(&bytes)) {
            Some(Ok(())) => Ok(()),
            _ => bail!("taxel-bridge: {}", running.last_words()),
        }
    }
}

impl Running {
    /// Why the program ended, once it did.
    fn last_words(&mut self) -> String {
        drop(self.input.take());
        let mut words = String::new();
        if let Some(stderr) = &mut self.child.stderr {
            // Without words its end has to do.
            let _ = stderr.read_to_string(&mut words);
        }
        match words.trim() {
            "" => "it ended without a word".to_owned(),
            words => words.to_owned(),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        drop(self.input.take());
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

/// The checkout of the repository around the current directory or this program.
fn checkout() -> Option<PathBuf> {
    let starts = [std::env::current_dir().ok(), std::env::current_exe().ok()];
    starts.into_iter().flatten().find_map(|start| {
        let holds = |path: &&Path| path.join("host-tools/bridge/Cargo.toml").is_file();
        start.ancestors().find(holds).map(Path::to_owned)
    })
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
