//! Passes the linker its scripts: a sibling's own `memory.x`, or the product's in the repository's root.

use std::path::Path;

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let root = Path::new(&here).ancestors().nth(2).expect("the repository");
    let root = root.display().to_string();
    let [g431, common] = ["stm32g431", "common"].map(|folder| format!("{root}/boards/{folder}"));
    for place in [&here, &root, &g431, &common] {
        println!("cargo:rustc-link-search={place}");
    }
    println!("cargo:rustc-link-arg-bins=-Tccm.x");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    // defmt's own script keeps the code of the log, which an image without one never calls.
    println!("cargo:rerun-if-env-changed=DEFMT_LOG");
    let silent = std::env::var("DEFMT_LOG").is_ok_and(|level| level == "off");
    let log = if silent { "no-log.x" } else { "defmt.x" };
    println!("cargo:rustc-link-arg-bins=-T{log}");
    // lld pads segments to 64 KB pages by default; bare metal has no pages.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rerun-if-changed={root}/memory.x");
    println!("cargo:rerun-if-changed={g431}/ccm.x");
    println!("cargo:rerun-if-changed={common}/no-log.x");
    println!("cargo:rerun-if-changed={here}");
}
