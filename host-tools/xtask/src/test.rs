//! `cargo xtask test`: the tests of a change, of a merge and of a night.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};

use crate::changes::Changes;
use crate::pages::Pages;
use crate::run::{answer, cargo, clean, locked, program, root, run, setup, target};
use crate::steps::Steps;
use crate::{cycles, emulator, firmware, fuzz, pages, protocol, python, registers, release};

/// Arguments of `cargo xtask test`.
#[derive(Args)]
pub struct Test {
    /// One part of the tests
    #[arg(value_enum, default_value_t = Part::All)]
    part: Part,
    /// How much of it; a part alone is never quick
    #[arg(long, value_enum, default_value_t = Profile::Quick)]
    profile: Profile,
    /// Every package, not only what changed since `main` and what depends on it (quick)
    #[arg(long)]
    all: bool,
}

/// Parts that can run on separate machines.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Part {
    /// Format and lints
    Lint,
    /// Tests of what runs on a host
    Host,
    /// Every board's firmware, the emulator, and the tests on emulated boards
    Target,
    /// The Python client, against the `taxel` command
    Python,
    /// All of them
    All,
}

/// Amount of testing; the profiles of `.config/nextest.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum Profile {
    /// Tests of at most two minutes, without browser, emulator, judged accuracy and faulty fits
    Quick,
    /// Everything that must hold before a change goes in
    Ci,
    /// Also hour-long tests: fuzzing, charts of five devices, every power cut, ten-minute streams
    Nightly,
}

impl Profile {
    /// Name of the profile in nextest's configuration.
    fn name(self) -> &'static str {
        match self {
            Self::Quick => "default",
            Self::Ci => "ci",
            Self::Nightly => "nightly",
        }
    }
}

/// Feature sets of the core that `boards/*/Cargo.toml` choose.
const CORE_FEATURES: [&str; 2] = ["", "array,slip"];

/// Name of the test modules that need the emulator and the boards' images.
const EMULATED: &str = "emulated_board";

/// Cases of a nightly run for each property that sets no number itself.
const NIGHTLY_CASES: &str = "4096";

/// Seconds of a nightly run for each fuzz target.
const FUZZ_SECONDS: u32 = 600;

/// Features that only these tests build, because each doubles the command's crates.
const BRIDGES: [&str; 2] = ["--features", "taxel-cli/foxglove,taxel-cli/zenoh"];

/// Environment in which cargo compiles a workspace's crates and lints them in the same pass.
///
/// `cargo clippy` sets the same two variables, but compiles every crate without its code.
const LINTS: [(&str, &str); 2] = [
    ("RUSTC_WORKSPACE_WRAPPER", "clippy-driver"),
    ("CLIPPY_ARGS", "-D__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__"),
];

/// Runs the tests. Stops at the first step that fails, except at night, when nobody waits.
pub fn task(test: &Test, steps: &mut Steps) -> Result<()> {
    let &Test { part, profile, all } = test;
    if profile == Profile::Quick && part == Part::All {
        return quick(all, steps);
    }
    let profile = profile.max(Profile::Ci);
    steps.keep_going = profile == Profile::Nightly;
    let takes = |one| part == one || part == Part::All;
    steps.side_by_side(
        |steps| {
            if takes(Part::Lint) {
                lint(takes(Part::Host), profile, steps)?;
            }
            if takes(Part::Host) {
                // Benchmarks take as long to build as a package's tests.
                let targets: &[&str] = match profile {
                    Profile::Nightly => &["--all-targets"],
                    _ => &["--tests", "--examples"],
                };
                steps.take("lints and build of the host tests", || {
                    run(bridged(&["test", "--no-run", "--workspace"]).args(targets))
                })
            } else if takes(Part::Python) {
                steps.take("build of the command", || {
                    run(&mut bridged(&["build", "--bin", "taxel"]))
                })
            } else {
                Ok(())
            }
        },
        |steps| {
            let needs = [
                (Part::Host, "page"),
                (Part::Host, "spice"),
                (Part::Target, "boards"),
                (Part::Target, "emulator"),
                (Part::Python, "python"),
            ];
            let needs: Vec<_> =
                needs.iter().filter(|(part, _)| takes(*part)).map(|(_, need)| *need).collect();
            steps.take("set-up", || setup(&needs))?;
            if takes(Part::Python) {
                steps.take("Python client: types, lints, installation", python::checks)?;
            }
            if takes(Part::Target) {
                images(steps)?;
                steps.take("lints and build of the emulator", || {
                    run(program("cargo", &emulator::directory()).args(["fmt", "--all", "--check"]))?;
                    run(linted(emulator::cargo("test")).args(["--no-run", "--tests"]))
                })?;
            }
            Ok(())
        },
    )?;
    if takes(Part::Host) {
        steps.take("host tests", || run(&mut tests(profile, &root(), Selection::OnHost)?))?;
        steps.take("examples in the documentation", || {
            run(&mut bridged(&["test", "--workspace", "--doc"]))
        })?;
    }
    // The Python tests mostly wait for their streams, by the wall clock. Emulated boards have a
    // clock of their own, so that neither delays the other.
    steps.side_by_side(
        |steps| if takes(Part::Target) { emulated(profile, steps) } else { Ok(()) },
        |steps| {
            if !takes(Part::Python) {
                return Ok(());
            }
            steps.take("Python client", || python::tests(profile == Profile::Nightly))
        },
    )?;
    if profile == Profile::Nightly && part == Part::All {
        steps.take("figures of the reference finger", || pages::task(&Pages::CHECK_ALL))?;
        steps.take("speed of files, in an optimised build", || {
            run(on_host(&["test", "--release", "--package", "taxel-research", "--test", "it"])
                .arg("throughput::"))
        })?;
        steps.take("fuzzing", || fuzz::all(FUZZ_SECONDS))?;
    }
    Ok(())
}

/// Checks the format and runs the quick tests of the changed packages.
fn quick(all: bool, steps: &mut Steps) -> Result<()> {
    steps.take("format", || run(cargo().args(["fmt", "--all", "--check"])))?;
    steps.take("parts made from the frame schema", || protocol::task(true))?;
    steps.take("parts made from tables", || pages::task(&Pages::CHECK))?;
    let changes = if all { Changes::Everything } else { Changes::since_main()? };
    steps.take(&format!("quick tests of {changes}"), || {
        run(&mut tests(Profile::Quick, &root(), Selection::Filter(&changes.filter()))?)
    })?;
    steps.leave_out("lints, boards, browser, Python", "`cargo xtask test --profile ci` takes all");
    Ok(())
}

/// Checks format and lints; the host's crates only if nothing else compiles them.
fn lint(compiled: bool, profile: Profile, steps: &mut Steps) -> Result<()> {
    steps.take("format", || {
        run(cargo().args(["fmt", "--all", "--check"]))?;
        run(clean("cargo", &root().join("boards")).args(["fmt", "--check"]))
    })?;
    if !compiled {
        steps.take("lints", || {
            let mut command = on_host(&["clippy", "--workspace", "--all-targets"]);
            run(command.args(["--", "-D", "warnings"]))
        })?;
    }
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
    steps.take("lints of the command that `cargo demo` builds", || {
        let mut command = on_host(&["clippy", "--package", "taxel-cli", "--no-default-features"]);
        run(command.args(["--", "-D", "warnings"]))
    })?;
    steps.take("parts made from the frame schema", || protocol::task(true))?;
    steps.take("parts made from tables", || pages::task(&Pages::CHECK))?;
    // A release builds them too.
    steps.take("packages of the core", || {
        release::pack(&["--no-verify", "--allow-dirty"]).map(|_| ())
    })?;
    // Nothing else needs the crates that the tables are made from.
    const TABLES: &str = "tables of the chips' registers";
    if profile == Profile::Nightly || registers::sources().is_ok() {
        steps.take(TABLES, || registers::task(true))?;
    } else {
        steps.leave_out(TABLES, "their crates are neither here nor can be downloaded");
    }
    steps.take("fuzz targets compile", fuzz::check)?;
    spelling_and_licences(steps)
}

/// Checks spelling and licences where the tools are installed; CI has jobs of its own for both.
fn spelling_and_licences(steps: &mut Steps) -> Result<()> {
    let typos = || clean("typos", &root());
    let deny = || clean("cargo-deny", &root());
    let missing = |mut tool: Command| answer(tool.arg("--version")).is_none();
    if missing(typos()) {
        steps.leave_out("spelling", "`typos` is not installed");
    } else {
        steps.take("spelling", || run(&mut typos()))?;
    }
    if missing(deny()) {
        steps.leave_out("licences", "`cargo-deny` is not installed");
        return Ok(());
    }
    steps.take("licences and sources of the dependencies", || {
        ["", "boards/", "host-tools/emulator/", "tests/fuzz/"].iter().try_for_each(|folder| {
            let manifest = format!("{folder}Cargo.toml");
            run(deny()
                .args(["--log-level", "error", "--manifest-path", &manifest])
                .args(locked())
                .args(["check", "licenses", "bans", "sources"]))
        })
    })
}

/// Runs the emulator's tests and those on emulated boards, and counts cycles.
fn emulated(profile: Profile, steps: &mut Steps) -> Result<()> {
    // The tests of whole boards run their images, and tshark judges their USB traffic.
    steps.take("tests of the emulator", || {
        run(&mut tests(profile, &emulator::directory(), Selection::All)?)
    })?;
    steps.take("tests on the emulated boards", || {
        emulator::fill(linted(emulator::cargo("build")))?;
        run(&mut tests(profile, &root(), Selection::OnBoards)?)
    })?;
    steps.take("instructions and cycles of every stage", cycles::guard)
}

/// Returns a cargo command for the host's workspace.
fn on_host(arguments: &[&str]) -> Command {
    let mut command = cargo();
    command.args(arguments).arg("--quiet").args(locked());
    command
}

/// Returns a cargo command for the host's workspace with [`BRIDGES`] and [`LINTS`].
fn bridged(arguments: &[&str]) -> Command {
    let mut command = linted(on_host(arguments));
    command.args(BRIDGES);
    command
}

/// Adds [`LINTS`] to a cargo command.
fn linted(mut command: Command) -> Command {
    command.envs(LINTS);
    command
}

/// Runs the boards' lints and builds their images, in a target folder of their own.
fn images(steps: &mut Steps) -> Result<()> {
    steps.take("lints of the boards", || {
        for board in firmware::boards()? {
            run(firmware::cargo("clippy", &board)?.args(["--", "-D", "warnings"]))?;
        }
        Ok(())
    })?;
    for board in firmware::boards()? {
        steps.take(&format!("firmware of {board}"), || firmware::build(&board))?;
    }
    // The product's flash is the fullest.
    steps.take("firmware of the product with its log", || {
        firmware::build_with(firmware::PRODUCT, Some("info"))
    })
}

/// Tests of a workspace to run.
#[derive(Clone, Copy)]
pub enum Selection<'a> {
    /// All tests.
    All,
    /// Tests that a nextest filter selects; all tests where nextest is not installed.
    Filter(&'a str),
    /// Tests without an emulated board.
    OnHost,
    /// Tests on emulated boards.
    OnBoards,
}

/// Returns a command that tests the workspace in `directory`, by nextest where installed.
///
/// It builds the whole workspace, because a part would compile its dependencies again with fewer
/// features.
pub fn tests(profile: Profile, directory: &Path, selection: Selection) -> Result<Command> {
    let cargo = || program(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()), directory);
    let mut command = cargo();
    let nextest = answer(cargo().args(["nextest", "--version"])).is_some();
    if nextest {
        command.args(["nextest", "run", "--cargo-quiet", "--config-file"]).arg(config());
        command.args(["--profile", profile.name(), "--no-tests", "pass"]);
    } else {
        command.args(["test", "--quiet", "--no-fail-fast"]);
    }
    command.args(["--workspace", "--tests", "--target-dir"]).arg(target());
    command.args(locked());
    if profile != Profile::Quick {
        command.envs(LINTS);
        if directory == root() {
            command.args(BRIDGES);
        }
    }
    if profile == Profile::Nightly {
        // `TAXEL_LONG` asks campaigns for their long form.
        command.env("PROPTEST_CASES", NIGHTLY_CASES).env("TAXEL_LONG", "1");
    }
    let emulated = format!("test(/(^|::){EMULATED}::/)");
    if nextest {
        let filter = match selection {
            Selection::All => "all()",
            Selection::Filter(filter) => filter,
            Selection::OnHost => &format!("not {emulated}"),
            Selection::OnBoards => &emulated,
        };
        command.args(["--filterset", filter]);
        return Ok(command);
    }
    let (only, not) = match selection {
        Selection::OnBoards => (Some(EMULATED), None),
        Selection::OnHost => (None, Some(EMULATED)),
        Selection::All | Selection::Filter(_) => (None, None),
    };
    command.arg("--").args(only.map(|module| format!("{module}::")));
    let left_out = left_out(profile, &std::fs::read_to_string(config())?)?;
    for module in left_out.iter().map(String::as_str).chain(not) {
        command.args(["--skip", &format!("{module}::")]);
    }
    Ok(command)
}

/// Path of the nextest configuration, which all workspaces share.
fn config() -> PathBuf {
    root().join(".config/nextest.toml")
}

/// Lists the modules that a profile's `default-filter` leaves out.
fn left_out(profile: Profile, config: &str) -> Result<Vec<String>> {
    let config: toml::Value = toml::from_str(config).context(".config/nextest.toml")?;
    let filter = config["profile"][profile.name()]["default-filter"].as_str();
    let names = filter.context(".config/nextest.toml: a default-filter is a string")?;
    let Some((_, names)) = names.split_once("not test(/(^|::)") else { return Ok(Vec::new()) };
    let names = names.split_once("::/)").map_or(names, |(names, _)| names);
    Ok(names.trim_matches(['(', ')']).split('|').map(str::to_owned).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profile_leaves_out_modules_of_its_filter() {
        let config = std::fs::read_to_string(config()).unwrap();
        let slow = [
            "accuracy",
            "baseline",
            "browser",
            "emulated_board",
            "endurance",
            "ill_posed",
            "nightly",
        ];
        assert_eq!(left_out(Profile::Quick, &config).unwrap(), slow);
        assert_eq!(left_out(Profile::Ci, &config).unwrap(), ["nightly"]);
        assert!(left_out(Profile::Nightly, &config).unwrap().is_empty());
    }
}
