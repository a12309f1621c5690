//! The emulator of the boards, a workspace of its own: its build, its tests, and its folder for the `taxel` command.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::run::{exists, locked, program, root, run, target};
use crate::toolchain::{Choice, Toolchain};
use crate::{firmware, packages};

/// Program of the emulator.
const PROGRAM: &str = if cfg!(windows) { "taxel-emulator.exe" } else { "taxel-emulator" };

/// `cargo xtask emulator`: builds the emulator and the images that it runs into [`folder`].
pub fn task(choice: Choice) -> Result<()> {
    prepare()?;
    let toolchain = Toolchain::find(choice)?;
    for board in firmware::boards()? {
        if firmware::is_hardware(&board)? {
            firmware::build(&board, &toolchain)?;
        }
    }
    fill()?;
    println!("{}", folder().display());
    Ok(())
}

/// Builds the emulator and puts it into [`folder`] beside the images, which are there.
pub fn fill() -> Result<()> {
    run(&mut cargo("build"))?;
    std::fs::create_dir_all(folder())?;
    copy(&target().join("debug").join(PROGRAM))?;
    for board in firmware::boards()? {
        if firmware::is_hardware(&board)? {
            copy(&firmware::directory().join(board).with_extension("elf"))?;
        }
    }
    Ok(())
}

fn copy(from: &Path) -> Result<()> {
    let name = from.file_name().unwrap_or_default();
    std::fs::copy(from, folder().join(name)).with_context(|| from.display().to_string())?;
    Ok(())
}

/// Folder of the emulator and its images, where a `taxel` that cargo built looks for them.
pub fn folder() -> PathBuf {
    target().join("emulator")
}

/// Folder of the emulator's sources.
pub fn directory() -> PathBuf {
    root().join("host-tools/emulator")
}

/// The emulator's own format, lints and tests. Those of the whole boards run their images, and have their USB
/// traffic judged by tshark.
pub fn tests() -> Result<()> {
    prepare()?;
    if !exists("tshark") {
        packages::install(&["tshark"], "what judges the board's USB traffic")?;
    }
    run(program("cargo", &directory()).args(["fmt", "--check"]))?;
    run(cargo("clippy").args(["--all-targets", "--", "-D", "warnings"]))?;
    run(&mut cargo("test"))
}

/// A cargo for the emulator's workspace. It builds beside the host's, with which it shares most crates.
pub fn cargo(subcommand: &str) -> Command {
    let name = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = program(name, &directory());
    command.args([subcommand, "--quiet"]).args(locked()).arg("--target-dir").arg(target());
    command
}

/// Installs what unicorn builds with.
pub fn prepare() -> Result<()> {
    if exists("cmake") && libclang() {
        return Ok(());
    }
    packages::install(&["cmake", "libclang-dev"], "what the emulator builds with")
}

/// Where Debian and its kin, Fedora's and a hint to the user's own put it.
fn libclang() -> bool {
    let own = std::env::var_os("LIBCLANG_PATH").map(PathBuf::from);
    let llvm = std::fs::read_dir("/usr/lib").into_iter().flatten().flatten();
    let llvm = llvm.map(|entry| entry.path()).flat_map(|path| [path.join("lib"), path]);
    own.into_iter().chain(llvm).chain(["/usr/lib64".into(), "/usr/lib".into()]).any(|directory| {
        let mut files = std::fs::read_dir(directory).into_iter().flatten().flatten();
        files.any(|file| {
            let name = file.file_name().to_string_lossy().into_owned();
            name.starts_with("libclang.so") || name.starts_with("libclang-") && name.contains(".so")
        })
    })
}
