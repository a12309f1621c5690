//! Runs other programs in a known environment.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

/// Variables that `cargo xtask` or a user sets and that would change a nested cargo's build.
const INHERITED: [&str; 10] = [
    "CARGO",
    "CARGO_BUILD_RUSTFLAGS",
    "CARGO_BUILD_TARGET",
    "CARGO_BUILD_TARGET_DIR",
    "CARGO_ENCODED_RUSTFLAGS",
    "CARGO_TARGET_DIR",
    "DEFMT_LOG",
    "RUSTC",
    "RUSTC_WORKSPACE_WRAPPER",
    "RUSTFLAGS",
];

/// Folder of the repository.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().nth(2).unwrap_or(here).to_owned()
}

/// Target folder of the host's workspace.
pub fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// Returns a command for a program that starts in `directory`.
pub fn program(name: impl AsRef<OsStr>, directory: &Path) -> Command {
    let mut command = Command::new(name);
    command.current_dir(directory).stdin(Stdio::null());
    command
}

/// Returns a cargo command for the host's workspace, with the cargo that runs this program.
pub fn cargo() -> Command {
    program(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()), &root())
}

/// Returns a command in `directory` without the [`INHERITED`] variables.
pub fn clean(name: impl AsRef<OsStr>, directory: &Path) -> Command {
    let mut command = program(name, directory);
    for variable in INHERITED {
        command.env_remove(variable);
    }
    command
}

/// Returns `--locked` on a build machine, where lock files must be up to date.
pub fn locked() -> Option<&'static str> {
    std::env::var_os("CI").map(|_| "--locked")
}

/// Runs a program to its end and shows its output; fails where the program fails.
pub fn run(command: &mut Command) -> Result<()> {
    let status =
        command.status().with_context(|| format!("`{}` does not start", command_line(command)))?;
    if !status.success() {
        bail!("`{}` ended with {status}; its messages are above", command_line(command));
    }
    Ok(())
}

/// Installs the tools of the named parts of `.ci/setup` that the machine lacks.
pub fn setup(parts: &[&str]) -> Result<()> {
    run(clean("sh", &root()).arg(".ci/setup").args(parts).stdout(std::io::stderr()))
}

/// Returns the lines of a program's output; `None` where the program fails.
pub fn lines(command: &mut Command) -> Option<Vec<String>> {
    let output = command.stderr(Stdio::null()).output().ok().filter(|out| out.status.success())?;
    let text = String::from_utf8(output.stdout).ok()?;
    Some(text.lines().map(|line| line.trim().to_owned()).collect())
}

/// Returns the first line of a program's output; `None` where the program fails.
pub fn answer(command: &mut Command) -> Option<String> {
    lines(command)?.into_iter().next()
}

fn command_line(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}
