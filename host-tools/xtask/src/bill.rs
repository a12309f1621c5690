//! Bill of materials of a released program: its parts for machines, in CycloneDX (SBOM), and the
//! licences of all parts for people.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::firmware;
use crate::run::{answer, cargo, root, run, target};

/// The command. Every other program is a board's.
pub const COMMAND: &str = "taxel";
/// Licence of the page's plots, the only part of `taxel` that is no crate.
const PLOTS: &str = "host-tools/cli/assets/page/uplot/LICENSE";
/// Cargo's subcommands, and what installs them.
const TOOLS: [(&str, &str); 2] = [
    ("cyclonedx", "cargo install --locked cargo-cyclonedx"),
    ("about", "cargo install --locked cargo-about --features cli"),
];

/// Fails where a tool is missing.
pub fn need_tools() -> Result<()> {
    for (tool, install) in TOOLS {
        if answer(cargo().args([tool, "--version"])).is_none() {
            bail!("`cargo {tool}` is missing; install it with `{install}`");
        }
    }
    Ok(())
}

/// Files that [`write`] makes of a program: bill of materials and licences.
pub fn files(program: &str) -> [String; 2] {
    ["cdx.json", "notices.txt"].map(|end| format!("{program}.{end}"))
}

/// Writes the [`files`] of the command or of a board's program into the folder `out`.
///
/// # Errors
/// A part has a licence that `deny.toml` does not allow.
pub fn write(program: &str, out: &Path) -> Result<()> {
    // Two chips of one package are made of the same crates: its default features give them all.
    let manifest = match program {
        COMMAND => root().join("host-tools/cli/Cargo.toml"),
        board => firmware::manifest(board)?,
    };
    let [bill, licences] = files(program).map(|file| out.join(file));
    parts(program, &manifest, &bill)?;
    notices(program, &manifest, &licences)
}

/// Writes the bill of materials. The tool leaves one beside each package of the workspace.
fn parts(program: &str, manifest: &Path, out: &Path) -> Result<()> {
    let name = format!("{program}.cdx");
    run(at(&mut cargo(), &["cyclonedx"], manifest)
        .args(["--format", "json", "--spec-version", "1.5", "--no-build-deps", "--quiet"])
        .args(["--target", "all", "--override-filename", &name]))?;
    let mut metadata = cargo();
    let metadata = at(&mut metadata, &["metadata", "--no-deps", "--format-version", "1"], manifest)
        .output()?;
    let metadata: Value = serde_json::from_slice(&metadata.stdout)?;
    for package in metadata["packages"].as_array().into_iter().flatten() {
        let member = Path::new(package["manifest_path"].as_str().unwrap_or_default());
        let written = member.with_file_name(format!("{name}.json"));
        if member == manifest {
            fs::copy(&written, out).with_context(|| written.display().to_string())?;
        }
        if written.exists() {
            fs::remove_file(&written)?;
        }
    }
    Ok(())
}

/// Writes the licence of each part, once for all parts that share its text.
fn notices(program: &str, manifest: &Path, out: &Path) -> Result<()> {
    let accepted = target().join("about.toml");
    fs::write(&accepted, accepted_licences()?)?;
    let template = root().join("host-tools/xtask/notices.hbs");
    run(at(&mut cargo(), &["about", "generate", "--fail"], manifest)
        .arg("--config")
        .arg(accepted)
        .arg("--output-file")
        .arg(out)
        .arg(template))?;
    if program == COMMAND {
        let plots = fs::read_to_string(root().join(PLOTS))?;
        let text = fs::read_to_string(out)?;
        fs::write(out, format!("{text}uPlot, which draws the page's plots\n\n{plots}"))?;
    }
    Ok(())
}

/// Configuration of `cargo about`: the licences that `deny.toml` allows.
fn accepted_licences() -> Result<String> {
    let deny: toml::Table = toml::from_str(&fs::read_to_string(root().join("deny.toml"))?)?;
    let allowed = deny.get("licenses").and_then(|licenses| licenses.get("allow"));
    let mut about = toml::Table::new();
    about.insert("accepted".into(), allowed.context("deny.toml allows no licence")?.clone());
    for scope in ["ignore-dev-dependencies", "ignore-build-dependencies"] {
        about.insert(scope.into(), true.into());
    }
    Ok(toml::to_string(&about)?)
}

fn at<'c>(command: &'c mut Command, words: &[&str], manifest: &Path) -> &'c mut Command {
    command.args(words).arg("--manifest-path").arg(manifest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn licences_are_those_of_deny() {
        let about = accepted_licences().unwrap();
        assert!(about.contains("\"Apache-2.0\"") && !about.contains("GPL"), "{about}");
        assert!(fs::read_to_string(root().join(PLOTS)).unwrap().contains("Leon Sorokin"));
    }
}
