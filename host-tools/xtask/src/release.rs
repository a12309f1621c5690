//! `cargo xtask release`: all files of a release, in one folder.
//!
//! Images, the core's package, the Python client, and the command as a wheel and as an archive,
//! each program with its bill of materials and its parts' licences, and checksums of all.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use object::build::elf::Builder;
use object::{Object, ObjectSegment};

use crate::run::{answer, cargo, clean, lines, locked, program, root, run, setup, target};
use crate::steps::Steps;
use crate::{bill, firmware, install, python, toolchain};

/// Arguments of `cargo xtask release`.
#[derive(Args)]
pub struct Release {
    /// One part of the files
    #[arg(value_enum, default_value_t = Part::All)]
    part: Part,
    /// Folder to write into, which must not hold anything
    #[arg(long, value_name = "FOLDER", default_value = "dist")]
    out: PathBuf,
}

/// Parts that can be made on separate machines.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Part {
    /// The core's packages for crates.io
    Core,
    /// Images of the boards, the core's packages and the Python client
    Firmware,
    /// The command for this machine's system
    Command,
    /// All of them, with checksums
    All,
}

/// Packages for crates.io: the core and what it depends on.
const PACKAGES: [&str; 2] = ["taxel-dsp", "taxel"];
/// Largest package and largest program in bytes.
const LARGEST_PACKAGE: u64 = 1 << 20;
const LARGEST_PROGRAM: u64 = 25 << 20;

/// Makes the files of a release.
///
/// # Errors
/// The tree has changes, the folder holds something, a tool is missing, a file is too large, or an
/// image differs when it is built in another folder, or a program names this machine.
pub fn task(release: &Release, steps: &mut Steps) -> Result<()> {
    let changed = lines(program("git", &root()).args(["status", "--porcelain"]));
    ensure!(
        changed.is_some_and(|files| files.is_empty()),
        "the tree has changes, and a release is that of a commit: commit or stash them"
    );
    if release.part != Part::Core {
        bill::need_tools()?;
    }
    let out = &release.out;
    fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let out = &out.canonicalize().with_context(|| out.display().to_string())?;
    ensure!(
        fs::read_dir(out)?.next().is_none(),
        "{} is not empty: empty it, or choose another folder with --out",
        out.display()
    );
    let takes = |part| release.part == part || release.part == Part::All;
    if takes(Part::Firmware) {
        images(out, steps)?;
    }
    if takes(Part::Core) || takes(Part::Firmware) {
        steps.take("packages of the core", || packages(out))?;
    }
    if takes(Part::Firmware) {
        steps.take("Python client", || wheel("host-tools/python", out).map(|_| ()))?;
    }
    if takes(Part::Command) {
        steps.take("the command", || command(out))?;
    }
    if release.part == Part::All {
        steps.take("checksums", || checksums(out))?;
    }
    for file in files(out)? {
        eprintln!("{:>10}  {}", fs::metadata(&file)?.len(), file.display());
    }
    Ok(())
}

/// Builds the image of every board, here and in another folder, and compares what is flashed.
fn images(out: &Path, steps: &mut Steps) -> Result<()> {
    setup(&["boards"])?;
    let boards = firmware::hardware()?;
    for board in &boards {
        steps.take(&format!("firmware of {board}"), || {
            let (image, _) = firmware::build(board)?;
            let image = without_debug_information(&image)?;
            let elf = out.join(format!("{board}.elf"));
            fs::write(&elf, image)?;
            names_no_machine(&elf)?;
            bill::write(board, out)
        })?;
    }
    steps.take("the same images from another folder", || {
        let elsewhere = target().join("release-elsewhere");
        if elsewhere.exists() {
            fs::remove_dir_all(&elsewhere)?;
        }
        run(program("git", &root()).args(["clone", "--quiet", "."]).arg(&elsewhere))?;
        for board in &boards {
            let mut build = clean("cargo", &elsewhere);
            let again = answer(build.args(["xtask", "firmware", board]))
                .with_context(|| format!("{board} is not built in {}", elsewhere.display()))?;
            let here = fs::read(out.join(format!("{board}.elf")))?;
            let there = without_debug_information(Path::new(&again))?;
            ensure!(here == there, "{board}: the image depends on the folder in which it is built");
            eprintln!("{board}: the same {} bytes", here.len());
        }
        Ok(fs::remove_dir_all(&elsewhere)?)
    })
}

/// Returns an image without its debug information, whose paths are those of this machine.
fn without_debug_information(elf: &Path) -> Result<Vec<u8>> {
    let bytes = fs::read(elf).with_context(|| elf.display().to_string())?;
    let mut image = Builder::read(&*bytes).with_context(|| elf.display().to_string())?;
    for section in &mut image.sections {
        section.delete = section.name.starts_with(b".debug_");
    }
    let mut stripped = Vec::new();
    image.write(&mut stripped).with_context(|| elf.display().to_string())?;
    let [before, after] = [&bytes, &stripped].map(|image| flashed(image));
    ensure!(before? == after?, "{}: what is flashed has changed", elf.display());
    Ok(stripped)
}

/// Returns what a programmer writes of an image: addresses and bytes.
fn flashed(elf: &[u8]) -> Result<Vec<(u64, Vec<u8>)>> {
    let file = object::File::parse(elf)?;
    let part = |part: object::Segment<'_, '_>| Ok((part.address(), part.data()?.to_vec()));
    file.segments().map(part).collect()
}

/// Fails where a program holds a path of the machine that built it.
fn names_no_machine(program: &Path) -> Result<()> {
    let bytes = fs::read(program).with_context(|| program.display().to_string())?;
    for path in toolchain::machine_paths() {
        let name = path.as_os_str().as_encoded_bytes();
        let named = name.len() > 1 && bytes.windows(name.len()).any(|window| window == name);
        ensure!(
            !named,
            "{} holds the path {} of this machine: add what it belongs to to `short_paths`",
            program.display(),
            path.display()
        );
    }
    Ok(())
}

/// Packs the core for crates.io, builds it from there alone, and copies it.
fn packages(out: &Path) -> Result<()> {
    for packed in pack(&[])? {
        let name = packed.file_name().context("a package without a name")?;
        fs::copy(&packed, out.join(name))?;
    }
    Ok(())
}

/// Packs the core for crates.io with options of `cargo package`, and returns the packages.
///
/// # Errors
/// A file is missing, or a package is too large.
pub fn pack(options: &[&str]) -> Result<Vec<PathBuf>> {
    let mut pack = cargo();
    pack.args(["package", "--quiet"]).args(locked()).args(options);
    PACKAGES.iter().for_each(|name| {
        pack.args(["--package", name]);
    });
    run(&mut pack)?;
    let packed = PACKAGES.map(|name| {
        let file = format!("{name}-{}.crate", env!("CARGO_PKG_VERSION"));
        target().join("package").join(file)
    });
    packed.iter().try_for_each(|packed| within(packed, LARGEST_PACKAGE))?;
    Ok(packed.into())
}

/// Builds the command once, as a wheel, and packs its program as an archive by the name that
/// cargo-binstall looks for.
fn command(out: &Path) -> Result<()> {
    let wheel = wheel("host-tools/cli", out)?;
    let folder = target().join("release-command");
    if folder.exists() {
        fs::remove_dir_all(&folder)?;
    }
    fs::create_dir_all(&folder)?;
    run(program(python()?, &folder).args(["-m", "zipfile", "-e"]).arg(wheel).arg("wheel"))?;
    let name = format!("taxel{}", std::env::consts::EXE_SUFFIX);
    let data = files(&folder.join("wheel"))?;
    let built =
        data.iter().map(|data| data.join("scripts").join(&name)).find(|file| file.is_file());
    let built = built.context("the wheel has no program")?;
    within(&built, LARGEST_PROGRAM)?;
    install::size_agrees(fs::metadata(&built)?.len())?;
    names_no_machine(&built)?;
    let archive = folder.join("archive");
    fs::create_dir(&archive)?;
    let taxel = archive.join(&name);
    fs::copy(built, &taxel)?;
    #[cfg(unix)]
    fs::set_permissions(&taxel, std::os::unix::fs::PermissionsExt::from_mode(0o755))?;
    run(program(&taxel, &folder).args([
        "demo",
        "--headless",
        "--duration",
        "2",
        "--tcp",
        "127.0.0.1:0",
    ]))?;
    bill::write(bill::COMMAND, out)?;
    for file in bill::files(bill::COMMAND) {
        fs::copy(out.join(&file), archive.join(&file))?;
    }
    for file in ["README.md", "LICENSE-APACHE", "LICENSE-MIT"] {
        fs::copy(root().join(file), archive.join(file))?;
    }
    let host = answer(clean("rustc", &root()).args(["--print", "host-tuple"]));
    let host = host.context("`rustc --print host-tuple` fails")?;
    run(program("tar", &archive).arg("-czf").arg(out.join(format!("taxel-{host}.tar.gz"))).arg("."))
}

/// Builds the wheel of a folder into `out` and returns its path.
fn wheel(folder: &str, out: &Path) -> Result<PathBuf> {
    let before = files(out)?;
    run(program(python()?, &root())
        .args(["-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"])
        .arg("--wheel-dir")
        .arg(out)
        .env("CARGO_ENCODED_RUSTFLAGS", toolchain::short_paths(&[]).join("\u{1f}"))
        .arg(format!("./{folder}")))?;
    let made = files(out)?.into_iter().find(|file| !before.contains(file));
    made.with_context(|| format!("pip made no wheel of {folder}"))
}

/// Returns the interpreter of an environment that holds pip alone.
fn python() -> Result<PathBuf> {
    python::environment(&target().join("python-release"), "import pip").map(|(python, _)| python)
}

/// Writes `SHA256SUMS`, for `sha256sum --check SHA256SUMS`.
fn checksums(out: &Path) -> Result<()> {
    let names = files(out)?.into_iter().filter_map(|file| Some(file.file_name()?.to_owned()));
    let sums =
        lines(program("sha256sum", out).arg("--").args(names)).context("`sha256sum` fails")?;
    Ok(fs::write(out.join("SHA256SUMS"), sums.join("\n") + "\n")?)
}

fn within(file: &Path, most: u64) -> Result<()> {
    let bytes = fs::metadata(file).with_context(|| file.display().to_string())?.len();
    ensure!(bytes <= most, "{}: {bytes} bytes, at most {most}", file.display());
    Ok(())
}

/// Entries of a folder in the order of their names.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files: Vec<PathBuf> =
        fs::read_dir(folder)?.map(|file| Ok(file?.path())).collect::<Result<_>>()?;
    files.sort();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn path_of_the_machine_in_a_program_is_noticed() {
        let file = target().join(format!("named-{}", std::process::id()));
        fs::write(&file, b"\0src/finger.rs\0").unwrap();
        let without = names_no_machine(&file);
        fs::write(&file, format!("\0{}/src/finger.rs\0", root().display())).unwrap();
        let with = names_no_machine(&file);
        fs::remove_file(file).unwrap();
        assert!(without.is_ok() && with.unwrap_err().to_string().contains("short_paths"));
    }
}
