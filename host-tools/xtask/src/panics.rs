//! Calls of panicking functions in a firmware, and the source lines that make them.
//!
//! The core must have none. A crate that has any must be listed in [`KNOWN`] with the reason why
//! they never happen. `boards/panics.csv` holds how many lines of each crate may panic; one more
//! fails the build.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use addr2line::Loader;
use anyhow::{Context, Result, anyhow, bail};

use crate::image::Image;
use crate::run::root;

/// Prefixes of the names of panicking functions.
const PANICS: [&str; 9] = [
    "core::panicking::",
    "core::option::expect_failed",
    "core::option::unwrap_failed",
    "core::result::unwrap_failed",
    "core::slice::index::slice_",
    "core::str::slice_error_fail",
    "core::cell::panic_",
    "_defmt_panic",
    "__defmt_default_panic",
];

/// Panic that the compiler adds to every `async fn`; no executor polls a future that is done.
const RESUMED: &str = "core::panicking::panic_const::panic_const_async_fn_resumed";

/// Name of the core.
const CORE: &str = "taxel";
/// Name for the boards' own crates together.
const BOARDS: &str = "boards";

/// Crates with panics, and the reason why these never happen.
const KNOWN: [(&str, &str); 17] = [
    (BOARDS, "at start-up, and in the handlers of faults"),
    (
        "cobs",
        "on the core's path: its indices stay below the given length; both directions are fuzzed",
    ),
    (
        "embassy-sync",
        "on the core's path: its pipe is borrowed by one task, and indexed by remainders",
    ),
    ("embedded-io-async", "on the core's path: at a link that accepts no byte; every board's does"),
    ("defmt", "in its macros, at start-up"),
    ("defmt-rtt", "at a log inside a log, which no code writes"),
    ("embassy-executor", "at foreign tasks and wakers, of which there are none"),
    ("embassy-hal-internal", "at start-up"),
    ("embassy-stm32", "at start-up; in the USB driver, at impossible values of registers"),
    ("embassy-time", "at times beyond 2^64"),
    ("embassy-time-driver", "at times beyond 2^64"),
    ("embassy-usb", "at start-up, also for descriptors that do not fit"),
    ("embassy-usb-driver", "at invalid endpoint numbers, which start-up sets"),
    ("embassy-usb-synopsys-otg", "in the USB driver, at packets of a kind or size that USB lacks"),
    ("postcard", "on the core's path: the buffer of a varint is as long as the longest; fuzzed"),
    ("static_cell", "at start-up"),
    ("stm32-metapac", "at impossible values of register fields"),
];

/// True for a function that panics.
pub fn is_panic(name: &str) -> bool {
    PANICS.iter().any(|start| name.starts_with(start))
}

/// Returns the reason why a crate's panics never happen, if it is known.
pub fn why(owner: &str) -> Option<&'static str> {
    KNOWN.iter().find(|(known, _)| *known == owner).map(|(_, why)| *why)
}

/// Lines that may panic, by crate.
pub type Sites = BTreeMap<String, BTreeSet<String>>;

/// Table of the number of lines that may panic, by board and crate.
pub const LIST: &str = "boards/panics.csv";

/// Fails where a crate has more lines that may panic than `list` allows on `board`.
pub fn none_is_new(board: &str, sites: &Sites, list: &str) -> Result<()> {
    for (owner, lines) in sites {
        let row = format!("{board},{owner},");
        let known = list.lines().find_map(|line| line.strip_prefix(&row));
        let known = known.map_or(Ok(0), str::parse::<usize>);
        let known = known.with_context(|| format!("{LIST}: the row `{row}` needs a number"))?;
        if lines.len() > known {
            let lines: Vec<_> = lines.iter().map(String::as_str).collect();
            bail!(
                "{board}: {} lines of {owner} may panic, {known} of them known: find the new one \
                 and avoid it, or write `{row}{}` into {LIST}\n  {}",
                lines.len(),
                lines.len(),
                lines.join("\n  ")
            );
        }
    }
    Ok(())
}

/// Reads the table [`LIST`].
pub fn list() -> Result<String> {
    std::fs::read_to_string(root().join(LIST)).context(LIST)
}

/// Returns the lines that may panic; fails where one is the core's or an unknown crate's.
pub fn remaining(elf: &Path, image: &Image) -> Result<Sites> {
    let loader = Loader::new(elf).map_err(|error| anyhow!("{}: {error}", elf.display()))?;
    let mut panicking: BTreeSet<u32> = image
        .functions
        .iter()
        .filter(|(_, function)| is_panic(&function.name))
        .map(|(address, _)| *address)
        .collect();
    let mut all = Sites::new();
    // A panic inside a function of the standard library belongs to that function's callers.
    loop {
        let before = panicking.len();
        all.clear();
        for (address, function) in &image.functions {
            let calls = function.calls.iter().filter(|(_, callee)| panicking.contains(callee));
            for (site, callee) in calls.copied().collect::<Vec<_>>() {
                let callee = image.at(callee).map_or("", |callee| &callee.name);
                if panicking.contains(address) || callee == RESUMED {
                    continue;
                }
                let Some((owner, line)) = owner(&loader, site)? else {
                    panicking.insert(*address);
                    continue;
                };
                if why(&owner).is_none() {
                    bail!(
                        "{line} may panic ({callee} in {}): avoid it, or add the crate to panics.rs with \
                         the reason why it never does",
                        function.name
                    );
                }
                all.entry(owner).or_default().insert(line);
            }
        }
        if panicking.len() == before {
            return Ok(all);
        }
    }
}

/// Returns the crate and source line of the code at `site`.
///
/// Code inlined from the standard library belongs to its caller; `None` where there is no other.
/// Code that the compiler merged from several places has no line, and the file of whatever stands
/// before it: where that is the core, it belongs to what it is inlined in, and counts there.
fn owner(loader: &Loader, site: u32) -> Result<Option<(String, String)>> {
    let mut frames = loader.find_frames(u64::from(site)).map_err(|error| anyhow!("{error}"))?;
    let mut merged = None;
    while let Some(frame) = frames.next()? {
        if let Some(location) = frame.location
            && let Some(file) = location.file
            && let Some(name) = crate_of(file, &root())
        {
            let line = location.line.unwrap_or_default();
            if line == 0 && name == CORE {
                merged.get_or_insert(format!("{file}:{line}"));
                continue;
            }
            return Ok(Some((name, format!("{file}:{line}"))));
        }
    }
    Ok(merged.map(|line| (CORE.to_owned(), line)))
}

/// Returns the crate of a source file; `None` for the standard library.
fn crate_of(file: &str, root: &Path) -> Option<String> {
    if ["core", "alloc", "compiler-builtins"]
        .iter()
        .any(|part| file.contains(&format!("/library/{part}/")))
    {
        return None;
    }
    if let Some((_, rest)) = file.split_once("/registry/src/") {
        let folder = rest.split('/').nth(1)?;
        return Some(folder.rsplit_once('-').map_or(folder, |(name, _)| name).to_owned());
    }
    // Output of a crate's build script.
    if let Some((_, rest)) = file.split_once("/build/")
        && let Some((folder, _)) = rest.split_once("/out/")
    {
        return Some(folder.rsplit_once('-').map_or(folder, |(name, _)| name).to_owned());
    }
    let own = Path::new(file).strip_prefix(root).ok()?;
    let mut folders = own.components().map(|folder| folder.as_os_str().to_string_lossy());
    match folders.next()?.as_ref() {
        "src" => Some(CORE.to_owned()),
        _ => Some(BOARDS.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_panicking_line_is_an_error_that_lists_it() {
        let lines = ["a.rs:1", "a.rs:7"].map(str::to_owned).into();
        let sites = Sites::from([("embassy-usb".to_owned(), lines)]);
        let with =
            |known: &str| none_is_new("board", &sites, &format!("board,crate,lines\n{known}\n"));
        assert!(with("board,embassy-usb,2").is_ok() && with("board,embassy-usb,3").is_ok());
        for known in ["board,embassy-usb,1", "other,embassy-usb,2", ""] {
            let refused = with(known).unwrap_err().to_string();
            assert!(
                refused.contains("a.rs:7") && refused.contains("`board,embassy-usb,2`"),
                "{refused}"
            );
        }
        assert!(with("board,embassy-usb,many").is_err());
    }

    #[test]
    fn line_belongs_to_crate_of_its_file() {
        let of = |file| crate_of(file, Path::new("/checkout/taxel"));
        assert_eq!(of("/checkout/taxel/src/wire/deframer.rs").as_deref(), Some("taxel"));
        assert_eq!(of("/checkout/taxel/boards/common/src/link.rs").as_deref(), Some("boards"));
        let registry = "/registry/src/mirror-1949cf8c6b5b557f";
        let file = format!("{registry}/embassy-sync-0.8.0/src/pipe.rs");
        assert_eq!(of(&file).as_deref(), Some("embassy-sync"));
        let written =
            "/checkout/taxel/boards/target/release/build/embassy-stm32-8fb/out/_generated.rs";
        assert_eq!(of(written).as_deref(), Some("embassy-stm32"));
        assert_eq!(of("/rustc/59807616/library/core/src/cell.rs"), None);
        assert_eq!(of("/usr/lib/rustlib/src/rust/library/core/src/cell.rs"), None);
    }
}
