//! Folds of cross-validation: related rows are left out together.

/// Number of stretches into which a recording is cut.
const STRETCHES: usize = 10;
/// Least range of a target, as a share of the largest, for recordings of one kind.
const SAME_KIND: f64 = 0.5;

/// Kind of folds left out to choose a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeftOut {
    /// Whole recordings, one after the other.
    Recordings,
    /// Stretches of the recordings, cut where the load is least.
    Stretches,
}

/// Assigns each row its stretch; targets are row by row in the order of time.
///
/// With three recordings or more of one kind, each is a stretch. Otherwise each recording is cut
/// into tenths, because neither two recordings nor recordings of different loads can be left out
/// whole.
pub(crate) fn stretches(recordings: &[&[Vec<f64>]]) -> (LeftOut, Vec<usize>) {
    let own: Vec<usize> = recordings
        .iter()
        .enumerate()
        .flat_map(|(number, rows)| std::iter::repeat_n(number, rows.len()))
        .collect();
    if whole(recordings) {
        return (LeftOut::Recordings, own);
    }
    let mut stretches = Vec::with_capacity(own.len());
    for rows in recordings {
        let first = stretches.last().map_or(0, |last| last + 1);
        stretches.extend(tenths(rows).into_iter().map(|stretch| first + stretch));
    }
    (LeftOut::Stretches, stretches)
}

/// Whether whole recordings can be left out: there are three or more, and of one kind.
pub(crate) fn whole(recordings: &[&[Vec<f64>]]) -> bool {
    recordings.len() > 2 && of_one_kind(recordings)
}

fn of_one_kind(recordings: &[&[Vec<f64>]]) -> bool {
    let targets = recordings.iter().flat_map(|r| r.first()).map(Vec::len).max().unwrap_or(0);
    (0..targets).all(|k| {
        let spans: Vec<f64> = recordings.iter().map(|rows| span(rows, k)).collect();
        let most = spans.iter().copied().fold(0.0, f64::max);
        spans.iter().all(|span| *span >= SAME_KIND * most)
    })
}

fn span(rows: &[Vec<f64>], k: usize) -> f64 {
    let values = || rows.iter().map(|row| row[k]);
    values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
}

/// Cuts a recording into ten stretches of about one length.
///
/// Each cut is at the least load within a quarter of a stretch, so that presses stay whole.
fn tenths(rows: &[Vec<f64>]) -> Vec<usize> {
    let targets = rows.first().map_or(0, Vec::len);
    let spans: Vec<f64> = (0..targets).map(|k| span(rows, k).max(f64::MIN_POSITIVE)).collect();
    let load = |row: usize| rows[row].iter().zip(&spans).map(|(y, s)| y.abs() / s).sum::<f64>();
    let length = rows.len() / STRETCHES;
    let cuts: Vec<usize> = (1..STRETCHES)
        .map(|i| {
            let middle = i * rows.len() / STRETCHES;
            let near = middle - length / 4..=middle + length / 4;
            near.filter(|row| *row < rows.len())
                .min_by(|a, b| load(*a).total_cmp(&load(*b)))
                .unwrap_or(middle)
        })
        .collect();
    (0..rows.len()).map(|row| cuts.iter().filter(|cut| **cut <= row).count()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn presses(peak: f64) -> Vec<Vec<f64>> {
        (0..1000)
            .map(|i| vec![peak * (std::f64::consts::PI * f64::from(i) / 97.0).sin().abs()])
            .collect()
    }

    #[test]
    fn stretches_never_split_a_press() {
        let (rows, other) = (presses(3.0), presses(1.0));
        let (left_out, stretch) = stretches(&[&rows, &other]);
        assert_eq!(left_out, LeftOut::Stretches);
        assert_eq!((stretch[0], *stretch.last().unwrap()), (0, 19));
        for row in 1..1000 {
            if stretch[row] != stretch[row - 1] {
                assert!(rows[row][0] < 0.2, "cut at {row}: {}", rows[row][0]);
            }
        }
    }

    #[test]
    fn whole_recordings_are_folds_if_three_of_one_kind() {
        let (rows, weak) = (presses(3.0), presses(0.5));
        assert_eq!(stretches(&[&rows, &rows, &rows]).0, LeftOut::Recordings);
        assert_eq!(stretches(&[&rows, &rows, &weak]).0, LeftOut::Stretches);
    }
}
