//! The simulator's own charts: error against time of a frame, and convergence.

use std::path::Path;

use taxel_files::save;

use crate::{convergence, ladder, page};

/// Times every rung of the ladder of fidelity and writes `simulator.csv`, its picture and page, and
/// `convergence.svg`; it takes half a minute.
///
/// # Errors
/// A file cannot be written.
pub fn write(folder: &Path) -> anyhow::Result<()> {
    let costs = taxel_sim::cost::measure()?;
    save(folder.join("simulator.csv"), taxel_sim::cost::csv(&costs))?;
    save(folder.join("simulator.svg"), ladder::draw(&costs)?)?;
    save(folder.join("simulator.html"), page::simulator(&costs))?;
    save(folder.join("convergence.svg"), convergence::draw()?)?;
    Ok(())
}
