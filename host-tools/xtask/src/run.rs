//! Other programs, and the environment they are started with.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

/// What `cargo xtask` hands on from the build of xtask itself, or what a user has set for host builds;
/// either would steer a nested cargo elsewhere.
const INHERITED: [&str; 9] = [
    "CARGO",
    "CARGO_BUILD_RUSTFLAGS",
    "CARGO_BUILD_TARGET",
    "CARGO_BUILD_TARGET_DIR",
    "CARGO_ENCODED_RUSTFLAGS",
    "CARGO_TARGET_DIR",
    "RUSTC",
    "RUSTC_WORKSPACE_WRAPPER",
    "RUSTFLAGS",
];

/// The repository.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().nth(2).unwrap_or(here).to_owned()
}

/// Where cargo builds the host's workspace.
pub fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// A program, started in `directory`.
pub fn program(name: impl AsRef<OsStr>, directory: &Path) -> Command {
    let mut command = Command::new(name);
    command.current_dir(directory).stdin(Stdio::null());
    command
}

/// The cargo that runs this, for the host's workspace.
pub fn cargo() -> Command {
    program(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()), &root())
}

/// A program in `directory`, cargo for one, that nothing but its arguments steers.
pub fn clean(name: impl AsRef<OsStr>, directory: &Path) -> Command {
    let mut command = program(name, directory);
    for variable in INHERITED {
        command.env_remove(variable);
    }
    command
}

/// On a build machine the lock files are law.
pub fn locked() -> Option<&'static str> {
    std::env::var_os("CI").map(|_| "--locked")
}

/// Runs to the end; what it says is shown.
pub fn run(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| format!("`{}` does not start", line(command)))?;
    if !status.success() {
        bail!("`{}` ended with {status}; its messages are above", line(command));
    }
    Ok(())
}

/// Installs what the named parts of `.ci/setup` need and this machine lacks.
pub fn setup(parts: &[&str]) -> Result<()> {
    run(clean("sh", &root()).arg(".ci/setup").args(parts).stdout(std::io::stderr()))
}

/// The lines that it prints, if it works.
pub fn lines(command: &mut Command) -> Option<Vec<String>> {
    let output = command.stderr(Stdio::null()).output().ok().filter(|out| out.status.success())?;
    let text = String::from_utf8(output.stdout).ok()?;
    Some(text.lines().map(|line| line.trim().to_owned()).collect())
}

/// The first line of what it prints, if it works.
pub fn answer(command: &mut Command) -> Option<String> {
    lines(command)?.into_iter().next()
}

fn line(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}
