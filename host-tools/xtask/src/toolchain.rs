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
    if remaps_by_scope() {
        // Debug information keeps its paths: debuggers find the sources.
        let generated = root().join("boards/target").join(TARGET).join("release/build");
        let mut flags = short_paths(&[generated]);
        flags.insert(0, "--remap-path-scope=macro".to_owned());
        command.arg("--config").arg(format!("target.{TARGET}.rustflags = {flags:?}"));
    }
    command
}

/// Path of the program that [`cargo`] builds of `package`.
pub fn output(package: &str) -> PathBuf {
    root().join("boards/target").join(TARGET).join("release").join(package)
}

/// Returns whether the compiler can shorten the paths of panic messages alone: from Rust 1.95 on.
fn remaps_by_scope() -> bool {
    let help = clean("rustc", &root()).args(["--help", "-v"]).output();
    help.is_ok_and(|help| String::from_utf8_lossy(&help.stdout).contains("--remap-path-scope"))
}

/// Flags that shorten the paths in programs, also in panic messages.
///
/// A full path names this machine, and costs the product 2 KB of flash. Files in the folders
/// `generated` are named by what follows there.
pub fn short_paths(generated: &[PathBuf]) -> Vec<String> {
    // The last that fits counts.
    let mut short = vec![(root(), String::new())];
    short.extend(generated.iter().map(|folder| (folder.clone(), String::new())));
    for registry in cargo_home().iter().flat_map(|home| folders(&home.join("registry/src"))) {
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
    short
        .iter()
        .map(|(path, name)| format!("--remap-path-prefix={}/={name}", path.display()))
        .collect()
}

/// Folders of this machine that no released program may name.
pub fn machine_paths() -> Vec<PathBuf> {
    let home = std::env::home_dir().map(|home| home.join(""));
    [Some(root()), cargo_home(), home].into_iter().flatten().collect()
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
