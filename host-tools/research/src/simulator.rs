//! Charts of the simulator: error over computing time of a frame, and convergence.

use std::path::Path;

use taxel_files::save;

use crate::picture::save_page;
use crate::{convergence, ladder};

/// Times every fidelity level and writes `simulator.csv`, its picture and page, and
/// `convergence.svg`.
///
/// Takes half a minute.
///
/// # Errors
/// A file cannot be written.
pub fn write(folder: &Path) -> anyhow::Result<()> {
    let costs = taxel_sim::cost::measure()?;
    save(folder.join("simulator.csv"), taxel_sim::cost::csv(&costs))?;
    let picture = ladder::draw(&costs)?;
    picture.save(folder.join("simulator.svg"))?;
    let lead = "Worst error of a facet, a share of the largest displacement, over the time of a frame in contact.";
    save_page(folder.join("simulator.html"), "What the simulator's rungs cost", lead, &[&picture])?;
    convergence::draw()?.save(folder.join("convergence.svg"))
}
