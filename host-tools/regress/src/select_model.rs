//! Training of the chosen model family.

use std::sync::atomic::AtomicBool;

use crate::error::FitError;
use crate::model::Family;
use crate::network::{self, Build, Net, Progress};
use crate::training::{Chosen, Training};
use crate::{auto, select_width};

impl Training<'_> {
    /// Trains the model and returns it with its choice, if there was one.
    ///
    /// # Errors Rows, loads or columns that the recordings lack.
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
