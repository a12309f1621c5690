//! Passes the linker its scripts: the STM32G473's own `memory.x`, or the product's in the
//! repository's root.

use std::path::Path;

include!("../common/log_script.rs");

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let root = Path::new(&here).ancestors().nth(2).expect("the repository");
    let root = root.display().to_string();
    let common = format!("{root}/boards/common");
    let g473 = std::env::var_os("CARGO_FEATURE_STM32G473").is_some();
    let (board, memory) = match g473 {
        true => ("stm32g473", format!("{here}/stm32g473")),
        false => ("stm32g431", root),
    };
    println!("cargo:rustc-env=BOARD={board}");
    for place in [&memory, &here, &common] {
        println!("cargo:rustc-link-search={place}");
    }
    println!("cargo:rustc-link-arg-bins=-Tccm.x");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    pass_log_script();
    // lld pads segments to 64 KB pages by default; bare metal has no pages.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rerun-if-changed={memory}/memory.x");
    println!("cargo:rerun-if-changed={common}");
    println!("cargo:rerun-if-changed={here}");
}
