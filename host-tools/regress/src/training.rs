//! Task of a fit and its outcome: recordings, family, and the choice of a model.

use std::sync::atomic::AtomicBool;

use crate::error::FitError;
use crate::folds::LeftOut;
use crate::model::Family;
use crate::network::{Build, Net, NetOptions, Progress};
use crate::scaling::Inputs;

/// Inputs and targets of one recording, row for row.
pub type Recorded = (Vec<Vec<f64>>, Vec<Vec<f64>>);

/// The model to train and the recordings to train it on.
pub struct Training<'a> {
    /// Name of the part in messages.
    pub part: &'a str,
    /// Names of the targets in messages.
    pub targets: &'a [String],
    /// Family of the model.
    pub family: Family,
    /// Rows of each recording.
    pub recordings: &'a [Recorded],
    /// Relation of the inputs to each other.
    pub inputs: Inputs,
    /// Hidden units, if the user specifies them.
    pub hidden: Option<usize>,
    /// Default number of hidden units for nets of fixed width.
    pub usual: usize,
    /// Widest net that its destination can hold.
    pub most: usize,
    /// Training options of the nets.
    pub options: NetOptions,
    /// Additional source of training rows for a net of family `auto`.
    pub teacher: Option<Teacher<'a>>,
}

/// A model of the sensor that generates training rows for a net.
#[derive(Clone, Copy)]
pub struct Teacher<'a> {
    /// RMS error of the model over the recordings, of each target.
    pub residual: &'a [f64],
    /// Default number of hidden units of its net.
    pub hidden: usize,
    /// Trains the net.
    pub teach: &'a Teach<'a>,
}

/// Trains a net of the given shape; the name appears in messages.
pub type Teach<'a> = dyn Fn(&str, (Build, NetOptions), &mut dyn FnMut(Progress), &AtomicBool) -> Result<Net, FitError>
    + 'a;

/// Choice of a model: its candidates and their cross-validated errors.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// Kind of folds left out to choose it.
    pub left_out: LeftOut,
    /// RMS error of a linear fit on held-out rows, in the targets' units; empty if not tried.
    pub line: Vec<f64>,
    /// RMS error of the net's Gaussian-process teacher on held-out rows, in the targets' units.
    pub bent: Vec<f64>,
    /// Distance of the net from its Gaussian-process teacher, on rows that are not recorded.
    ///
    /// Empty for a linear model and for a net taught by the skin model.
    pub apart: Vec<f64>,
    /// RMS error of the skin model on the recordings, if it taught the net; otherwise empty.
    ///
    /// The skin model is the teacher if its error is less than that of the Gaussian process on
    /// held-out rows.
    pub skin: Vec<f64>,
    /// Number of hidden units.
    pub hidden: usize,
    /// Widths tried for a net of one family; empty if none were.
    pub widths: Vec<Tried>,
}

/// Cross-validated error of a width.
#[derive(Clone, Debug, PartialEq)]
pub struct Tried {
    /// Number of hidden units.
    pub hidden: usize,
    /// RMS error of each target, in its units.
    pub error: Vec<f64>,
}

impl Training<'_> {
    /// Warning about a choice that was not based on whole recordings.
    pub fn told(&self, chosen: Option<&Chosen>) -> Option<String> {
        let least = "that takes three recordings or more of one kind, mounted again each time";
        match (self.family, chosen) {
            (Family::Mlp | Family::Skip, None) if self.hidden.is_none() => Some(format!(
                "{}: {} hidden units as usual, not chosen by recordings left out: {least}; record more, or set --hidden",
                self.part, self.usual
            )),
            (_, Some(chosen)) if chosen.left_out == LeftOut::Stretches => Some(format!(
                "{}: chosen by stretches of the recordings, not by whole ones left out: {least}; without them \
                 the error on another mounting may be larger",
                self.part
            )),
            _ => None,
        }
    }
}
