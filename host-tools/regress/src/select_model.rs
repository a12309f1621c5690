//! Training of the chosen model family.

use std::sync::atomic::AtomicBool;

use crate::error::FitError;
use crate::folds::stretches;
use crate::model::Family;
use crate::network::{self, Build, Net, NetOptions, Progress};
use crate::training::{Chosen, Training};
use crate::{auto, select_width};

/// Most steps of a training on half of the rows.
const SHORT: usize = 60;

impl Training<'_> {
    /// Trains the model and returns it with its choice, if there was one.
    ///
    /// # Errors
    ///
    /// Rows, loads or columns that the recordings lack.
    pub fn run(
        &self,
        progress: &mut dyn FnMut(Progress),
        stop: &AtomicBool,
    ) -> Result<(Net, Option<Chosen>), FitError> {
        self.train(progress, stop).map_err(|error| match error {
            FitError::NoLoad { .. } => self.at_rest().unwrap_or(error),
            error => error,
        })
    }

    fn train(
        &self,
        progress: &mut dyn FnMut(Progress),
        stop: &AtomicBool,
    ) -> Result<(Net, Option<Chosen>), FitError> {
        let chosen = |(net, chosen)| (net, Some(chosen));
        match self.family {
            Family::Auto => auto::fit(self, self.hidden, progress, stop).map(chosen),
            // The polynomials are linear in their terms.
            Family::Ridge | Family::Cubic | Family::Quadratic => {
                auto::fit(self, Some(0), progress, stop).map(chosen)
            }
            Family::LeastSquares => auto::line(self).map(|net| (net, None)),
            Family::Row | Family::Feeler | Family::Column | Family::Gap => Err(FitError::Shape {
                part: self.part.into(),
                problem: format!("{} is fitted to a table of its own quantities", self.family),
            }),
            Family::Mlp | Family::Skip => {
                let (x, y): (Vec<_>, Vec<_>) = self.recordings.iter().cloned().unzip();
                let skip = self.family == Family::Skip;
                let chosen = match self.hidden {
                    Some(_) => None,
                    None => select_width::choose(self, skip, progress, stop)?,
                };
                let found = chosen.as_ref().map_or(self.usual, |chosen| chosen.hidden);
                let build = Build { hidden: self.hidden.unwrap_or(found), skip };
                let options = (self.inputs, self.options);
                let rows = (&*x.concat(), &*y.concat());
                network::fit(self.part, rows, build, options, progress, stop)
                    .map(|net| (net, chosen))
            }
        }
    }

    /// RMS error of each target on stretches left out of a short training, two halves of them.
    ///
    /// `None` if a half does not determine the net, or if the training was stopped.
    pub fn held_out(
        &self,
        build: Build,
        progress: &mut dyn FnMut(Progress),
        stop: &AtomicBool,
    ) -> Option<Vec<f64>> {
        let targets: Vec<&[Vec<f64>]> = self.recordings.iter().map(|r| r.1.as_slice()).collect();
        let (_, stretch) = stretches(&targets);
        let rows = || self.recordings.iter().flat_map(|(x, y)| x.iter().zip(y)).zip(&stretch);
        let of = |half: usize| -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
            let own = rows().filter(|(_, stretch)| *stretch % 2 == half).map(|(row, _)| row);
            own.map(|(x, y)| (x.clone(), y.clone())).unzip()
        };
        let halves = [of(0), of(1)];
        let options =
            NetOptions { starts: 1, steps: self.options.steps.min(SHORT), ..self.options };
        let (mut squares, mut count) = (vec![0.0; self.targets.len()], 0.0);
        for (i, (x, y)) in halves.iter().enumerate() {
            let part = format!("{}: half {} left out", self.part, 2 - i);
            let options = (self.inputs, options);
            let net = network::fit(&part, (x, y), build, options, progress, stop).ok()?;
            let (x, y) = &halves[1 - i];
            for (x, y) in x.iter().zip(y) {
                let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
                for ((sum, found), wanted) in squares.iter_mut().zip(net.outputs(&x)).zip(y) {
                    *sum += (f64::from(found) - wanted).powi(2);
                }
                count += 1.0;
            }
        }
        Some(squares.iter().map(|sum| (sum / f64::max(count, 1.0)).sqrt()).collect())
    }

    /// Error with the names of the targets that never change; `None` if all of them change.
    fn at_rest(&self) -> Option<FitError> {
        let rows = || self.recordings.iter().flat_map(|(_, y)| y);
        let first = rows().next()?;
        let rests = |k: &usize| rows().all(|row| row[*k] == first[*k]);
        let resting = (0..self.targets.len()).filter(rests).map(|k| self.targets[k].as_str());
        let resting: Vec<&str> = resting.collect();
        (!resting.is_empty())
            .then(|| FitError::AtRest { part: self.part.into(), columns: resting.join(", ") })
    }
}
