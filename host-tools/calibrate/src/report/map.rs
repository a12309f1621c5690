//! Error over the pad: error of each quantity in the region around each taxel.

use serde::Serialize;
use taxel::scan::{COLS, ROWS};

use super::judge::Trial;
use super::series::{Row, Series};
use super::verdict::{Quantity, presses, within};
use crate::coverage::nearest;

/// Error of a quantity in the region of each taxel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorMap {
    /// Name of the quantity.
    pub quantity: String,
    /// Unit of the errors.
    pub unit: &'static str,
    /// Needs of the quantity's uses, from the least to the most demanding.
    pub needs: [f64; 3],
    /// Errors by row and column of the taxels; `None` where nothing pressed.
    pub cells: [[Option<Region>; COLS]; ROWS],
}

/// Error in the region of a taxel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Region {
    /// Error that 95 % of the loaded rows do not exceed, in the worst component.
    pub error: f64,
    /// Number of presses.
    pub presses: usize,
}

/// Maps of those of some quantities that have places, except single force sensors.
pub(crate) fn maps(quantities: &[Quantity], trials: &[Trial]) -> Vec<ErrorMap> {
    quantities.iter().filter_map(|quantity| map(quantity, trials)).collect()
}

fn map(quantity: &Quantity, trials: &[Trial]) -> Option<ErrorMap> {
    let is_pad = |series: &&Series| series.kind.group().0 < 2;
    let series = || trials.iter().flat_map(|trial| &trial.series).filter(is_pad);
    let region = |k: usize| {
        let here = |row: &Row| row.place.map(nearest) == Some(k);
        let (mut worst, mut counted) = (None, 0);
        for kind in &quantity.kinds {
            let of = || series().filter(|series| series.kind == *kind);
            let rows = of().flat_map(Series::loaded).filter(|(row, _)| here(row));
            let error = within(rows.filter_map(|(_, error)| error));
            worst = [worst, error].into_iter().flatten().reduce(f64::max);
            // Numbers of presses begin again in each recording.
            let each = of().map(|one| presses(one.loaded().filter(|(row, _)| here(row))));
            counted = counted.max(each.sum());
        }
        Some(Region { error: worst?, presses: counted })
    };
    let cells: [[Option<Region>; COLS]; ROWS] =
        std::array::from_fn(|row| std::array::from_fn(|column| region(row * COLS + column)));
    let known = cells.as_flattened().iter().any(Option::is_some);
    known.then(|| ErrorMap {
        quantity: quantity.name.clone(),
        unit: quantity.ladder.unit,
        needs: quantity.ladder.needs.map(|(need, _)| need),
        cells,
    })
}
