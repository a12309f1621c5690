//! The simulator's own charts: error against time of a frame, and convergence.

use std::path::Path;

use crate::{convergence, files, ladder, page};

/// Times every rung of the ladder of fidelity and writes `simulator.csv`, its picture and page, and
/// `convergence.svg`; it takes half a minute.
///
/// # Errors
/// A file cannot be written.
pub fn write(folder: &Path) -> anyhow::Result<()> {
    let costs = taxel_sim::cost::measure()?;
    files::write(&folder.join("simulator.csv"), &taxel_sim::cost::csv(&costs))?;
    files::write(&folder.join("simulator.svg"), &ladder::draw(&costs)?)?;
    files::write(&folder.join("simulator.html"), &page::simulator(&costs))?;
    files::write(&folder.join("convergence.svg"), &convergence::draw()?)
}
