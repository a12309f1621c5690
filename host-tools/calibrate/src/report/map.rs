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
    /// Whether only rows at rest count, because a clock may hide a lag.
    pub at_rest: bool,
    /// Errors by row and column of the taxels; `None` where nothing pressed.
    pub cells: [[Option<Region>; COLS]; ROWS],
}

/// Error in the region of a taxel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Region {
    /// Error that 95 % of the loaded rows do not exceed, in the worst component.
    ///
    /// `None` if a component has no value in any of them.
    pub error: Option<f64>,
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
        let (mut worst, mut counted, mut valued) = (None, 0, true);
        for kind in &quantity.kinds {
            let of = || series().filter(|series| series.kind == *kind);
            let rows = of().flat_map(Series::judged).filter(|(row, _)| here(row));
            let error = within(rows.filter_map(|(_, error)| error));
            worst = [worst, error].into_iter().flatten().reduce(f64::max);
            // Numbers of presses begin again in each recording.
            let each = of().map(|one| presses(one.judged().filter(|(row, _)| here(row))));
            let pressed: usize = each.sum();
            counted = counted.max(pressed);
            valued &= pressed == 0 || error.is_some();
        }
        (counted > 0).then(|| Region { error: worst.filter(|_| valued), presses: counted })
    };
    let cells: [[Option<Region>; COLS]; ROWS] =
        std::array::from_fn(|row| std::array::from_fn(|column| region(row * COLS + column)));
    let known = cells.as_flattened().iter().any(Option::is_some);
    known.then(|| ErrorMap {
        quantity: quantity.name.clone(),
        unit: quantity.ladder.unit,
        needs: quantity.ladder.needs.map(|(need, _)| need),
        at_rest: series().any(|one| quantity.kinds.contains(&one.kind) && one.hides_lag()),
        cells,
    })
}

impl ErrorMap {
    /// Regions that were pressed and have no value, with their presses; empty if none has a value.
    pub(crate) fn without_value(&self) -> Vec<String> {
        let regions = || self.cells.as_flattened().iter().enumerate();
        if !regions().any(|(_, cell)| cell.is_some_and(|region| region.error.is_some())) {
            return Vec::new();
        }
        let silent = regions().filter_map(|(k, cell)| {
            let region = cell.filter(|region| region.error.is_none())?;
            Some(format!("r{}c{} ({})", k / COLS, k % COLS, counted(region.presses)))
        });
        silent.collect()
    }
}

/// Number of presses in words.
pub(crate) fn counted(presses: usize) -> String {
    format!("{presses} press{}", if presses == 1 { "" } else { "es" })
}

#[cfg(test)]
mod tests {
    use super::super::series::Kind;
    use super::super::verdict::{HeldOut, of_finger, verdict};
    use super::*;

    #[test]
    fn pressed_region_without_value_is_named() {
        let mut series = Series::empty(Kind::Force(2));
        for row in 0..200 {
            let (press, corner) = (row / 10, row < 30);
            let place = if corner { [-3.75; 2] } else { [1.25; 2] };
            series.time.push(row as f64);
            series.reference.push(1.0);
            series.estimate.push((!corner).then_some(1.0));
            series.sigma.push(None);
            let row = Row { press: Some(press), place: Some(place), ..Row::default() };
            series.rows.push(row);
        }
        let trials = [Trial::new("a.csv".into(), 9.0, 200, vec![series])];
        let maps = maps(&of_finger(), &trials);
        assert_eq!(maps[0].cells[0][0], Some(Region { error: None, presses: 3 }));
        assert_eq!(maps[0].cells[3][3], None);
        let mut verdict = verdict(&of_finger(), &trials, &[], HeldOut::Yes);
        verdict.add_regions(&maps);
        let told = "normal force: no value in r0c0 (3 presses)".to_owned();
        assert!(verdict.not_for.contains(&told), "{verdict:?}");
    }
}
