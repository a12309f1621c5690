//! Builds the boards' firmware and checks its size, stack and panics.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;

use crate::image::Image;
use crate::memory::{Footprint, Use, footprint};
use crate::run::{answer, locked, program, root, run, setup};
use crate::{panics, stack, toolchain};

/// Manifest of a package in `boards/`.
#[derive(Deserialize)]
struct Manifest {
    package: Package,
    /// The program; a library alone has none.
    #[serde(default)]
    bin: Vec<Program>,
}

#[derive(Deserialize)]
struct Package {
    #[serde(default)]
    metadata: Metadata,
}

#[derive(Default, Deserialize)]
struct Metadata {
    /// Fingers' boards by name, where the program is a finger's.
    #[serde(default)]
    board: BTreeMap<String, Finger>,
}

#[derive(Deserialize)]
struct Program {
    name: String,
}

/// `[package.metadata.board.NAME]` of a manifest: NAME is a finger's board, with a page and a limit
/// of its stack.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Finger {
    /// Cargo features of its chip, in place of the default ones.
    #[serde(default)]
    features: Vec<String>,
    /// Largest flash use in bytes.
    flash_budget: Option<u64>,
    ram_budget: Option<u64>,
}

/// Board that runs a program of `boards/`.
struct Board {
    name: String,
    /// Folder of `boards/`, named as its package and program.
    package: String,
    /// Budgets and features of a finger's board; `None` for another one.
    finger: Option<Finger>,
}

impl Board {
    /// Finds a board by its name.
    fn find(name: &str) -> Result<Self> {
        let mut boards = Self::all()?;
        let names: Vec<_> = boards.iter().map(|board| board.name.clone()).collect();
        let at = names.iter().position(|known| known == name);
        let at =
            at.with_context(|| format!("no board `{name}`; there are: {}", names.join(", ")))?;
        Ok(boards.swap_remove(at))
    }

    /// Lists the programs of all packages in `boards/`, by name.
    fn all() -> Result<Vec<Self>> {
        let mut boards = Vec::new();
        for entry in std::fs::read_dir(root().join("boards")).context("reading boards/")? {
            let path = entry?.path().join("Cargo.toml");
            if path.is_file() {
                let at = || path.display().to_string();
                let text = std::fs::read_to_string(&path).with_context(at)?;
                let package = path.parent().and_then(Path::file_name).unwrap_or_default();
                let package = package.to_string_lossy();
                boards.extend(Self::of(&package, &text).with_context(at)?);
            }
        }
        boards.sort_by(|one, other| one.name.cmp(&other.name));
        Ok(boards)
    }

    /// Reads the boards of a package's manifest.
    fn of(package: &str, manifest: &str) -> Result<Vec<Self>> {
        let Manifest { package: Package { metadata }, bin } = toml::from_str(manifest)?;
        let board = |name, finger| Self { name, package: package.to_owned(), finger };
        if metadata.board.is_empty() {
            return Ok(bin.into_iter().map(|program| board(program.name, None)).collect());
        }
        Ok(metadata.board.into_iter().map(|(name, finger)| board(name, Some(finger))).collect())
    }

    /// Adds the board's package and features to a cargo command.
    fn select(&self, cargo: &mut Command) {
        cargo.args(["--package", &self.package]);
        let features = self.finger.iter().flat_map(|finger| &finger.features);
        let features: Vec<_> = features.map(String::as_str).collect();
        if !features.is_empty() {
            cargo.args(["--no-default-features", "--features", &features.join(",")]);
        }
    }

    /// Path of the memory map: the board's own, else its package's, else the product's in the root.
    fn memory_x(&self) -> PathBuf {
        let package = root().join("boards").join(&self.package);
        let folders = [package.join(&self.name), package, root()];
        let [.., product] = &folders;
        let own = folders.iter().find(|folder| folder.join("memory.x").is_file());
        own.unwrap_or(product).join("memory.x")
    }
}

/// Returns a cargo command for one board's package.
///
/// Each board builds alone, because two chips' features must not meet in one build of their HAL.
pub fn cargo(subcommand: &str, board: &str) -> Result<Command> {
    let mut cargo = toolchain::cargo(subcommand);
    Board::find(board)?.select(&mut cargo);
    cargo.args(locked());
    Ok(cargo)
}

/// Manifest of the package whose program a board runs.
pub fn manifest(board: &str) -> Result<PathBuf> {
    Ok(root().join("boards").join(Board::find(board)?.package).join("Cargo.toml"))
}

/// Board that is the product.
pub const PRODUCT: &str = "stm32g431";
/// Image that measures the core's stages; no finger runs it.
const BENCH: &str = "cycles";

/// Lists the names of all boards.
pub fn boards() -> Result<Vec<String>> {
    Ok(Board::all()?.into_iter().map(|board| board.name).collect())
}

/// Lists the boards on which a finger runs.
pub fn hardware() -> Result<Vec<String>> {
    let fingers = Board::all()?.into_iter().filter(|board| board.finger.is_some());
    Ok(fingers.map(|board| board.name).collect())
}

/// Runs `cargo xtask firmware BOARD`.
pub fn task(board: &str) -> Result<()> {
    // A wrong name is said before anything is installed.
    Board::find(board)?;
    setup(&["boards"])?;
    let log = std::env::var("DEFMT_LOG").ok().filter(|level| !level.is_empty() && level != "off");
    let (path, _) = build_with(board, log.as_deref())?;
    println!("{}", path.display());
    Ok(())
}

/// Folder of finished firmware.
pub fn directory() -> PathBuf {
    root().join("boards/target/firmware")
}

/// Builds one board, checks it and copies the file into [`directory`].
pub fn build(board: &str) -> Result<(PathBuf, Footprint)> {
    build_with(board, None)
}

/// As [`build`], but with a log of level `log` over the probe. That image has a name of its own, is
/// for the bench, and may take the budgets' reserve: its limits are the memories. The others log
/// nothing: it takes a kilobyte of flash and one of RAM, and `taxel info` tells the last panic,
/// too.
pub fn build_with(board: &str, log: Option<&str>) -> Result<(PathBuf, Footprint)> {
    let found = Board::find(board)?;
    let mut cargo = cargo("build", board)?;
    cargo.env("TAXEL_BUILD", revision()).env("DEFMT_LOG", log.unwrap_or("off"));
    run(&mut cargo)?;
    let built = toolchain::output(&found.package);
    let footprint = footprint(&built, &found.memory_x())?;
    let suffix = log.map_or("", |_| "-log");
    let path = publish(&built, &directory().join(format!("{board}{suffix}.elf")))?;
    let Footprint { flash, ram, ccm, .. } = footprint;
    let ccm = ccm.map(|ccm| format!(", CCM {}", size(ccm))).unwrap_or_default();
    eprintln!("{board}: flash {}, RAM {} + stack{ccm}", size(flash), size(ram));
    let hardware = found.finger.is_some();
    let Finger { flash_budget, ram_budget, .. } = found.finger.unwrap_or_default();
    for (used, most, what) in
        [(footprint.flash.used, flash_budget, "flash"), (footprint.ram.used, ram_budget, "RAM")]
    {
        let most = most.filter(|_| log.is_none()).unwrap_or(u64::MAX);
        ensure!(
            used <= most,
            "{used} bytes of {what} are over the budget of {most}; `llvm-nm -S --size-sort` shows what takes them"
        );
    }
    if hardware {
        let stack = stack_fits(board, &built, &footprint)?;
        // The table has the images that log nothing.
        if log.is_none() {
            table_agrees(board, &footprint, stack)?;
        }
    }
    if board != BENCH {
        panics_are_known(board, &built)?;
    }
    Ok((path, footprint))
}

/// Page with the table of all images' sizes.
const TABLE: &str = "docs/boards/images.md";
/// Relative tolerance of the table, because another compiler's code differs a little.
const MARGIN: f64 = 0.05;

/// Fails where a size in the board's row of the table differs by more than [`MARGIN`].
fn table_agrees(board: &str, footprint: &Footprint, stack: u32) -> Result<()> {
    let page = std::fs::read_to_string(root().join(TABLE)).context(TABLE)?;
    let Footprint { flash, ram, ccm, stack: left } = footprint;
    let ccm = ccm.unwrap_or(Use { used: 0, of: 0 });
    let sizes = [flash.used, flash.of, ram.used, ram.of, ccm.used, ccm.of, u64::from(stack), *left];
    let sizes = sizes.map(|bytes| bytes as f64 / 1024.0);
    let row = page.lines().find_map(|line| line.strip_prefix(&format!("| {board} | ")));
    let stated = row.map(|row| row.split(" | ").map_while(|cell| cell.parse::<f64>().ok()));
    let stated: Vec<f64> = stated.into_iter().flatten().take(sizes.len()).collect();
    let off = |(size, stated): (&f64, &f64)| (size - stated).abs() > MARGIN * size.max(1.0);
    if stated.len() < sizes.len() || sizes.iter().zip(&stated).any(off) {
        let row: String = sizes.iter().map(|size| format!("{size:.1} | ")).collect();
        bail!("{TABLE}: the row of {board} should begin `| {board} | {row}`");
    }
    Ok(())
}

/// Returns the deepest stack in bytes; fails where the board has less.
fn stack_fits(board: &str, built: &Path, footprint: &Footprint) -> Result<u32> {
    let (stack, room) = (stack::deepest(&Image::read(built)?)?, footprint.stack);
    eprintln!("{board}: stack at most {} of {room} bytes", stack.bytes);
    if u64::from(stack.bytes) > room {
        let path: Vec<_> = stack.path.iter().map(|(name, own)| format!("{own} {name}")).collect();
        bail!("{board} may run out of stack; the deepest path:\n  {}", path.join("\n  "));
    }
    Ok(stack.bytes)
}

/// Lists the lines that could panic; fails where one is new or in the core.
fn panics_are_known(board: &str, built: &Path) -> Result<()> {
    let sites = panics::remaining(built, &Image::read(built)?)?;
    eprintln!("{board}: no panic in the core; lines that may elsewhere, and why they do not:");
    for (owner, lines) in &sites {
        eprintln!("  {:3} {owner}: {}", lines.len(), panics::why(owner).unwrap_or_default());
    }
    panics::none_is_new(board, &sites, &panics::list()?)
}

/// Replaces the file atomically, because an emulator may be reading it.
fn publish(built: &Path, path: &Path) -> Result<PathBuf> {
    let copy = path.with_extension(format!("{}.tmp", std::process::id()));
    std::fs::create_dir_all(directory())
        .and_then(|()| std::fs::copy(built, &copy))
        .and_then(|_| std::fs::rename(&copy, path))
        .with_context(|| format!("writing {}", path.display()))?;
    Ok(path.to_owned())
}

/// Returns git's description of the commit that is built, or `unknown`.
///
/// Its length is always the same, because a longer name would move the constants behind it.
fn revision() -> String {
    let git = |arguments: &[&str]| answer(program("git", &root()).args(arguments));
    let description = git(&["describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]);
    format!("{:<20}", description.as_deref().unwrap_or("unknown"))
}

fn size(Use { used, of }: Use) -> String {
    let kilobytes = |bytes: u64| bytes as f64 / 1024.0;
    format!("{:.1} of {:.0} KB", kilobytes(used), kilobytes(of))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Words by which cargo builds each board of a manifest.
    fn words(manifest: &str) -> Vec<String> {
        let boards = Board::of("p", &format!("[package]\n{manifest}")).unwrap();
        let words = boards.iter().map(|board| {
            let mut cargo = Command::new("cargo");
            board.select(&mut cargo);
            let words: Vec<_> = cargo.get_args().map(|word| word.to_string_lossy()).collect();
            format!("{}: {}", board.name, words.join(" "))
        });
        words.collect()
    }

    #[test]
    fn package_serves_each_chip_of_its_manifest() {
        let chips = "[package.metadata.board.a]\nflash_budget = 9\n[package.metadata.board.b]\n\
                     features = [\"b\"]\n[[bin]]\nname = \"p\"\n";
        let two = ["a: --package p", "b: --package p --no-default-features --features b"];
        assert_eq!(words(chips), two);
        assert_eq!(words("[[bin]]\nname = \"p\"\n"), ["p: --package p"]);
        assert!(words("").is_empty(), "a library is no board");
    }

    #[test]
    fn each_board_takes_its_own_memory_map() {
        let of = |board| Board::find(board).unwrap().memory_x();
        let below = |path: &str| root().join(path);
        assert_eq!(of(PRODUCT), below("memory.x"));
        assert_eq!(of("stm32g473"), below("boards/stm32g431/stm32g473/memory.x"));
        assert_eq!(of("stm32f411"), below("boards/stm32f411/memory.x"));
    }

    #[test]
    fn unknown_board_is_an_error_that_lists_the_known_ones() {
        let refused = Board::find("stm32h7").err().unwrap().to_string();
        assert!(
            refused.starts_with("no board `stm32h7`; there are: cycles, starter, "),
            "{refused}"
        );
    }
}
