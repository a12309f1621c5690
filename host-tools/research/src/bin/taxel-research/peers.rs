//! Cycles of the same net in other libraries, on the same emulated core.
//!
//! The libraries' sources come from PyPI and their compiler from Debian; nothing else needs either.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::{answer, command, root, run};

const COMPILER: &str = "arm-none-eabi-gcc";
const EMLEARN: &str = "emlearn==0.23.2";
const CMSIS_DSP: &str = "cmsisdsp==1.10.3";
/// Sources of CMSIS-DSP that the net needs.
const DSP_SOURCES: [&str; 10] = [
    "MatrixFunctions/arm_mat_vec_mult_f32.c",
    "MatrixFunctions/arm_mat_vec_mult_q15.c",
    "MatrixFunctions/arm_mat_init_f32.c",
    "MatrixFunctions/arm_mat_init_q15.c",
    "BasicMathFunctions/arm_add_f32.c",
    "BasicMathFunctions/arm_add_q15.c",
    "BasicMathFunctions/arm_scale_f32.c",
    "InterpolationFunctions/arm_linear_interp_q15.c",
    "SupportFunctions/arm_float_to_q15.c",
    "SupportFunctions/arm_q15_to_float.c",
];
/// Flags for the Cortex-M4F of the core's own image.
const CORE: [&str; 4] = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"];
/// Sets of optimisation flags; each library's fastest counts.
///
/// Some turn contraction off, because a fused multiply-add takes three cycles, a multiplication and
/// an addition two.
const FLAGS: [&str; 6] = [
    "-O2",
    "-O3",
    "-Ofast",
    "-O2 -ffp-contract=off",
    "-O3 -funroll-loops -ffp-contract=off",
    "-Ofast -funroll-loops -ffp-contract=off",
];
/// Note for the table on a library that no package provides as source.
///
/// These packages name it without its C sources: `cmsis-nn-rs` (crates.io) and `tflite-micro`
/// (PyPI). `tfmicro` (crates.io) has its callers alone, `torch2cmsis` (PyPI) a converter, and
/// `utensor-cgen` (PyPI) a caller's template. `mlonmcu` (PyPI) has a script that fetches it from
/// elsewhere, `executorch` (PyPI) the library as built for a PC.
const MISSING: &str = "CMSIS-NN s16: not built, no package with its C sources was found on PyPI, npm, crates.io or Debian";

/// Builds the libraries, runs them on the emulator and writes the table.
pub fn count() -> Result<()> {
    let (root, emulator) = (root(), root().join("host-tools/emulator"));
    run(command("sh", &root).args([".ci/setup", "boards", "emulator", "peers"]))?;
    let version = answer(command(COMPILER, &root).arg("-dumpfullversion"))?;
    let folder = root.join("target/peers");
    std::fs::create_dir_all(&folder)?;
    let (emlearn, dsp) = (fetch(EMLEARN, &folder)?, fetch(CMSIS_DSP, &folder)?);
    let image = answer(command("cargo", &root).args(["xtask", "firmware", "cycles"]))?;
    let data = emulator.join("data");
    let mut peers = command("cargo", &emulator);
    peers.args(["run", "--quiet", "--target-dir"]).arg(root.join("target"));
    peers.args(["--", "peers"]).arg(image).arg("--csv").arg(data.join("peers.csv"));
    for (name, file) in
        [("--calibration", "finger.cal.toml"), ("--scans", "scans.csv"), ("--whole", "whole")]
    {
        peers.arg(name).arg(data.join(file));
    }
    for (i, flags) in FLAGS.into_iter().enumerate() {
        // The macro gives the libraries the core's tanh.
        for (kind, define) in [("plain", None), ("tanh", Some("-DCORE_TANH"))] {
            let elf = folder.join(format!("peers-{kind}{i}.elf"));
            compile(flags, define, [&emlearn, &dsp], &elf)?;
            let with = format!("arm-none-eabi-gcc {version} {flags}={}", elf.display());
            peers.arg("--peer").arg(with);
        }
    }
    run(peers.args(["--missing", MISSING]))
}

fn compile(
    flags: &str,
    define: Option<&str>,
    [emlearn, dsp]: [&Path; 2],
    elf: &Path,
) -> Result<()> {
    let own = root().join("host-tools/emulator/peers");
    let include = |path: PathBuf| format!("-I{}", path.display());
    run(command(COMPILER, &own)
        .args(CORE)
        .args(flags.split(' '))
        .args(define)
        // Warnings of foreign code are off. The folder has a stand-in for the CMSIS core.
        .args(["-w", "-ffunction-sections", "-fdata-sections", "-I."])
        .arg(include(emlearn.join("emlearn")))
        .args([include(dsp.join("Include")), include(dsp.join("PrivateInclude"))])
        .arg("peers.c")
        .args(DSP_SOURCES.map(|source| dsp.join("Source").join(source)))
        .args(["-nostartfiles", "-Tpeers.ld", "-Wl,--gc-sections", "-lm", "-o"])
        .arg(elf))
}

/// Downloads and unpacks a PyPI package; returns its folder.
fn fetch(package: &str, folder: &Path) -> Result<PathBuf> {
    let (name, version) = package.split_once("==").context("a package has a version")?;
    let unpacked = folder.join(name);
    if unpacked.exists() {
        return inner(&unpacked, name, version);
    }
    let archives = folder.join(format!("{name}-archive"));
    // cmsisdsp comes as sources; the other as a wheel that suits every machine.
    let kind = if name == "cmsisdsp" { "--no-binary" } else { "--only-binary" };
    run(command("python3", folder)
        .args(["-m", "pip", "download", "--quiet", "--no-deps", kind, name, package, "--dest"])
        .arg(&archives))?;
    let archive = std::fs::read_dir(&archives)?.flatten().next();
    let archive = archive.with_context(|| format!("pip brought no {package}"))?.path();
    let unpack = "import shutil, sys; a, to = sys.argv[1:]; \
                  shutil.unpack_archive(a, to, 'zip' if a.endswith('.whl') else None)";
    run(command("python3", folder).args(["-c", unpack]).arg(archive).arg(&unpacked))?;
    inner(&unpacked, name, version)
}

/// Folder of the unpacked files: sources lie in a subfolder of name and version, wheels do not.
fn inner(unpacked: &Path, name: &str, version: &str) -> Result<PathBuf> {
    let inner = unpacked.join(format!("{name}-{version}"));
    Ok(if inner.exists() { inner } else { unpacked.to_owned() })
}
