//! Passes the linker its scripts: a sibling's own `memory.x`, or the product's in the repository's
//! root.

use std::path::Path;

include!("../common/log_script.rs");

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
    pass_log_script();
    // lld pads segments to 64 KB pages by default; bare metal has no pages.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rerun-if-changed={root}/memory.x");
    println!("cargo:rerun-if-changed={g431}/ccm.x");
    println!("cargo:rerun-if-changed={common}");
    println!("cargo:rerun-if-changed={here}");
}
