//! Fuzzing of every parser of outside bytes, with the targets of `tests/fuzz`.

use std::process::Command;

use anyhow::{Context, Result};
use serde::Deserialize;

use crate::run::{answer, clean, locked, program, root, run, target};

/// Compiler flags for libFuzzer's coverage on stable Rust.
const INSTRUMENTED: &str = "--cfg fuzzing -C debug-assertions -C codegen-units=1 -C passes=sancov-module \
     -C llvm-args=-sanitizer-coverage-level=4 -C llvm-args=-sanitizer-coverage-inline-8bit-counters \
     -C llvm-args=-sanitizer-coverage-pc-table -C llvm-args=-sanitizer-coverage-trace-compares";

/// Returns a cargo command for the fuzz targets' workspace.
fn cargo(subcommand: &str) -> Command {
    let mut command = clean("cargo", &root().join("tests/fuzz"));
    command.args([subcommand, "--quiet"]).args(locked());
    command
}

/// Checks that the targets compile. They are not linked, so libFuzzer itself is not built.
pub fn check() -> Result<()> {
    run(cargo("check").env("CUSTOM_LIBFUZZER_PATH", "/libFuzzer.a"))
}

/// Runs each target for `seconds`; keeps inputs that reach new code in `target/fuzz`.
pub fn all(seconds: u32) -> Result<()> {
    let host = answer(Command::new("rustc").args(["--print", "host-tuple"]));
    let host = host.context("rustc does not name its host")?;
    let build = target().join("fuzz/build");
    // Build scripts stay uninstrumented only where a target is named.
    run(cargo("build")
        .args(["--release", "--target", &host, "--target-dir"])
        .arg(&build)
        .env("RUSTFLAGS", INSTRUMENTED))?;
    for name in names()? {
        let folder = target().join("fuzz").join(&name);
        let corpus = folder.join("corpus");
        std::fs::create_dir_all(&corpus)?;
        eprintln!("{name}: {seconds} s");
        run(program(build.join(&host).join("release").join(&name), &folder)
            .arg(format!("-max_total_time={seconds}"))
            .args(["-print_final_stats=1", "-verbosity=0"])
            .arg(&corpus))?;
    }
    Ok(())
}

/// Lists the names of the targets.
fn names() -> Result<Vec<String>> {
    #[derive(Deserialize)]
    struct Manifest {
        bin: Vec<Target>,
    }
    #[derive(Deserialize)]
    struct Target {
        name: String,
    }
    let path = root().join("tests/fuzz/Cargo.toml");
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let manifest: Manifest = toml::from_str(&text).with_context(|| path.display().to_string())?;
    Ok(manifest.bin.into_iter().map(|target| target.name).collect())
}
