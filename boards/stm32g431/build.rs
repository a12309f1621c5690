//! Passes the linker its scripts: a sibling's own `memory.x`, or the product's in the repository's root.

use std::path::Path;

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let root = Path::new(&here).ancestors().nth(2).expect("the repository");
    let root = root.display().to_string();
    for place in [&here, &root, &format!("{root}/boards/stm32g431")] {
        println!("cargo:rustc-link-search={place}");
    }
    println!("cargo:rustc-link-arg-bins=-Tccm.x");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    // lld pads segments to 64 KB pages by default; bare metal has no pages.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rerun-if-changed={root}/memory.x");
    println!("cargo:rerun-if-changed={root}/boards/stm32g431/ccm.x");
    println!("cargo:rerun-if-changed={here}");
}
