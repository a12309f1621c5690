//! Checks of the Python client: types, lints, installation and tests.
//!
//! The tests run against the `taxel` command. They also read recordings and the ROS 2 bridge with
//! other projects' libraries.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;

use crate::run::{answer, program, root, run, setup, target};

/// Checks the client's lints, types and installation, in environments under `target/`.
pub fn checks() -> Result<()> {
    let client = folder();
    let python = clients_environment(&client)?;
    let check = |module: &[&str]| run(program(&python, &client).arg("-m").args(module));
    check(&["ruff", "check", "."])?;
    check(&["ruff", "format", "--check", "src", "tests", "examples"])?;
    check(&["mypy"])?;
    as_users_install_it(&python)
}

/// Runs the client's tests against the built `taxel`; with `long`, streams last 600 s.
///
/// They run against the wall clock, which a busy machine delays: one that fails runs once more, and
/// is listed then.
pub fn tests(long: bool) -> Result<()> {
    let client = folder();
    let mut pytest = program(clients_environment(&client)?, &client);
    if long {
        pytest.env("TAXEL_ENDURE_S", "600");
    }
    pytest.env("TAXEL", target().join("debug/taxel"));
    run(pytest.args(["-m", "pytest", "--quiet", "--reruns", "1", "-rfER"]))
}

fn folder() -> PathBuf {
    root().join("host-tools/python")
}

/// A user's program for the installed client, which mypy checks.
const USERS: &str = "\
import taxel
serial: str = taxel.Finger(\"/dev/ttyACM0\").info().serial
";

/// Installs the client with `pip install ./host-tools/python`, as the manual says, and tries it.
///
/// The environment holds nothing else. From outside the repository it imports `taxel` and checks a
/// user's program against the installed types.
fn as_users_install_it(tools: &Path) -> Result<()> {
    let folder = target().join("python-user");
    let (python, there) = environment(&folder.join("environment"), "import numpy, serial, cobs")?;
    // An existing environment keeps its dependencies; the client itself is installed again.
    let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
    let again: &[&str] = if there { &["--force-reinstall", "--no-deps"] } else { &[] };
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

/// Returns the interpreter of an environment with the client and its tests' dependencies.
fn clients_environment(client: &Path) -> Result<PathBuf> {
    // An older environment may lack some of these.
    let imports = "import pytest, pytest_rerunfailures, mypy, ruff, pandas, zenoh, foxglove_schemas_protobuf, h5py, mcap_protobuf, pyarrow, rosbags, websockets, xxhash, foxglove, ruamel.yaml; import sys; sys.version_info < (3, 11) or __import__('rerun')";
    let (python, there) = environment(&target().join("python-client"), imports)?;
    if !there {
        // The tests import a small part of these packages, so the rest is not compiled.
        let install = ["-m", "pip", "install", "--quiet", "--no-compile", "--editable", ".[test]"];
        run(program(&python, client).args(install))?;
    }
    Ok(python)
}

/// Returns the interpreter of the environment in `folder`, and whether its `imports` are there;
/// makes an empty environment where they are not.
pub fn environment(folder: &Path, imports: &str) -> Result<(PathBuf, bool)> {
    let programs = folder.join(if cfg!(windows) { "Scripts" } else { "bin" });
    let python = programs.join(format!("python{}", std::env::consts::EXE_SUFFIX));
    let check = format!("{imports}; print(1)");
    let there = answer(Command::new(&python).args(["-c", &check])).is_some();
    if !there {
        setup(&["python"])?;
        run(program("python3", &root()).args(["-m", "venv"]).arg(folder))?;
    }
    Ok((python, there))
}
