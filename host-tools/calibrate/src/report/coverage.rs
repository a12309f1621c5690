//! Coverage of the measuring range: maps of the recordings over two reference columns.

use serde::Serialize;

use super::series::{Kind, Series, extent};

/// Number of cells along each side of a map.
pub(crate) const CELLS: usize = 16;

/// Number of rows in each cell of a map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// Reference column of the horizontal axis.
    pub x: String,
    /// Reference column of the vertical axis.
    pub y: String,
    /// Unit of both columns.
    pub unit: &'static str,
    /// Lower and upper end of the map, x.
    pub x_range: [f64; 2],
    /// Lower and upper end of the map, y.
    pub y_range: [f64; 2],
    /// Number of rows in each cell, row by row from the lowest y.
    pub rows: Vec<Vec<usize>>,
    /// Percent of the judged rows that lie more than two cells from any fitted row.
    ///
    /// None if the recordings of the fit are not known.
    pub beyond_percent: Option<f64>,
}

/// Pairs of columns with a map.
const MAPS: [(Kind, Kind); 3] = [
    (Kind::Point(0), Kind::Point(1)),
    (Kind::Force(0), Kind::Force(1)),
    (Kind::Force(0), Kind::Force(2)),
];

/// Maps of a finger.
pub(crate) fn maps(fitted: &[Vec<Series>], judged: &[Vec<Series>]) -> Vec<Coverage> {
    over(&MAPS, fitted, judged)
}

/// Maps of the fitted recordings, or of the judged ones if the former are unknown.
pub(crate) fn over(
    pairs: &[(Kind, Kind)],
    fitted: &[Vec<Series>],
    judged: &[Vec<Series>],
) -> Vec<Coverage> {
    pairs
        .iter()
        .filter_map(|(x, y)| {
            let judged = points(judged, x, y);
            let fitted = points(fitted, x, y);
            let all = || fitted.iter().chain(&judged);
            let x_range = range(all().map(|p| p[0]))?;
            let y_range = range(all().map(|p| p[1]))?;
            let known = !fitted.is_empty();
            let rows = count(if known { &fitted } else { &judged }, x_range, y_range);
            let beyond = judged
                .iter()
                .filter(|p| !near(&rows, cell(p[0], x_range), cell(p[1], y_range)))
                .count();
            let beyond_percent =
                (known && !judged.is_empty()).then(|| 100.0 * beyond as f64 / judged.len() as f64);
            let (x, y, unit) = (x.name(), y.name(), x.unit());
            Some(Coverage { x, y, unit, x_range, y_range, rows, beyond_percent })
        })
        .collect()
}

fn points(recordings: &[Vec<Series>], x: &Kind, y: &Kind) -> Vec<[f64; 2]> {
    let find = |all: &[Series], kind: &Kind| all.iter().find(|s| s.kind == *kind).cloned();
    recordings
        .iter()
        .filter_map(|all| Some((find(all, x)?, find(all, y)?)))
        .filter(|(x, y)| x.reference.len() == y.reference.len())
        .flat_map(|(x, y)| x.reference.into_iter().zip(y.reference).collect::<Vec<_>>())
        .map(|(x, y)| [x, y])
        .collect()
}

/// Smallest and largest value; `None` without an extent.
fn range(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let (low, high) = extent(values);
    (low < high).then_some([low, high])
}

fn cell(value: f64, [low, high]: [f64; 2]) -> usize {
    (((value - low) / (high - low) * CELLS as f64) as usize).min(CELLS - 1)
}

/// Whether a cell or one within two cells of it has a row.
///
/// Space between presses is no extrapolation.
fn near(rows: &[Vec<usize>], x: usize, y: usize) -> bool {
    const NEAR: usize = 2;
    let about = |i: usize| i.saturating_sub(NEAR)..(i + NEAR + 1).min(CELLS);
    rows[about(y)].iter().any(|row| row[about(x)].iter().any(|n| *n > 0))
}

fn count(points: &[[f64; 2]], x_range: [f64; 2], y_range: [f64; 2]) -> Vec<Vec<usize>> {
    let mut rows = vec![vec![0; CELLS]; CELLS];
    for [x, y] in points {
        rows[cell(*y, y_range)][cell(*x, x_range)] += 1;
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recording(points: &[(f64, f64)]) -> Vec<Series> {
        let series = |axis: usize, of: fn(&(f64, f64)) -> f64| Series {
            time: vec![0.0; points.len()],
            reference: points.iter().map(of).collect(),
            estimate: vec![None; points.len()],
            ..Series::empty(Kind::Point(axis))
        };
        vec![series(0, |p| p.0), series(1, |p| p.1)]
    }

    #[test]
    fn coverage_counts_rows_beyond_the_fit() {
        let fitted = recording(&[(-4.0, -4.0), (0.0, 0.0), (0.1, 0.1)]);
        let judged = recording(&[(0.0, 0.1), (4.0, 4.0), (4.0, -4.0), (-4.0, -4.0)]);
        let maps = maps(&[fitted], &[judged]);
        let [map] = &maps[..] else { panic!("{maps:?}") };
        assert_eq!(map.beyond_percent, Some(50.0));
        assert_eq!(map.rows.iter().flatten().sum::<usize>(), 3, "of what was fitted to");
        assert_eq!(map.rows[0][0], 1);
    }

    #[test]
    fn coverage_includes_rows_between_presses() {
        let fitted = recording(&[(-4.0, -4.0), (0.0, 0.0), (1.0, 1.0), (4.0, 4.0)]);
        let judged = recording(&[(0.5, 0.5), (1.5, 0.0), (0.0, 1.5)]);
        assert_eq!(maps(&[fitted], &[judged])[0].beyond_percent, Some(0.0));
    }

    #[test]
    fn constant_reference_gives_no_map() {
        assert!(maps(&[], &[recording(&[(1.0, 2.0), (1.0, 3.0)])]).is_empty());
    }
}
