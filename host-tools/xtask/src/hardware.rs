//! `cargo xtask hardware`: what is generated from the reference finger for building one.
//!
//! Needs ngspice, which simulates the columns' circuit for docs/front-end.md.

mod chart;
mod deck;
mod front_end;
mod measure;
mod mesh;
pub mod mould;
pub mod mount;
mod page;
mod schematic;
mod spice;

use anyhow::{Context, Result, bail};

use crate::marks;
use crate::run::root;

/// Folder of the files that a board is built from.
const BOARD: &str = "boards/stm32g431/hardware";

/// Files that are written whole: path and bytes.
fn files() -> Vec<(String, Vec<u8>)> {
    let of = |name: &str, text: String| (format!("{BOARD}/{name}"), text.into_bytes());
    let table = "(sym_lib_table\n  (lib (name \"taxel\")(type \"KiCad\")(uri \"${KIPRJMOD}/taxel.kicad_sym\")\
                 (options \"\")(descr \"symbols of this schematic\"))\n)\n";
    let footprints =
        table.replace("sym_lib_table", "fp_lib_table").replace(".kicad_sym", ".pretty");
    let footprints = footprints.replace("symbols", "footprints");
    let (_, footprint) = schematic::footprint::NAME.split_once(':').unwrap_or_default();
    let project = "{\n  \"meta\": { \"filename\": \"taxel.kicad_pro\", \"version\": 1 }\n}\n";
    let mut files = vec![
        of("taxel.kicad_sch", schematic::board::file()),
        of("taxel.kicad_sym", schematic::library()),
        of("sym-lib-table", table.to_owned()),
        of("fp-lib-table", footprints),
        of(&format!("taxel.pretty/{footprint}.kicad_mod"), schematic::footprint::file()),
        of("taxel.kicad_pro", project.to_owned()),
        ("docs/images/mould.svg".to_owned(), mould::picture().into_bytes()),
        ("docs/images/mount.svg".to_owned(), mount::drawing().into_bytes()),
        ("docs/mould/mount.stl".to_owned(), mount::stl()),
    ];
    files.extend(
        mould::files().into_iter().map(|(name, bytes)| (format!("docs/mould/{name}"), bytes)),
    );
    files
}

/// Writes the files; with `check`, fails if one differs and writes nothing.
pub fn task(check: bool) -> Result<()> {
    whole(check)?;
    front_end(check)
}

/// Writes or checks the files that are written whole.
fn whole(check: bool) -> Result<()> {
    for (path, bytes) in files() {
        let path = root().join(path);
        if marks::whole(&path, &bytes, check)? && check {
            bail!("{} differs; run `cargo xtask hardware`", path.display());
        }
    }
    Ok(())
}

/// Simulates the columns' circuit and writes or checks the tables of its page.
fn front_end(check: bool) -> Result<()> {
    let candidates = front_end::candidates()?;
    let parts = [front_end::reference()?, front_end::table(&candidates)];
    let page = root().join("docs/front-end.md");
    let mut text = std::fs::read_to_string(&page)?;
    for part in &parts {
        if check {
            page::check(&text, part).context("docs/front-end.md")?;
        } else {
            text = page::fill(&text, part).context("docs/front-end.md")?;
        }
    }
    if !check {
        std::fs::write(&page, text)?;
        std::fs::write(root().join("docs/images/front-end.svg"), front_end::chart(&candidates))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #[test]
    fn files_are_those_of_the_reference_finger() {
        super::whole(true).unwrap();
    }
}
