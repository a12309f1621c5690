//! Figures of a data sheet, out of a trace's truth and the frames that a finger makes of it.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};

/// Truth and estimates of a run, scan by scan.
pub struct Run {
    /// Seconds since the first scan.
    time_s: Vec<f64>,
    /// True normal force in newtons.
    truth_n: Vec<f64>,
    frames: HashMap<String, Vec<Option<f64>>>,
}

/// Columns of a CSV file with comments; an empty cell is `None`.
pub fn columns(path: &Path) -> Result<HashMap<String, Vec<Option<f64>>>> {
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .from_path(path)
        .with_context(|| path.display().to_string())?;
    let names = reader.headers()?.clone();
    let mut columns: Vec<Vec<Option<f64>>> = vec![Vec::new(); names.len()];
    for row in reader.records() {
        for (column, cell) in columns.iter_mut().zip(&row?) {
            column.push(cell.parse().ok());
        }
    }
    Ok(names.iter().map(str::to_owned).zip(columns).collect())
}

impl Run {
    /// Reads a trace with its truth, and the frames of its scans.
    pub fn read(trace: &Path, frames: &Path) -> Result<Self> {
        let truth = columns(trace)?;
        let frames = columns(frames)?;
        let whole = |columns: &HashMap<String, Vec<Option<f64>>>, name: &str| {
            let column = columns.get(name).with_context(|| format!("no column `{name}`"))?;
            column
                .iter()
                .copied()
                .collect::<Option<Vec<f64>>>()
                .with_context(|| format!("a gap in `{name}`"))
        };
        let (t_us, truth_n) = (whole(&truth, "t_us")?, whole(&truth, "fz_n")?);
        ensure!(t_us == whole(&frames, "t_us")?, "frames of other scans than the trace's");
        let start = t_us.first().context("an empty trace")?;
        let time_s = t_us.iter().map(|t| (t - start) / 1e6).collect();
        Ok(Self { time_s, truth_n, frames })
    }

    /// Values of a column between two times, each with its time.
    fn values(&self, column: &str, [from, to]: [f64; 2]) -> Result<Vec<(f64, f64)>> {
        let cells = self.frames.get(column).with_context(|| format!("no column `{column}`"))?;
        let rows = self.time_s.iter().zip(cells).filter(|(t, _)| (from..to).contains(*t));
        Ok(rows.filter_map(|(t, cell)| Some((*t, (*cell)?))).collect())
    }

    /// Standard deviation of a column about its trend between two times.
    pub fn sigma(&self, column: &str, window: [f64; 2]) -> Result<f64> {
        let values = self.values(column, window)?;
        ensure!(values.len() >= 100, "{} values of `{column}`", values.len());
        let [offset, slope] = line(&values);
        let squares = values.iter().map(|(t, v)| (v - offset - slope * t).powi(2)).sum::<f64>();
        Ok((squares / (values.len() - 2) as f64).sqrt())
    }

    /// Mean of the normal force between two times.
    pub fn force(&self, window: [f64; 2]) -> Result<f64> {
        let values = self.values("fz_n", window)?;
        ensure!(!values.is_empty(), "no force from {} s to {} s", window[0], window[1]);
        Ok(values.iter().map(|(_, v)| v).sum::<f64>() / values.len() as f64)
    }

    /// Largest difference of the normal force between a rise and a fall, at one true force.
    pub fn loop_width(&self, rise: [f64; 2], fall: [f64; 2], most_n: f64) -> Result<f64> {
        let near = |window: [f64; 2], force_n: f64| {
            let values = self.time_s.iter().zip(&self.truth_n).zip(&self.frames["fz_n"]);
            let values = values.filter(|((t, truth), _)| {
                (window[0]..window[1]).contains(*t) && (*truth - force_n).abs() < most_n / 200.0
            });
            let found: Vec<f64> = values.filter_map(|(_, value)| *value).collect();
            ensure!(!found.is_empty(), "no value near {force_n} N");
            Ok(found.iter().sum::<f64>() / found.len() as f64)
        };
        let mut widest = 0.0f64;
        for tenth in 1..10 {
            let force_n = most_n * f64::from(tenth) / 10.0;
            widest = widest.max((near(rise, force_n)? - near(fall, force_n)?).abs());
        }
        Ok(widest)
    }

    /// Seconds from the touch until the normal force stays within `share` of `end_n`.
    pub fn settles(&self, end_n: f64, share: f64, until_s: f64) -> Result<f64> {
        let touch = self.time_s.iter().zip(&self.truth_n).find(|(_, truth)| **truth > 0.0);
        let (touch, _) = touch.context("nothing touches")?;
        let off = self.values("fz_n", [*touch, until_s])?;
        let last = off.iter().rev().find(|(_, v)| (v - end_n).abs() > share * end_n);
        Ok(last.map_or(0.0, |(t, _)| t - touch))
    }

    /// Seconds in which the normal force rises from a tenth to nine tenths of `end_n`.
    pub fn rises(&self, end_n: f64, until_s: f64) -> Result<f64> {
        let values = self.values("fz_n", [0.0, until_s])?;
        let first = |share: f64| values.iter().find(|(_, v)| *v >= share * end_n);
        let ends = first(0.1).zip(first(0.9)).context("no rise to nine tenths")?;
        let rise_s = ends.1.0 - ends.0.0;
        ensure!(rise_s > 0.0, "a rise within one scan");
        Ok(rise_s)
    }

    /// True force of the first scan that is taken for a contact.
    pub fn threshold(&self) -> Result<f64> {
        let contact = self.frames.get("contact").context("no column `contact`")?;
        let mut scans = self.truth_n.iter().zip(contact);
        let first = scans.find(|(truth, contact)| **truth > 0.0 && **contact == Some(1.0));
        Ok(*first.context("no contact")?.0)
    }
}

/// Offset and slope of the line of least squares.
fn line(values: &[(f64, f64)]) -> [f64; 2] {
    let n = values.len() as f64;
    let (x, y) = values.iter().fold((0.0, 0.0), |(x, y), v| (x + v.0 / n, y + v.1 / n));
    let across: f64 = values.iter().map(|v| (v.0 - x).powi(2)).sum();
    let slope = values.iter().map(|v| (v.0 - x) * (v.1 - y)).sum::<f64>() / across;
    [y - slope * x, slope]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Run of a second at 1 kHz with this truth and these estimates.
    fn run(truth: fn(f64) -> f64, estimate: fn(usize, f64) -> Option<f64>) -> Run {
        let time_s: Vec<f64> = (0..1000).map(|i| f64::from(i) / 1000.0).collect();
        let truth_n: Vec<f64> = time_s.iter().map(|t| truth(*t)).collect();
        let force: Vec<_> = truth_n.iter().enumerate().map(|(i, n)| estimate(i, *n)).collect();
        let contact = force.iter().map(|f| Some(f64::from(u8::from(f.is_some_and(|f| f > 0.1)))));
        let frames = [("contact".to_owned(), contact.collect()), ("fz_n".to_owned(), force)];
        Run { time_s, truth_n, frames: frames.into() }
    }

    #[test]
    fn noise_is_told_from_a_trend() {
        let run = run(|t| 3.0 * t, |i, n| Some(n + if i % 2 == 0 { 0.01 } else { -0.01 }));
        let sigma = run.sigma("fz_n", [0.0, 1.0]).unwrap();
        assert!((sigma - 0.01).abs() < 1e-4, "{sigma}");
        assert!(run.sigma("fz_n", [0.0, 0.01]).is_err());
    }

    #[test]
    fn loop_is_as_wide_as_the_fall_is_late() {
        let truth = |t: f64| if t < 0.5 { 4.0 * t } else { 4.0 * (1.0 - t) };
        let run = run(truth, |i, n| Some(if i < 500 { n } else { n + 0.05 }));
        let width = run.loop_width([0.0, 0.5], [0.5, 1.0], 2.0).unwrap();
        assert!((width - 0.05).abs() < 5e-3, "{width}");
    }

    #[test]
    fn step_settles_and_a_light_touch_is_missed() {
        let run = run(
            |t| if t < 0.2 { 0.0 } else { (t - 0.2).min(0.5) },
            |_, n| Some(if n > 0.3 { 0.5 } else { n }),
        );
        let settled = run.settles(0.5, 0.05, 1.0).unwrap();
        assert!((settled - 0.3).abs() < 5e-3, "{settled}");
        // From 0.05 N at 0.25 s to 0.45 N, which the estimate passes when the truth passes 0.3 N.
        let rise = run.rises(0.5, 1.0).unwrap();
        assert!((rise - 0.25).abs() < 5e-3, "{rise}");
        let threshold = run.threshold().unwrap();
        assert!((threshold - 0.1).abs() < 5e-3, "{threshold}");
        assert!((run.force([0.8, 1.0]).unwrap() - 0.5).abs() < 1e-9);
        assert_eq!(line(&[(0.0, 1.0), (2.0, 5.0)]), [1.0, 2.0]);
    }
}
