//! The Python client's own checks: types, lints, and its tests against the `taxel` command.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;

use crate::packages;
use crate::run::{answer, cargo, locked, program, root, run, target};

/// Runs them in an environment of their own under `target/`.
pub fn tests() -> Result<()> {
    let client = root().join("host-tools/python");
    let python = environment(&client)?;
    let check = |module: &[&str]| run(program(&python, &client).arg("-m").args(module));
    check(&["ruff", "check", "."])?;
    check(&["ruff", "format", "--check", "src", "tests"])?;
    check(&["mypy"])?;
    run(cargo().args(["build", "--quiet", "--bin", "taxel"]).args(locked()))?;
    run(program(&python, &client)
        .env("TAXEL", target().join("debug/taxel"))
        .args(["-m", "pytest", "--quiet"]))
}

/// The interpreter of an environment that has the client and what its tests need.
fn environment(client: &Path) -> Result<PathBuf> {
    let directory = target().join("python-client");
    let python = directory.join("bin/python");
    if answer(Command::new(&python).args(["-m", "pytest", "--version"])).is_some() {
        return Ok(python);
    }
    // Debian's python3 makes no environments without this package.
    if answer(Command::new("python3").args(["-c", "import ensurepip; print(1)"])).is_none() {
        packages::install(&["python3", "python3-venv"], "Python with venv")?;
    }
    run(program("python3", client).args(["-m", "venv"]).arg(&directory))?;
    run(program(&python, client).args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--editable",
        ".[test]",
    ]))?;
    Ok(python)
}
