//! Compiler of the boards: rustc with the Cortex-M target that `.ci/setup boards` installs.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::run::{clean, root};

/// Target triple of the boards.
const TARGET: &str = "thumbv7em-none-eabihf";

/// Returns a cargo command for the boards' workspace.
pub fn cargo(subcommand: &str) -> Command {
    let mut command = clean("cargo", &root().join("boards"));
    command.args([subcommand, "--quiet", "--release", "--target", TARGET]);
    command.env("RUSTC_WRAPPER", root().join("boards/rustc"));
    if let Some(flags) = short_paths() {
        command.arg("--config").arg(format!("target.{TARGET}.rustflags = {flags:?}"));
    }
    command
}

/// Path of the program that [`cargo`] builds for `board`.
pub fn output(board: &str) -> PathBuf {
    root().join("boards/target").join(TARGET).join("release").join(board)
}

/// Flags that shorten the paths in panic messages.
///
/// A full path names this machine and costs the product 2 KB of flash. Debuggers still find the
/// sources. `None` before Rust 1.95, which lacks the flag.
fn short_paths() -> Option<Vec<String>> {
    let help = clean("rustc", &root()).args(["--help", "-v"]).output().ok()?;
    if !String::from_utf8_lossy(&help.stdout).contains("--remap-path-scope") {
        return None;
    }
    let generated = root().join("boards/target").join(TARGET).join("release/build");
    // The last that fits counts.
    let mut short = vec![(root(), String::new()), (generated, String::new())];
    for registry in folders(&cargo_home()?.join("registry/src")) {
        let crates = folders(&registry);
        short.push((registry, String::new()));
        short.extend(crates.into_iter().filter_map(|folder| {
            let (name, _version) = folder.file_name()?.to_str()?.rsplit_once('-')?;
            // Folders in which most paths begin.
            let common = match name {
                "stm32-metapac" => "src/chips",
                "embassy-stm32" | "embassy-usb" => "src",
                _ => return None,
            };
            Some((folder.join(common), format!("{name}/")))
        }));
    }
    let remap =
        short.iter().map(|(path, name)| format!("--remap-path-prefix={}/={name}", path.display()));
    Some(std::iter::once("--remap-path-scope=macro".to_owned()).chain(remap).collect())
}

/// Returns the entries of a folder, none of an absent one.
fn folders(of: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(of).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).collect()
}

/// Cargo's home folder, which holds the sources of crates.
fn cargo_home() -> Option<PathBuf> {
    let home = || std::env::home_dir().map(|home| home.join(".cargo"));
    std::env::var_os("CARGO_HOME").map(PathBuf::from).or_else(home)
}
