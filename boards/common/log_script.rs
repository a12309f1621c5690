/// Passes the linker the script of the log, for a board's build script.
///
/// defmt's own script keeps the code of the log, which an image without one never calls.
fn pass_log_script() {
    println!("cargo:rerun-if-env-changed=DEFMT_LOG");
    let silent = std::env::var("DEFMT_LOG").is_ok_and(|level| level == "off");
    let log = if silent { "no-log.x" } else { "defmt.x" };
    println!("cargo:rustc-link-arg-bins=-T{log}");
}
