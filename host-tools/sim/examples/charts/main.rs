//! Draws the simulator's charts, and writes the tables behind them, into a folder:
//! `cargo run --release -p taxel-sim --example charts -- docs/images`.

use std::path::{Path, PathBuf};

mod convergence;
mod ladder;
mod style;

type Done<T = ()> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Done {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        return Err("name the folder to write to, for example docs/images".into());
    };
    std::fs::create_dir_all(&folder)?;
    convergence::draw(&folder.join("convergence.svg"))?;
    let costs = taxel_sim::cost::measure()?;
    write(&folder.join("simulator.csv"), &taxel_sim::cost::csv(&costs))?;
    ladder::draw(&folder.join("simulator.svg"), &costs)
}

fn write(path: &Path, text: &str) -> Done {
    std::fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()).into())
}
