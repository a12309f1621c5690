//! The Python client's own checks: types, lints, and its tests against the `taxel` command; and, with other
//! people's libraries, what recordings and the bridge to ROS 2 are worth.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;

use crate::run::{answer, program, root, run, setup, target};

/// Lints and types of the client, and its installation, in environments of their own under `target/`.
pub fn checks() -> Result<()> {
    let client = folder();
    let python = environment(&client)?;
    let check = |module: &[&str]| run(program(&python, &client).arg("-m").args(module));
    check(&["ruff", "check", "."])?;
    check(&["ruff", "format", "--check", "src", "tests"])?;
    check(&["mypy"])?;
    as_users_install_it(&python, &client)
}

/// Tests of the client against the `taxel` command, which is built; `long`, streams take ten minutes and not seconds.
pub fn tests(long: bool) -> Result<()> {
    let client = folder();
    let mut pytest = program(environment(&client)?, &client);
    if long {
        pytest.env("TAXEL_ENDURE_S", "600");
    }
    run(pytest.env("TAXEL", target().join("debug/taxel")).args(["-m", "pytest", "--quiet"]))
}

fn folder() -> PathBuf {
    root().join("host-tools/python")
}

/// A program of somebody who has installed the client: types and all.
const USERS: &str = "\
import taxel
serial: str = taxel.Finger(\"/dev/ttyACM0\").info().serial
";

/// `pip install ./host-tools/python`, as the manual has it, into an environment that has nothing else; then from a folder
/// outside of the repository `taxel` is imported, and a user's program is checked against the types that came along.
fn as_users_install_it(tools: &Path, client: &Path) -> Result<()> {
    let folder = target().join("python-user");
    let environment = folder.join("environment");
    let python = environment.join("bin/python");
    let there = answer(Command::new(&python).args(["-c", "import numpy, serial, cobs; print(1)"]));
    if there.is_none() {
        run(program("python3", client).args(["-m", "venv"]).arg(&environment))?;
    }
    // What it needs is there from the last time; the client itself is built and installed again.
    let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
    let again: &[&str] = if there.is_some() { &["--force-reinstall", "--no-deps"] } else { &[] };
    run(program(&python, &root()).args(install).args(again).arg("./host-tools/python"))?;
    let typed = "import taxel, pathlib; p = pathlib.Path(taxel.__file__).parent; \
                 assert 'site-packages' in p.parts and (p / 'py.typed').exists(), p";
    run(program(&python, &folder).args(["-I", "-c", typed]))?;
    std::fs::write(folder.join("program.py"), USERS)?;
    run(program(tools, &folder)
        .args(["-m", "mypy", "--strict", "--python-executable"])
        .arg(&python)
        .args(["--config-file=", "program.py"]))?;
    Ok(())
}

/// The interpreter of an environment that has the client and what its tests need.
fn environment(client: &Path) -> Result<PathBuf> {
    let directory = target().join("python-client");
    let python = directory.join("bin/python");
    // An environment from before these were needed lacks them.
    let all_there = "import pytest, mypy, ruff, pandas, zenoh, mcap_protobuf, pyarrow, rosbags, websockets, xxhash";
    let check = format!("{all_there}; print(1)");
    if answer(Command::new(&python).args(["-c", &check])).is_some() {
        return Ok(python);
    }
    setup(&["python"])?;
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
