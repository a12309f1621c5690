//! Schematic of the STM32G431 board as a KiCad file.

pub mod board;
mod chips;
pub mod footprint;
mod library;
#[cfg(test)]
mod netlist;
mod periphery;
mod sheet;
#[cfg(test)]
mod tests;

/// Returns the library of the schematic's symbols.
#[must_use]
pub fn library() -> String {
    let symbols: String = library::symbols().iter().map(|symbol| symbol.text("")).collect();
    format!("(kicad_symbol_lib (version 20211014) (generator kicad_symbol_editor)\n{symbols})\n")
}
