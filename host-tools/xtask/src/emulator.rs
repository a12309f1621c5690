//! The boards' emulator, a workspace of its own: its build, tests and folder.
//!
//! The `taxel` command finds the emulator and its images in that folder.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::firmware;
use crate::run::{locked, program, root, run, setup, target};

/// File name of the emulator's program.
const PROGRAM: &str = if cfg!(windows) { "taxel-emulator.exe" } else { "taxel-emulator" };

/// Runs `cargo xtask emulator`: builds the emulator and its images into [`folder`].
pub fn task() -> Result<()> {
    setup(&["boards", "emulator"])?;
    for board in firmware::hardware()? {
        firmware::build(&board)?;
    }
    fill(cargo("build"))?;
    println!("{}", folder().display());
    Ok(())
}

/// Builds the emulator by `build`, and copies it and the finished images into [`folder`].
pub fn fill(mut build: Command) -> Result<()> {
    run(&mut build)?;
    std::fs::create_dir_all(folder())?;
    copy(&target().join("debug").join(PROGRAM))?;
    for board in firmware::hardware()? {
        copy(&firmware::directory().join(board).with_extension("elf"))?;
    }
    Ok(())
}

fn copy(from: &Path) -> Result<()> {
    let name = from.file_name().unwrap_or_default();
    std::fs::copy(from, folder().join(name)).with_context(|| from.display().to_string())?;
    Ok(())
}

/// Path of the emulator in [`folder`].
pub fn built() -> PathBuf {
    folder().join(PROGRAM)
}

/// Folder of the emulator and its images, where a `taxel` built by cargo looks for them.
pub fn folder() -> PathBuf {
    target().join("emulator")
}

/// Folder of the emulator's sources.
pub fn directory() -> PathBuf {
    root().join("host-tools/emulator")
}

/// Returns a cargo command for the emulator's workspace.
///
/// It builds into the host's target folder, because both share most crates.
pub fn cargo(subcommand: &str) -> Command {
    let name = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = program(name, &directory());
    command.args([subcommand, "--quiet"]).args(locked()).arg("--target-dir").arg(target());
    command
}
