//! Builds the boards' firmware and checks its size, stack and panics.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;

use crate::image::Image;
use crate::memory::{Footprint, Use, footprint};
use crate::run::{answer, locked, program, root, run, setup};
use crate::{panics, stack, toolchain};

/// `[package.metadata.board]` of a board's manifest.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Board {
    /// True for a finger's firmware, which has a page and a stack limit.
    #[serde(default)]
    hardware: bool,
    /// Largest flash use in bytes.
    flash_budget: Option<u64>,
    ram_budget: Option<u64>,
}

impl Board {
    fn read(name: &str) -> Result<Self> {
        #[derive(Deserialize)]
        struct Manifest {
            package: Package,
        }
        #[derive(Deserialize)]
        struct Package {
            #[serde(default)]
            metadata: Metadata,
        }
        #[derive(Default, Deserialize)]
        struct Metadata {
            #[serde(default)]
            board: Board,
        }
        let path = root().join("boards").join(name).join("Cargo.toml");
        let text = std::fs::read_to_string(&path)
            .context("reading it")
            .and_then(|text| Ok(toml::from_str::<Manifest>(&text)?.package.metadata.board));
        text.with_context(|| path.display().to_string())
    }
}

/// Board that is the product.
pub const PRODUCT: &str = "stm32g431";
/// Image that measures the core's stages; no finger runs it.
const BENCH: &str = "cycles";

/// Lists the boards: the folders of `boards/` whose manifests name a program.
pub fn boards() -> Result<Vec<String>> {
    let entries = std::fs::read_dir(root().join("boards")).context("reading boards/")?;
    let mut boards: Vec<_> = entries
        .flatten()
        .filter(|entry| {
            let manifest = std::fs::read_to_string(entry.path().join("Cargo.toml"));
            manifest.is_ok_and(|manifest| manifest.contains("[[bin]]"))
        })
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    boards.sort();
    Ok(boards)
}

/// Lists the boards on which a finger runs.
pub fn hardware() -> Result<Vec<String>> {
    let mut fingers = Vec::new();
    for board in boards()? {
        if Board::read(&board)?.hardware {
            fingers.push(board);
        }
    }
    Ok(fingers)
}

/// Runs `cargo xtask firmware BOARD`.
pub fn task(board: &str) -> Result<()> {
    let boards = boards()?;
    if !boards.iter().any(|known| known == board) {
        bail!("no board `{board}`; there are: {}", boards.join(", "));
    }
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
    let mut cargo = toolchain::cargo("build");
    cargo.args(["--package", board]).args(locked()).env("TAXEL_BUILD", revision());
    cargo.env("DEFMT_LOG", log.unwrap_or("off"));
    run(&mut cargo)?;
    let built = toolchain::output(board);
    let footprint = footprint(&built, &memory_x(board))?;
    let suffix = log.map_or("", |_| "-log");
    let path = publish(&built, &directory().join(format!("{board}{suffix}.elf")))?;
    let Footprint { flash, ram, ccm, .. } = footprint;
    let ccm = ccm.map(|ccm| format!(", CCM {}", size(ccm))).unwrap_or_default();
    eprintln!("{board}: flash {}, RAM {} + stack{ccm}", size(flash), size(ram));
    let Board { hardware, flash_budget, ram_budget } = Board::read(board)?;
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

/// Path of the board's memory map: its own, else the product's in the root.
fn memory_x(board: &str) -> PathBuf {
    let own = root().join("boards").join(board).join("memory.x");
    if own.is_file() { own } else { root().join("memory.x") }
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
