//! Passes the linker its script and this board's `memory.x`.
//!
//! The crate then needs no cargo configuration outside it. The linker searches its working
//! directory first, and cargo runs it in `boards/`: no `memory.x` may be there. The one in the
//! repository's root is the product's. `cargo xtask firmware` checks the result.

include!("../common/log_script.rs");

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let common = format!("{here}/../common");
    println!("cargo:rustc-link-search={here}");
    println!("cargo:rustc-link-search={common}");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    pass_log_script();
    // lld pads segments to 64 KB pages by default; bare metal has no pages.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rerun-if-changed={here}");
    println!("cargo:rerun-if-changed={common}");
}
