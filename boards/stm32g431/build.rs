//! Passes the linker its scripts and the product's `memory.x`, which is in the repository's root.

use std::path::Path;

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let root = Path::new(&here).ancestors().nth(2).expect("the repository").display();
    println!("cargo:rustc-link-search={root}");
    println!("cargo:rustc-link-search={here}");
    println!("cargo:rustc-link-arg-bins=-Tccm.x");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    // lld pads segments to 64 KB pages by default; bare metal has no pages.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rerun-if-changed={root}/memory.x");
    println!("cargo:rerun-if-changed=ccm.x");
    println!("cargo:rerun-if-changed=build.rs");
}
