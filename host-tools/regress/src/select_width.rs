//! Choice of a net's width by leaving out one recording after the other.

use std::sync::atomic::AtomicBool;

use crate::error::FitError;
use crate::folds::{self, LeftOut};
use crate::metrics::surely_less;
use crate::network::{self, Build, Net, NetOptions, Progress};
use crate::scaling::{Inputs, Scaling, thinned};
use crate::training::{Chosen, Recorded, Training, Tried};

/// Widths tried in addition to the usual one.
const WIDTHS: [usize; 2] = [4, 8];
/// Rows of each recording, and most steps, of a trial net.
///
/// They suffice to compare widths, at about a third of the cost of the fit itself.
const ROWS: usize = 512;
const STEPS: usize = 60;

/// A width with its mean square error on each held-out recording, relative to the targets' spread.
struct Judged {
    tried: Tried,
    squares: Vec<f64>,
}

/// Chooses the usual width, or another that is surely better.
///
/// `None` with fewer than three recordings of one kind.
///
/// # Errors
///
/// Stopped, or data that the recordings lack.
pub(crate) fn choose(
    training: &Training<'_>,
    skip: bool,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Option<Chosen>, FitError> {
    let targets: Vec<&[Vec<f64>]> = training.recordings.iter().map(|r| r.1.as_slice()).collect();
    if !folds::whole(&targets) {
        return Ok(None);
    }
    let few = |rows: &[Vec<f64>]| thinned(rows, ROWS).cloned().collect::<Vec<_>>();
    let recordings: Vec<Recorded> =
        training.recordings.iter().map(|(x, y)| (few(x), few(y))).collect();
    let mut widths: Vec<usize> = WIDTHS.into_iter().chain([training.usual]).collect();
    widths.retain(|width| *width <= training.most);
    widths.sort_unstable();
    widths.dedup();
    let mut judged: Vec<Judged> = Vec::new();
    for hidden in widths {
        match judge(training, &recordings, Build { hidden, skip }, progress, stop) {
            // Skip a net with too many parameters for the other recordings.
            Err(FitError::TooFewRows { .. }) => {}
            found => judged.push(found?),
        }
    }
    let mean = |judged: &&Judged| judged.squares.iter().sum::<f64>();
    let best = judged.iter().min_by(|a, b| mean(a).total_cmp(&mean(b)));
    let usual = judged.iter().find(|judged| judged.tried.hidden == training.usual);
    let Some(best) = usual
        .filter(|usual| !best.is_some_and(|best| surely_less(&best.squares, &usual.squares)))
        .or(best)
    else {
        return Ok(None);
    };
    Ok(Some(Chosen {
        left_out: LeftOut::Recordings,
        line: Vec::new(),
        bent: Vec::new(),
        apart: Vec::new(),
        skin: Vec::new(),
        hidden: best.tried.hidden,
        widths: judged.iter().map(|judged| judged.tried.clone()).collect(),
    }))
}

fn judge(
    training: &Training<'_>,
    recordings: &[Recorded],
    build: Build,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Judged, FitError> {
    let all: Vec<&[f64]> = recordings.iter().flat_map(|r| &r.1).map(Vec::as_slice).collect();
    let spreads = Scaling::of(&all, &all, Inputs::Unlike).targets;
    let options =
        NetOptions { starts: 1, steps: training.options.steps.min(STEPS), ..training.options };
    let (mut squares, mut error) = (Vec::new(), vec![0.0; spreads.len()]);
    for (r, left_out) in recordings.iter().enumerate() {
        let others = recordings.iter().enumerate().filter(|(i, _)| *i != r).map(|(_, r)| r.clone());
        let (x, y): (Vec<_>, Vec<_>) = others.unzip();
        let part =
            format!("{}: {} units, recording {} left out", training.part, build.hidden, r + 1);
        let rows = (&*x.concat(), &*y.concat());
        let net = network::fit(&part, rows, build, (training.inputs, options), progress, stop)?;
        let missed = mean_squares(&net, left_out);
        let shares = missed.iter().zip(&spreads).map(|(square, s)| square / s.spread.powi(2));
        squares.push(shares.sum::<f64>() / spreads.len() as f64);
        error.iter_mut().zip(missed).for_each(|(sum, square)| *sum += square);
    }
    error.iter_mut().for_each(|sum| *sum = (*sum / recordings.len() as f64).sqrt());
    Ok(Judged { tried: Tried { hidden: build.hidden, error }, squares })
}

/// Mean square error of each target over the rows of a recording.
fn mean_squares(net: &Net, (x, y): &Recorded) -> Vec<f64> {
    let mut squares = vec![0.0; net.output_bias.len()];
    for (x, y) in x.iter().zip(y) {
        let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
        for ((sum, found), wanted) in squares.iter_mut().zip(net.outputs(&x)).zip(y) {
            *sum += (f64::from(found) - wanted).powi(2);
        }
    }
    squares.iter().map(|sum| sum / x.len().max(1) as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Family;

    /// Two channels and a force nonlinear in one of them; every mounting has its own slope.
    fn recording(number: usize, rows: usize) -> Recorded {
        let x: Vec<Vec<f64>> = (0..rows)
            .map(|row| (row + 1000 * number) as f64 * 0.37)
            .map(|t| vec![2.0 * (0.9 * t).sin(), 2.0 * (1.7 * t).cos()])
            .collect();
        let slope = 1.0 + 0.05 * (number as f64).sin();
        let y = x.iter().map(|x| vec![slope * x[0] + (2.0 * x[1]).sin()]).collect();
        (x, y)
    }

    fn fit_to(
        count: usize,
        rows: usize,
        hidden: Option<usize>,
    ) -> (Net, Option<Chosen>, Option<String>) {
        let recordings: Vec<Recorded> = (0..count).map(|number| recording(number, rows)).collect();
        let training = Training {
            part: "net",
            targets: &["f_n".to_owned()],
            family: Family::Mlp,
            recordings: &recordings,
            inputs: Inputs::Alike,
            hidden,
            usual: 16,
            most: 32,
            options: NetOptions { seed: 1, starts: 1, steps: 40 },
            teacher: None,
        };
        let (net, chosen) = training.run(&mut |_| {}, &AtomicBool::new(false)).unwrap();
        let told = training.told(chosen.as_ref());
        (net, chosen, told)
    }

    #[test]
    fn underdetermined_width_is_not_chosen() {
        // 16 units have 65 parameters: 150 rows determine them, the 100 rows of two recordings do
        // not.
        let (net, chosen, told) = fit_to(3, 50, None);
        let chosen = chosen.unwrap();
        let tried: Vec<usize> = chosen.widths.iter().map(|tried| tried.hidden).collect();
        assert_eq!((tried.as_slice(), chosen.left_out), (&[4, 8][..], LeftOut::Recordings));
        assert!(chosen.widths.iter().all(|tried| tried.error[0] < 0.5), "{chosen:?}");
        assert_eq!(net.hidden_bias.len(), chosen.hidden);
        assert!(chosen.hidden < 16 && told.is_none(), "{told:?}");
    }

    #[test]
    fn default_width_of_two_recordings_raises_warning() {
        let (net, chosen, told) = fit_to(2, 100, None);
        assert_eq!((net.hidden_bias.len(), chosen), (16, None));
        assert!(
            told.unwrap().starts_with("net: 16 hidden units as usual, not chosen by recordings")
        );
        let (net, chosen, told) = fit_to(3, 100, Some(5));
        assert_eq!((net.hidden_bias.len(), chosen, told), (5, None, None));
    }
}
