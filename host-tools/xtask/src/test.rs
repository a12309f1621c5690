//! `cargo xtask test`: everything that must hold before a change goes in.

use std::process::Command;

use anyhow::Result;
use clap::ValueEnum;

use crate::run::{answer, cargo, clean_cargo, exists, locked, root, run};
use crate::steps::Steps;
use crate::toolchain::{Choice, Toolchain};
use crate::{cycles, emulator, firmware, packages, python};

/// Which tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// Format, lints and tests of what runs on a host
    Host,
    /// Every board's firmware, and the tests on the emulated one
    Target,
    /// Both
    All,
}

/// What `boards/*/Cargo.toml` choose of the core's features, and none of them.
const CORE_FEATURES: [&str; 2] = ["", "array,slip"];

/// What the names of tests begin with that need the emulated boards.
const EMULATED_PREFIX: &str = "emulated_";

/// Which tests of the host's workspace.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Tests {
    Host,
    Emulated,
}

/// Runs them; the first that fails ends it.
pub fn all(part: Part, choice: Choice, steps: &mut Steps) -> Result<()> {
    if part != Part::Target {
        host(steps)?;
    }
    if part != Part::Host {
        target(choice, steps)?;
    }
    Ok(())
}

fn host(steps: &mut Steps) -> Result<()> {
    steps.take("format", || run(cargo().args(["fmt", "--all", "--check"])))?;
    steps.take("lints", || {
        run(cargo()
            .args(["clippy", "--workspace", "--all-targets"])
            .args(locked())
            .args(["--", "-D", "warnings"]))
    })?;
    steps.take("lints of the core with the estimators of each board", || {
        for features in CORE_FEATURES {
            run(cargo()
                .args(["clippy", "--quiet", "--package", "taxel", "--no-default-features"])
                .args(["--features", features])
                .args(locked())
                .args(["--", "-D", "warnings"]))?;
        }
        Ok(())
    })?;
    steps.take("host tests", || {
        if !exists("chromium") {
            packages::install(&["chromium"], "the browser that the page is tried in")?;
        }
        run(&mut tests(Tests::Host))
    })?;
    steps.take("fuzz targets compile", || {
        run(clean_cargo("cargo", &root().join("tests/fuzz"))
            .args(["check", "--quiet"])
            .args(locked()))
    })?;
    steps.take("examples in the documentation", || {
        run(cargo().args(["test", "--quiet", "--workspace", "--doc"]).args(locked()))
    })?;
    steps.take("Python client", python::tests)
}

fn target(choice: Choice, steps: &mut Steps) -> Result<()> {
    let boards = root().join("boards");
    steps.take("format of the boards", || {
        run(clean_cargo("cargo", &boards).args(["fmt", "--check"]))
    })?;
    let toolchain = steps.take("compiler for the boards", || Toolchain::find(choice))?;
    match &toolchain {
        Toolchain::Installed => steps.take("lints of the boards", || {
            // One by one: no two chips' features may meet in one build of their HAL.
            for board in firmware::boards()? {
                run(toolchain
                    .cargo("clippy")
                    .args(["--quiet", "--package", &board])
                    .args(locked())
                    .args(["--", "-D", "warnings"]))?;
            }
            Ok(())
        })?,
        Toolchain::Debian { .. } => {
            steps.leave_out("lints of the boards", "Debian's rustc-web has no clippy");
        }
    }
    for board in firmware::boards()? {
        steps.take(&format!("firmware of {board}"), || firmware::build(&board, &toolchain))?;
    }
    steps.take("tests of the emulator", emulator::tests)?;
    steps.take("tests on the emulated boards", || {
        emulator::fill()?;
        run(&mut tests(Tests::Emulated))
    })?;
    steps.take("instructions and cycles of every stage", || cycles::guard(&toolchain))
}

/// By nextest where it is there. Always of the whole workspace: a part of it would have its dependencies
/// built anew, with other features.
fn tests(which: Tests) -> Command {
    let mut command = cargo();
    let nextest = answer(cargo().args(["nextest", "--version"])).is_some();
    if nextest {
        command.args(["nextest", "run", "--config-file"]).arg(root().join(".ci/nextest.toml"));
    } else {
        command.args(["test", "--quiet"]);
    }
    command.args(["--workspace", "--no-fail-fast"]).args(locked());
    match (which, nextest) {
        (Tests::Emulated, true) => command.args(["-E", &format!("test({EMULATED_PREFIX})")]),
        (Tests::Emulated, false) => command.args(["--test", "*", "--", EMULATED_PREFIX]),
        (Tests::Host, true) => command.args(["-E", &format!("not test({EMULATED_PREFIX})")]),
        // Without a selection cargo would run the documentation's too.
        (Tests::Host, false) => command.args(["--all-targets", "--", "--skip", EMULATED_PREFIX]),
    };
    command
}
