//! Writes `data/limit-surface.csv`: error and cost of each form of the limit surface.
//!
//! Run `cargo xtask cycles --csv host-tools/emulator/data/cycles.csv`, then `cargo bench -p
//! taxel-calibrate --bench limit-surface`.

#[path = "../tests/it/judge/limit_surfaces.rs"]
mod limit_surfaces;

fn main() {
    let table = limit_surfaces::table();
    print!("{table}");
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/data/limit-surface.csv");
    std::fs::write(path, table).expect(path);
}
