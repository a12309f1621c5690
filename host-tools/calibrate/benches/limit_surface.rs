//! `cargo bench -p taxel-calibrate --bench limit-surface`: writes `data/limit-surface.csv`, what the forms of the
//! limit surface leave and cost; after `cargo xtask cycles --csv host-tools/emulator/data/cycles.csv`.

#[path = "../tests/it/judge/limit_surfaces.rs"]
mod limit_surfaces;

fn main() {
    let table = limit_surfaces::table();
    print!("{table}");
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/data/limit-surface.csv");
    std::fs::write(path, table).expect(path);
}
