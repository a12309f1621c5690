//! `cargo xtask cycles --peers`: the same net in other people's libraries, on the same machine.
//!
//! Their sources come from PyPI, their compiler from Debian; neither is needed for anything else, so that
//! no other task fetches them.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::run::{answer, program, root, run, setup};
use crate::{cycles, emulator};

const COMPILER: &str = "arm-none-eabi-gcc";
const EMLEARN: &str = "emlearn==0.23.2";
const CMSIS_DSP: &str = "cmsisdsp==1.10.3";
/// What of CMSIS-DSP the net needs.
const DSP_SOURCES: [&str; 3] = [
    "MatrixFunctions/arm_mat_vec_mult_f32.c",
    "MatrixFunctions/arm_mat_init_f32.c",
    "BasicMathFunctions/arm_add_f32.c",
];
/// A Cortex-M4F as the core's own image is built for.
const CORE: [&str; 4] = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"];
/// Of these each library's fastest counts. A fused multiply-add is three cycles, one apart from the other
/// two: that is what the contraction is switched off for.
const FLAGS: [&str; 6] = [
    "-O2",
    "-O3",
    "-Ofast",
    "-O2 -ffp-contract=off",
    "-O3 -funroll-loops -ffp-contract=off",
    "-Ofast -funroll-loops -ffp-contract=off",
];
/// What was looked for and not found. Of the packages that name it, `cmsis-nn-rs` (crates.io) and
/// `tflite-micro` (PyPI) come without its C sources, `tfmicro` (crates.io) with their callers alone,
/// `torch2cmsis` (PyPI) with a converter, `utensor-cgen` (PyPI) with a caller's template, `mlonmcu` (PyPI) with a
/// script that fetches it from elsewhere, and `executorch` (PyPI) with the library as built for a PC.
const MISSING: &str = "CMSIS-NN s16: not built, no package with its C sources was found on PyPI, npm, crates.io or Debian";

/// Builds them, runs them and writes the table to `csv`.
pub fn task(image: &Path, csv: &Path) -> Result<()> {
    setup(&["peers"])?;
    let version = answer(Command::new(COMPILER).arg("-dumpfullversion"));
    let version = version.context("arm-none-eabi-gcc does not say its version")?;
    let folder = root().join("target/peers");
    std::fs::create_dir_all(&folder)?;
    let (emlearn, dsp) = (fetch(EMLEARN, &folder)?, fetch(CMSIS_DSP, &folder)?);
    let mut emulator = cycles::emulator("peers", image);
    for (i, flags) in FLAGS.into_iter().enumerate() {
        let elf = folder.join(format!("peers{i}.elf"));
        compile(flags, &emlearn, &dsp, &elf)?;
        emulator
            .arg("--peer")
            .arg(format!("arm-none-eabi-gcc {version} {flags}={}", elf.display()));
    }
    run(emulator.args(["--missing", MISSING]).arg("--csv").arg(csv))
}

fn compile(flags: &str, emlearn: &Path, dsp: &Path, elf: &Path) -> Result<()> {
    let own = emulator::directory().join("peers");
    let include = |path: PathBuf| format!("-I{}", path.display());
    run(program(COMPILER, &own)
        .args(CORE)
        .args(flags.split(' '))
        // Theirs is theirs: its warnings are not for us. The macro spares CMSIS-DSP the CMSIS core.
        .args(["-w", "-ffunction-sections", "-fdata-sections", "-D__GNUC_PYTHON__"])
        .arg(include(emlearn.join("emlearn")))
        .args([include(dsp.join("Include")), include(dsp.join("PrivateInclude"))])
        .arg("peers.c")
        .args(DSP_SOURCES.map(|source| dsp.join("Source").join(source)))
        .args(["-nostartfiles", "-Tpeers.ld", "-Wl,--gc-sections", "-lm", "-o"])
        .arg(elf))
}

/// The unpacked files of a package of PyPI.
fn fetch(package: &str, folder: &Path) -> Result<PathBuf> {
    let (name, version) = package.split_once("==").context("a package has a version")?;
    let unpacked = folder.join(name);
    if unpacked.exists() {
        return inner(&unpacked, name, version);
    }
    let archives = folder.join(format!("{name}-archive"));
    // A wheel where there is one that suits every machine; sources else.
    let kind = if name == "cmsisdsp" { "--no-binary" } else { "--only-binary" };
    run(program("python3", folder)
        .args(["-m", "pip", "download", "--quiet", "--no-deps", kind, name, package, "--dest"])
        .arg(&archives))?;
    let archive = std::fs::read_dir(&archives)?.flatten().next();
    let archive = archive.with_context(|| format!("pip brought no {package}"))?.path();
    let unpack = "import shutil, sys; a, to = sys.argv[1:]; \
                  shutil.unpack_archive(a, to, 'zip' if a.endswith('.whl') else None)";
    run(program("python3", folder).args(["-c", unpack]).arg(archive).arg(&unpacked))?;
    inner(&unpacked, name, version)
}

/// Sources lie in a folder of their name and version, wheels do not.
fn inner(unpacked: &Path, name: &str, version: &str) -> Result<PathBuf> {
    let inner = unpacked.join(format!("{name}-{version}"));
    Ok(if inner.exists() { inner } else { unpacked.to_owned() })
}
