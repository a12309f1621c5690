//! Hands the linker its script and this board's `memory.x`, so that no cargo configuration outside the
//! crate is needed.
//!
//! The linker looks into its working directory first, and cargo runs it in `boards/`: no `memory.x` may
//! lie there. The repository's root one is the product's; `cargo xtask firmware` checks what came out.

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    println!("cargo:rustc-link-search={here}");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    // lld pads segments to 64 KB pages by default; bare metal has no pages.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=build.rs");
}
