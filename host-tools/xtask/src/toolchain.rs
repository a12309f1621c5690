//! What builds for a Cortex-M on this machine. In this order: the target that is installed for the
//! rustc in use; one that `rustup` can fetch; Debian's rustc-web, which builds `core` from source and
//! borrows the linker that rustup's toolchains carry.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::ValueEnum;

use crate::packages;
use crate::run::{answer, clean_cargo, exists, root, succeeds_within};

/// The boards' target.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// A download that takes longer is not going to come.
const PATIENCE: Duration = Duration::from_secs(60);

const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_CARGO: &str = "/usr/bin/cargo";
/// Of which cargo builds `core`.
const DEBIAN_SOURCE: &str = "/usr/lib/rustlib/src/rust/library/Cargo.lock";

/// Which toolchain the user wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Choice {
    /// The first that works
    Auto,
    /// The target of the rustc in use, fetched by rustup where it is missing
    Installed,
    /// Debian's rustc-web, cargo-web and rust-web-src, installed where they are missing
    Debian,
}

/// What builds for the boards.
#[derive(Debug)]
pub enum Toolchain {
    /// rustc has the target.
    Installed,
    /// Debian's rustc, with this linker.
    Debian { linker: PathBuf },
}

impl Toolchain {
    /// The best there is, after fetching what is missing.
    pub fn find(choice: Choice) -> Result<Self> {
        if choice != Choice::Debian {
            if installed() || fetched()? {
                return Ok(Self::Installed);
            }
            if choice == Choice::Installed {
                bail!("no target {TARGET}; install it: `rustup target add {TARGET}`");
            }
        }
        if ![DEBIAN_RUSTC, DEBIAN_CARGO, DEBIAN_SOURCE].iter().all(|path| Path::new(path).exists())
        {
            let need = "a compiler for the boards (or `rustup target add thumbv7em-none-eabihf`)";
            packages::install(&["rustc-web", "cargo-web", "rust-web-src"], need)?;
        }
        let linker = match linker() {
            Some(linker) => linker,
            None => {
                packages::install(&["lld"], "a linker for the boards")?;
                "ld.lld".into()
            }
        };
        Ok(Self::Debian { linker })
    }

    /// How it is called in headings.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Installed => "the installed target",
            Self::Debian { .. } => "Debian's rustc-web",
        }
    }

    /// A cargo command for the boards' workspace. Each toolchain has its own target directory: they
    /// would build each other's output anew.
    pub fn cargo(&self, subcommand: &str) -> Command {
        let boards = root().join("boards");
        let mut command = match self {
            Self::Installed => clean_cargo("cargo", &boards),
            Self::Debian { .. } => clean_cargo(DEBIAN_CARGO, &boards),
        };
        command.args([subcommand, "--release", "--target", TARGET, "--target-dir"]);
        command.arg(self.target_directory());
        if let Some(flags) = self.short_paths() {
            command.arg("--config").arg(format!("target.{TARGET}.rustflags = {flags:?}"));
        }
        if let Self::Debian { linker } = self {
            let variable =
                format!("CARGO_TARGET_{}_LINKER", TARGET.to_uppercase().replace('-', "_"));
            command.arg("-Zbuild-std=core").env(variable, linker);
            // RUSTC_BOOTSTRAP lets a stable compiler build its own library.
            command.env("RUSTC", DEBIAN_RUSTC).env("RUSTC_BOOTSTRAP", "1");
            command.env_remove("RUSTUP_TOOLCHAIN").env_remove("RUSTC_WRAPPER");
        }
        command
    }

    /// Flags by which panics name their source from its crate on: a path in full is of this machine, and
    /// costs the product 2 KB of flash. Debuggers still find it. None before Rust 1.95, which had it not.
    fn short_paths(&self) -> Option<Vec<String>> {
        let mut compiler = match self {
            Self::Installed => rustc(),
            Self::Debian { .. } => Command::new(DEBIAN_RUSTC),
        };
        let help = compiler.args(["--help", "-v"]).output().ok()?;
        if !String::from_utf8_lossy(&help.stdout).contains("--remap-path-scope") {
            return None;
        }
        let registries = cargo_home()?.join("registry/src");
        let registries = std::fs::read_dir(registries).into_iter().flatten().flatten();
        let roots = std::iter::once(root()).chain(registries.map(|entry| entry.path()));
        let remap = roots.map(|path| format!("--remap-path-prefix={}/=", path.display()));
        Some(std::iter::once("--remap-path-scope=macro".to_owned()).chain(remap).collect())
    }

    /// Where that cargo leaves the file of `board`.
    pub fn output(&self, board: &str) -> PathBuf {
        self.target_directory().join(TARGET).join("release").join(board)
    }

    fn target_directory(&self) -> PathBuf {
        root().join("boards/target").join(match self {
            Self::Installed => "installed",
            Self::Debian { .. } => "debian",
        })
    }
}

/// The rustc in use, as nested builds will find it.
fn rustc() -> Command {
    clean_cargo("rustc", &root())
}

/// Where cargo keeps the sources of crates.
fn cargo_home() -> Option<PathBuf> {
    let home = || std::env::home_dir().map(|home| home.join(".cargo"));
    std::env::var_os("CARGO_HOME").map(PathBuf::from).or_else(home)
}

fn sysroot() -> Option<PathBuf> {
    answer(rustc().args(["--print", "sysroot"])).map(PathBuf::from)
}

fn installed() -> bool {
    sysroot().is_some_and(|path| path.join("lib/rustlib").join(TARGET).join("lib").is_dir())
}

fn fetched() -> Result<bool> {
    if !exists("rustup") {
        return Ok(false);
    }
    eprintln!("fetching the target {TARGET}");
    let mut rustup = clean_cargo("rustup", &root());
    let fetched = succeeds_within(rustup.args(["target", "add", TARGET]), PATIENCE)
        .context("rustup target add")?;
    if !fetched {
        eprintln!("rustup could not fetch it");
    }
    // What it fetched must be what rustc looks at: the rustc on the path may not be rustup's.
    Ok(fetched && installed())
}

/// rust-lld from the toolchain in use, else the system's lld.
fn linker() -> Option<PathBuf> {
    let hosts = sysroot().and_then(|path| std::fs::read_dir(path.join("lib/rustlib")).ok());
    let mut bundled =
        hosts.into_iter().flatten().flatten().map(|host| host.path().join("bin/rust-lld"));
    let system = || exists("ld.lld").then(|| "ld.lld".into());
    bundled.find(|path| path.is_file()).or_else(system)
}
