//! Compiler of the boards: rustc with the Cortex-M target that `.ci/setup boards` installs.

use std::path::PathBuf;
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
    let registries = cargo_home()?.join("registry/src");
    let registries = std::fs::read_dir(registries).into_iter().flatten().flatten();
    let generated = root().join("boards/target").join(TARGET).join("release/build");
    // The last that fits counts.
    let roots = [root(), generated].into_iter().chain(registries.map(|entry| entry.path()));
    let mut flags = vec!["--remap-path-scope=macro".to_owned()];
    for root in roots {
        flags.push(format!("--remap-path-prefix={}/=", root.display()));
        for entry in std::fs::read_dir(&root).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let Some((name, _version)) = name.rsplit_once('-') else { continue };
            // Folders in which most paths begin.
            let common = match name {
                "stm32-metapac" => "src/chips",
                "embassy-stm32" | "embassy-usb" => "src",
                _ => continue,
            };
            flags.push(format!(
                "--remap-path-prefix={}={name}",
                entry.path().join(common).display()
            ));
        }
    }
    Some(flags)
}

/// Cargo's home folder, which holds the sources of crates.
fn cargo_home() -> Option<PathBuf> {
    let home = || std::env::home_dir().map(|home| home.join(".cargo"));
    std::env::var_os("CARGO_HOME").map(PathBuf::from).or_else(home)
}
