//! The task of a fit and its outcome: recordings, family, and how a model was chosen.

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
    /// Name in messages.
    pub part: &'a str,
    /// Names of the targets in messages.
    pub targets: &'a [String],
    /// The family of the model.
    pub family: Family,
    /// The rows of each recording.
    pub recordings: &'a [Recorded],
    /// Relation of the inputs to each other.
    pub inputs: Inputs,
    /// Hidden units, if the user says.
    pub hidden: Option<usize>,
    /// Hidden units of the nets of fixed width, if not.
    pub usual: usize,
    /// The widest net that fits where it goes.
    pub most: usize,
    /// Training of the nets.
    pub options: NetOptions,
    /// Another source of training rows for a net that `auto` chooses.
    pub teacher: Option<Teacher<'a>>,
}

/// A model of the sensor that makes rows to train a net on.
#[derive(Clone, Copy)]
pub struct Teacher<'a> {
    /// RMS error of the model over the recordings, of each target.
    pub residual: &'a [f64],
    /// Hidden units of its net, if the user does not say.
    pub hidden: usize,
    /// Trains the net.
    pub teach: &'a Teach<'a>,
}

/// Trains a net of the given shape; the name is for messages.
pub type Teach<'a> = dyn Fn(&str, (Build, NetOptions), &mut dyn FnMut(Progress), &AtomicBool) -> Result<Net, FitError>
    + 'a;

/// Choice of a model: its candidates and their cross-validated errors.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// Kind of folds that were left out to choose it.
    pub left_out: LeftOut,
    /// RMS error of a straight line on what was left out, in the targets' units; empty where none was tried.
    pub line: Vec<f64>,
    /// RMS error of the Gaussian process that the net was trained on, likewise.
    pub bent: Vec<f64>,
    /// Distance of the net from that model, between and beyond the recorded rows; empty for a line, and for
    /// a net that the model of the skin taught.
    pub apart: Vec<f64>,
    /// RMS error of the model of the skin, where that taught the net: it meets the recordings better than
    /// the bent model meets what was left out.
    pub skin: Vec<f64>,
    /// Hidden units.
    pub hidden: usize,
    /// The widths of a net of one family that were tried; empty for what was not chosen so.
    pub widths: Vec<Tried>,
}

/// Cross-validated error of a width.
#[derive(Clone, Debug, PartialEq)]
pub struct Tried {
    /// Hidden units.
    pub hidden: usize,
    /// RMS error of each target, in its units.
    pub error: Vec<f64>,
}

impl Training<'_> {
    /// Warning about a choice that was not made on whole recordings.
    pub fn told(&self, chosen: Option<&Chosen>) -> Option<String> {
        let least = "that takes three recordings or more of one kind, mounted again each time";
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
}
