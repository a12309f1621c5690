//! From rows in their own units to a net of f32 weights.
//!
//! A few starts; the best of them takes shape under the decay that the evidence asks for. The evidence
//! takes every row for news, but the error of a press or a stroke is one error, seen in many rows: its
//! decay is too weak. How much stronger it should be is found by leaving stretches of time out
//! ([`crate::strength`]); so stiffened, the net settles on all rows.

use std::sync::atomic::{AtomicBool, Ordering};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use taxel::estimate::net::forward;

use crate::error::FitError;
use crate::levenberg::{Decay, State};
use crate::mlp::Shape;
use crate::problem::{Problem, Row};
use crate::strength;

/// A recording at kilohertz repeats itself from row to row; every k-th row, so that about this many are
/// left, says the same in a fraction of the time.
const MOST_ROWS: usize = 4096;
/// Steps that each start is given before the best of them goes on.
const START_STEPS: usize = 25;
/// On all rows, each stands for itself.
const EACH: f64 = 1.0;

/// How a net is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetOptions {
    /// Seed of the starting weights: the same seed and recordings give the same net.
    pub seed: u64,
    /// Starts, of which the best goes on.
    pub starts: usize,
    /// Most steps on all rows; the search for the decay adds its own.
    pub steps: usize,
}

impl Default for NetOptions {
    fn default() -> Self {
        Self { seed: 0, starts: 3, steps: 300 }
    }
}

/// How the inputs of a net relate to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inputs {
    /// Channels of one kind, with one unit and one noise: they are scaled together, so that a channel
    /// that hardly moves is not blown up until its noise and drift weigh as much as the others' signal.
    Alike,
    /// Quantities of different kinds: each is scaled by its own spread.
    Unlike,
}

/// How far a fit has come.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// What is being fitted.
    pub part: String,
    /// Steps done.
    pub step: usize,
    /// Most steps there will be.
    pub of: usize,
    /// RMS error of the outputs so far, as a share of the targets' spread.
    pub error: f64,
}

/// The rows of one recording, in the order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observed {
    /// Inputs, a row a moment.
    pub x: Vec<Vec<f64>>,
    /// Targets, row for row.
    pub y: Vec<Vec<f64>>,
}

/// A trained net y = V·tanh(W·x + a) + b in f32, scaling folded in, laid out as
/// [`taxel::estimate::net::forward`] takes it.
#[derive(Clone, Debug, PartialEq)]
pub struct Net {
    /// W, a row a unit.
    pub hidden: Vec<f32>,
    /// a.
    pub hidden_bias: Vec<f32>,
    /// V, a row an output.
    pub output: Vec<f32>,
    /// b.
    pub output_bias: Vec<f32>,
    /// Accepted steps of the start that was kept.
    pub steps: usize,
    /// How many of its parameters the data determine.
    pub effective: f64,
    /// How many times stronger than the evidence asks its decay was chosen.
    pub strength: f64,
    /// Rows it was trained on after thinning.
    pub rows: usize,
}

impl Net {
    /// The outputs for one row, by the arithmetic of the chip.
    #[must_use]
    pub fn outputs(&self, x: &[f32]) -> Vec<f32> {
        let mut units = vec![0.0; self.hidden_bias.len()];
        let mut y = self.output_bias.clone();
        let (hidden, output) =
            ((&*self.hidden, &*self.hidden_bias), (&*self.output, &*self.output_bias));
        forward(x, hidden, output, &mut units, &mut y);
        y
    }
}

/// Counts steps over all stages of a fit, and asks whether to go on.
pub(crate) struct Meter<'a> {
    part: &'a str,
    done: usize,
    of: usize,
    report: &'a mut dyn FnMut(Progress),
    stop: &'a AtomicBool,
}

impl<'a> Meter<'a> {
    pub(crate) fn new(
        part: &'a str,
        of: usize,
        report: &'a mut dyn FnMut(Progress),
        stop: &'a AtomicBool,
    ) -> Self {
        Self { part, done: 0, of, report, stop }
    }

    /// Shows `steps` of the stage at hand; whether to go on.
    pub(crate) fn show(&mut self, steps: usize, error: f64) -> bool {
        if !self.goes_on() {
            return false;
        }
        let step = self.done + steps;
        (self.report)(Progress { part: self.part.into(), step, of: self.of, error });
        self.goes_on()
    }

    /// The stage is over, whether it took all its steps or not.
    pub(crate) fn pass(&mut self, planned: usize) {
        self.done += planned;
    }

    pub(crate) fn goes_on(&self) -> bool {
        !self.stop.load(Ordering::Relaxed)
    }
}

/// Trains a net of `hidden` units on some recordings.
///
/// An input that never changes gets no weight. When `stop` becomes true, the best net so far is
/// returned.
///
/// # Errors
/// Fewer rows than would determine it, a target that never changes, or stopped before the first step.
pub fn fit(
    part: &str,
    recordings: &[Observed],
    hidden: usize,
    (inputs, options): (Inputs, NetOptions),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Net, FitError> {
    let recordings = thinned(recordings);
    let rows = recordings.concat();
    let shape = Shape {
        inputs: rows.first().map_or(0, |row| row.x.len()),
        hidden,
        outputs: rows.first().map_or(0, |row| row.y.len()),
    };
    if shape.inputs == 0 || shape.hidden == 0 || shape.outputs == 0 {
        let problem = "a net needs inputs, hidden units and outputs".into();
        return Err(FitError::Shape { part: part.into(), problem });
    }
    // A row gives `outputs` equations; with fewer than two an unknown the fit means nothing.
    let least = (2 * shape.parameters()).div_ceil(shape.outputs);
    if rows.len() < least {
        return Err(FitError::TooFewRows { part: part.into(), rows: rows.len(), least });
    }
    let no_load = || FitError::NoLoad { part: part.into() };
    let mut problem = Problem::new(shape, inputs, &rows).ok_or_else(no_load)?;

    let folds = strength::folds(&recordings);
    let starts = options.starts.max(1);
    let first = START_STEPS.min(options.steps);
    let settle = options.steps / 3;
    let explore = (options.steps - settle).saturating_sub(first);
    let search = strength::steps(folds.len(), options.steps);
    let of = starts * first + explore + search + settle;
    let mut meter = Meter::new(part, of, progress, stop);

    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut best: Option<State> = None;
    for _ in 0..starts {
        let state = problem.train(
            problem.start(&mut rng),
            Decay::Evidence { per_row: EACH },
            first,
            &mut meter,
        );
        let better = |best: &State| state.squares.sum() < best.squares.sum();
        if state.steps > 0 && best.as_ref().is_none_or(better) {
            best = Some(state);
        }
    }
    let best = best.ok_or(FitError::Stopped)?;
    // The evidence first lets the net leave the plateau on which it is a linear map; a stronger decay
    // would hold it there.
    let mut best = problem.explore(best, EACH, explore, &mut meter);
    let Some(strength) = strength::choose(&folds, (shape, inputs), options, &mut meter) else {
        return Ok(problem.net(&best, 1.0));
    };
    best.stiffen(strength);
    let best = problem.train(best, Decay::Held, settle, &mut meter);
    Ok(problem.net(&best, strength))
}

/// Every k-th row of each recording.
fn thinned(recordings: &[Observed]) -> Vec<Vec<Row<'_>>> {
    let rows: usize = recordings.iter().map(|recording| recording.x.len()).sum();
    let every = rows.div_ceil(MOST_ROWS).max(1);
    recordings
        .iter()
        .map(|recording| recording.x.iter().zip(&recording.y).step_by(every))
        .map(|rows| rows.map(|(x, y)| Row { x, y }).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNLIKE: (Inputs, NetOptions) =
        (Inputs::Unlike, NetOptions { seed: 0, starts: 3, steps: 300 });

    /// A smooth function of three inputs of very different size, in two outputs.
    fn rows(count: usize) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
        let x: Vec<Vec<f64>> = (0..count)
            .map(|i| i as f64)
            .map(|i| {
                vec![100.0 + 20.0 * (0.11 * i).sin(), 1e-3 * (0.37 * i).cos(), (0.23 * i).sin()]
            })
            .collect();
        let y = x
            .iter()
            .map(|x| {
                vec![5.0 + (x[0] / 20.0).sin() + 500.0 * x[1], 2.0 * (x[2] - 800.0 * x[1]).tanh()]
            })
            .collect();
        (x, y)
    }

    fn observed(x: &[Vec<f64>], y: &[Vec<f64>]) -> [Observed; 1] {
        [Observed { x: x.to_vec(), y: y.to_vec() }]
    }

    fn fit_quietly(x: &[Vec<f64>], y: &[Vec<f64>], options: NetOptions) -> Result<Net, FitError> {
        fit("net", &observed(x, y), 6, (Inputs::Unlike, options), &mut |_| {}, &false.into())
    }

    #[test]
    fn folded_f32_weights_follow_the_function_in_its_own_units() {
        let (x, y) = rows(600);
        let net = fit_quietly(&x, &y, NetOptions::default()).unwrap();
        for (x, y) in x.iter().zip(&y) {
            let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
            for (found, wanted) in net.outputs(&x).iter().zip(y) {
                assert!((f64::from(*found) - wanted).abs() < 0.05, "{found} {wanted}");
            }
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_bits_and_another_seed_another_net() {
        let (x, y) = rows(200);
        let net = |seed| fit_quietly(&x, &y, NetOptions { seed, starts: 2, steps: 30 }).unwrap();
        assert_eq!(net(1), net(1));
        assert_ne!(net(1).hidden, net(2).hidden);
    }

    /// Stops when so many steps are done; the net and the last step shown.
    fn stopped_at(step: usize) -> (Net, Progress) {
        let (x, y) = rows(200);
        let stop = AtomicBool::new(false);
        let mut last = None;
        let mut progress = |p: Progress| {
            stop.store(p.step >= step, Ordering::Relaxed);
            last = Some(p);
        };
        let net = fit("net", &observed(&x, &y), 6, UNLIKE, &mut progress, &stop).unwrap();
        (net, last.unwrap())
    }

    #[test]
    fn stopping_returns_the_best_so_far() {
        let (net, last) = stopped_at(5);
        assert_eq!((net.steps, last.step), (5, 5));
    }

    #[test]
    fn stopping_the_search_for_the_decay_returns_the_net_that_took_shape() {
        let (net, last) = stopped_at(400);
        assert!((400..=410).contains(&last.step) && last.of == 1250, "{last:?}");
        assert!((100..=200).contains(&net.steps), "{}", net.steps);
        let (x, y) = rows(200);
        for (x, y) in x.iter().zip(&y) {
            let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
            assert!((f64::from(net.outputs(&x)[0]) - y[0]).abs() < 0.1);
        }
    }

    #[test]
    fn progress_never_goes_back_nor_beyond_the_end() {
        let (x, y) = rows(200);
        let mut steps = Vec::new();
        let mut progress = |p: Progress| {
            assert!(p.step <= p.of);
            steps.push(p.step);
        };
        let options = (Inputs::Unlike, NetOptions { seed: 0, starts: 2, steps: 60 });
        fit("net", &observed(&x, &y), 6, options, &mut progress, &false.into()).unwrap();
        assert!(steps.is_sorted());
    }

    #[test]
    fn stopped_before_the_first_step_there_is_nothing_to_keep() {
        let (x, y) = rows(200);
        let stop = AtomicBool::new(true);
        let error = fit("net", &observed(&x, &y), 6, UNLIKE, &mut |_| {}, &stop).unwrap_err();
        assert_eq!(error, FitError::Stopped);
    }

    #[test]
    fn an_input_that_never_changes_gets_no_weight() {
        let (mut x, y) = rows(200);
        x.iter_mut().for_each(|row| row[2] = 7.0);
        let net = fit_quietly(&x, &y, NetOptions { steps: 20, ..NetOptions::default() }).unwrap();
        assert!(net.hidden.chunks_exact(3).all(|unit| unit[2] == 0.0));
    }

    #[test]
    fn a_dozen_rows_and_a_constant_target_are_refused() {
        let (x, y) = rows(12);
        assert!(matches!(
            fit_quietly(&x, &y, NetOptions::default()),
            Err(FitError::TooFewRows { rows: 12, .. })
        ));
        let (x, mut y) = rows(200);
        y.iter_mut().for_each(|row| row[1] = 0.0);
        assert!(matches!(fit_quietly(&x, &y, NetOptions::default()), Err(FitError::NoLoad { .. })));
    }
}
