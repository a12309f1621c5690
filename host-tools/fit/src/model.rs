//! The families of models, by the names that the command knows them by.

use std::fmt;
use std::str::FromStr;
use std::sync::atomic::AtomicBool;

use crate::auto::{self, Choice, Chosen, SkinTeacher};
use crate::error::FitError;
use crate::network::{self, Build, Net, NetOptions, Progress};
use crate::scaling::Inputs;
use crate::stretches::LeftOut;
use crate::width;

/// A family of models.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Family {
    /// The family, the width and the decay that do best on what is left out.
    Auto,
    /// The net of 002: one hidden layer of tanh units.
    #[default]
    Mlp,
    /// The same with a linear skip path.
    Skip,
    /// Linear, with a decay.
    Ridge,
    /// Linear in every input, its square and its cube.
    Cubic,
    /// Linear in every input and every product of two.
    Quadratic,
    /// Linear without a decay: S(u − b) row by row (003 eqs (1.22)–(1.24)), 3×3 or 6×3n.
    LeastSquares,
    /// The line of four of 002.
    Row,
    /// The feeler of 000.
    Feeler,
    /// The column of 001.
    Column,
    /// Each signal to the displacement of its own facet.
    Gap,
}

/// Every family with its name.
const NAMES: [(&str, Family); 11] = [
    ("auto", Family::Auto),
    ("mlp", Family::Mlp),
    ("skip", Family::Skip),
    ("ridge", Family::Ridge),
    ("cubic", Family::Cubic),
    ("quadratic", Family::Quadratic),
    ("least-squares", Family::LeastSquares),
    ("row", Family::Row),
    ("feeler", Family::Feeler),
    ("column", Family::Column),
    ("gap", Family::Gap),
];

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = NAMES.iter().find(|(_, family)| family == self).map_or("", |(name, _)| name);
        f.write_str(name)
    }
}

impl FromStr for Family {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        NAMES.iter().find(|(name, _)| *name == text).map(|(_, family)| *family).ok_or_else(|| {
            format!("no such model; there are {}", NAMES.map(|(name, _)| name).join(", "))
        })
    }
}

/// Inputs and targets of one recording, row for row.
pub(crate) type Recorded = (Vec<Vec<f64>>, Vec<Vec<f64>>);

/// What to train, and on what.
pub(crate) struct Training<'a> {
    pub part: &'a str,
    /// What messages call the targets.
    pub targets: &'a [String],
    pub family: Family,
    pub recordings: &'a [Recorded],
    pub inputs: Inputs,
    /// Hidden units, if the user says.
    pub hidden: Option<usize>,
    /// Hidden units of the nets of fixed width, if not.
    pub usual: usize,
    /// The widest net that fits where it goes.
    pub most: usize,
    pub options: NetOptions,
    /// What else could teach a net that `auto` chooses.
    pub skin: Option<SkinTeacher<'a>>,
}

impl Training<'_> {
    /// Trains. How the model was chosen is told where it was.
    ///
    /// # Errors
    /// What the recordings lack.
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
        let chosen_from = |hidden| Choice {
            part: self.part,
            recordings: self.recordings,
            inputs: self.inputs,
            hidden,
            most: self.most,
            options: self.options,
            skin: self.skin,
        };
        let chosen = |(net, chosen)| (net, Some(chosen));
        match self.family {
            Family::Auto => auto::fit(&chosen_from(self.hidden), progress, stop).map(chosen),
            // The polynomials are linear in their terms.
            Family::Ridge | Family::Cubic | Family::Quadratic => {
                auto::fit(&chosen_from(Some(0)), progress, stop).map(chosen)
            }
            Family::LeastSquares => auto::line(&chosen_from(Some(0))).map(|net| (net, None)),
            Family::Row | Family::Feeler | Family::Column | Family::Gap => Err(FitError::Shape {
                part: self.part.into(),
                problem: format!("{} is fitted to a table of its own quantities", self.family),
            }),
            Family::Mlp | Family::Skip => {
                let (x, y): (Vec<_>, Vec<_>) = self.recordings.iter().cloned().unzip();
                let skip = self.family == Family::Skip;
                let chosen = match self.hidden {
                    Some(_) => None,
                    None => width::choose(self, skip, progress, stop)?,
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

    /// What the user should know of a choice that no whole recording had a say in.
    pub fn told(&self, chosen: Option<&Chosen>) -> Option<String> {
        let least = "that takes three recordings or more of one kind, mounted anew each time";
        match (self.family, chosen) {
            (Family::Mlp | Family::Skip, None) if self.hidden.is_none() => Some(format!(
                "{}: {} hidden units as usual, not chosen by recordings left out: {least}; record more, or say --hidden",
                self.part, self.usual
            )),
            (_, Some(chosen)) if chosen.left_out == LeftOut::Stretches => Some(format!(
                "{}: chosen by stretches of the recordings, not by whole ones left out: {least}; without them \
                 another mounting may be met less well",
                self.part
            )),
            _ => None,
        }
    }

    /// A refusal with the names of the targets that never change, if there are such.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_family_is_known_by_its_name() {
        for (name, family) in NAMES {
            assert_eq!(name.parse(), Ok(family));
            assert_eq!(family.to_string(), name);
        }
        assert!("cubist".parse::<Family>().unwrap_err().contains("quadratic"));
    }
}
