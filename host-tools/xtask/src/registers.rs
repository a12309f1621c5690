//! `cargo xtask registers`: tables of the emulated chips' registers, from two descriptions of them.
//!
//! `host-tools/emulator/data/registers.csv` is the emulator's table. Its source are the crates
//! `stm32g4` and `stm32f4`, which are generated from the manufacturer's SVD files. The firmware's
//! register access is generated from other descriptions, those of `stm32-metapac`, so that neither
//! hides a mistake of the other. `data/register-differences.csv` and a section of
//! `docs/boards/upstream.md` list the registers on which the two disagree. The crates are read and
//! not compiled, because compiling takes a minute, and `stm32-metapac` has one chip a build.

mod differences;
mod metapac;
mod svd;

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::changes::packages;
use crate::marks;
use crate::run::{locked, program, root};

/// Emulated chip and its descriptions.
struct Chip {
    board: &'static str,
    /// Crate of the SVD files, and the chip's module in it.
    svd: [&'static str; 2],
    /// Name in `stm32-metapac`.
    metapac: &'static str,
    /// Board with the same firmware, whose table of faults names the registers that it configures.
    firmware: &'static str,
    /// Peripherals of interest, by their names in the SVD file.
    peripherals: &'static str,
}

/// Peripherals of the product's two chips.
const G4: &str = "RCC FLASH GPIOA GPIOB GPIOC GPIOD GPIOE GPIOF TIM1 TIM2 DMA1 DMAMUX ADC1 ADC2 \
                  ADC12_COMMON OPAMP IWDG CRC USB PWR SYSCFG EXTI CRS DBGMCU";

const CHIPS: [Chip; 3] = [
    Chip {
        board: "stm32g431",
        svd: ["stm32g4", "stm32g431"],
        metapac: "stm32g431cb",
        firmware: "stm32g431",
        peripherals: G4,
    },
    Chip {
        board: "stm32g473",
        svd: ["stm32g4", "stm32g473"],
        metapac: "stm32g473ce",
        firmware: "stm32g431",
        peripherals: G4,
    },
    Chip {
        board: "stm32f411",
        svd: ["stm32f4", "stm32f411"],
        metapac: "stm32f411ce",
        firmware: "stm32f411",
        peripherals: "RCC FLASH GPIOA GPIOB GPIOC GPIOD GPIOE GPIOH TIM1 TIM2 DMA2 ADC1 ADC_COMMON \
                      IWDG CRC OTG_FS_GLOBAL OTG_FS_DEVICE OTG_FS_PWRCLK PWR SYSCFG EXTI DBGMCU",
    },
];

/// Packages of a workspace, with their folders.
type Packages = Vec<(String, PathBuf)>;

/// Folders of the two workspaces that name the crates: the emulator and the boards.
fn workspaces() -> [PathBuf; 2] {
    ["host-tools/emulator", "boards"].map(|folder| root().join(folder))
}

/// Lists the packages of the two workspaces, which cargo downloads if they are not here.
pub fn sources() -> Result<[Packages; 2]> {
    let list = |workspace: &Path| {
        packages(program("cargo", workspace).arg("metadata").args(locked()))
            .with_context(|| workspace.display().to_string())
    };
    let [emulator, boards] = workspaces();
    Ok([list(&emulator)?, list(&boards)?])
}

/// Writes the tables; with `check`, fails if one differs and writes nothing.
pub fn task(check: bool) -> Result<()> {
    let [emulator, boards] = workspaces();
    let [svds, metapacs] = sources()?;
    let mut text = "board,address,register,reset,fields,writable\n".to_owned();
    let mut found = Vec::new();
    for Chip { board, svd: [svd, module], metapac, firmware, peripherals } in CHIPS {
        let source = folder(&svds, svd, &emulator)?.join("src").join(module);
        let registers = svd::registers(&source, peripherals)?;
        for (address, register) in &registers {
            let svd::Register { names, reset, fields, writable, .. } = register;
            let names = names.join(" ");
            writeln!(text, "{board},{address:#010x},{names},{reset:#x},{fields:#x},{writable:#x}")?;
        }
        let source = folder(&metapacs, "stm32-metapac", &boards)?.join("src");
        let described = metapac::registers(&source, metapac)?;
        let written = written(&emulator.join(format!("data/faults-{firmware}.csv")))?;
        found.extend(differences::list(board, &registers, &described, &written));
    }
    let page = root().join("docs/boards/upstream.md");
    let drawn = differences::drawn(&read(&page)?, &found)
        .with_context(|| format!("{}: no part `register differences`", page.display()))?;
    for (path, text) in [
        (emulator.join("data/registers.csv"), text),
        (emulator.join("data/register-differences.csv"), differences::csv(&found)),
        (page, drawn),
    ] {
        if marks::whole(&path, text.as_bytes(), check)? && check {
            bail!(
                "{} differs from the chips' descriptions; run `cargo xtask registers`",
                path.display()
            );
        }
    }
    Ok(())
}

/// Folder of a package in the list of a workspace's.
fn folder<'a>(packages: &'a [(String, PathBuf)], name: &str, workspace: &Path) -> Result<&'a Path> {
    let package = packages.iter().find(|(package, _)| package == name);
    let (_, folder) =
        package.with_context(|| format!("{}: does not name {name}", workspace.display()))?;
    Ok(folder)
}

/// Addresses of the registers in a table of faults: those that the image configures.
fn written(faults: &Path) -> Result<BTreeSet<u32>> {
    let text = read(faults)?;
    let addresses = text.lines().skip(1).map(|line| {
        let address = line.split(',').nth(1).context("no column `address`")?;
        number(address)
    });
    addresses.collect::<Result<_>>().with_context(|| faults.display().to_string())
}

fn number(text: &str) -> Result<u32> {
    let text = text.replace('_', "");
    Ok(match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16)?,
        None => text.parse()?,
    })
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| path.display().to_string())
}
