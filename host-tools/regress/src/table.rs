//! Fit and evaluation of any sensor's CSV with N input columns and some reference columns.

mod model;
mod recording;

use std::borrow::Cow;
use std::sync::atomic::AtomicBool;

use crate::duplicate_channels::{self, Conditioning};
use crate::error::FitError;
use crate::metrics::{Errors, TargetMetrics};
use crate::model::Family;
use crate::network::{NetOptions, Progress};
use crate::outliers::Outliers;
use crate::paper_models::{self, Law};
use crate::polynomial::Expansion;
use crate::range::{extremes, trained_range};
use crate::scaling::Inputs;
use crate::shear;
use crate::sign_check;
use crate::training::{Chosen, Recorded, Training};

pub use model::TableModel;
pub use recording::TableRecording;

/// Options of the fit of a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TableOptions {
    /// Family of the model.
    pub family: Family,
    /// Hidden units; by default 16, or a better width found by held-out recordings.
    ///
    /// That takes three recordings or more of one kind. `auto` finds its own width.
    pub hidden: Option<usize>,
    /// Training options of the net.
    pub net: NetOptions,
}

/// Default number of hidden units.
const USUAL: usize = 16;
/// Multiply-adds of the widest net for `auto`: about 20 µs on a Cortex-M4.
const MOST_MULTIPLY_ADDS: usize = 600;
/// Condition number of the data above which a model without a decay causes a warning.
const EVEN: f64 = 30.0;
/// Least ratio of the extents of a one-sided force; the smaller extent is noise.
const ONE_WAY: f32 = 20.0;
/// Most hidden units, as on the chip.
const MOST: usize = taxel::estimate::net::MAX_HIDDEN;

/// A fitted model with its warnings.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedTable {
    /// The model.
    pub model: TableModel,
    /// Warnings for the user.
    pub warnings: Vec<String>,
    /// Number of rows of the recordings.
    pub rows: usize,
    /// Number of rows left out as outliers.
    pub left_out: usize,
    /// Condition number of the inputs, each scaled by its own spread.
    pub condition: Option<f64>,
    /// Choice of the model, if it was chosen.
    pub chosen: Option<Chosen>,
    /// Number of the net's parameters that the data determine.
    pub effective: f64,
}

/// Fits a model to some recordings. When `stop` becomes true the best so far is returned.
///
/// # Errors
///
/// Data that the recordings lack, and how to provide them.
pub fn fit(
    recordings: &[TableRecording],
    options: &TableOptions,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<FittedTable, FitError> {
    let names: Vec<String> = recordings.iter().map(TableRecording::name).collect();
    fit_model(recordings, options, progress, stop).map_err(|error| error.of(&names.join(", ")))
}

fn fit_model(
    recordings: &[TableRecording],
    options: &TableOptions,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<FittedTable, FitError> {
    let first = recordings.first().ok_or(FitError::NoRecording)?;
    let mut rows = Vec::new();
    for recording in recordings {
        if recording.inputs.rows.is_empty() {
            return Err(FitError::Empty { recording: recording.name() });
        }
        for (table, wanted) in
            [(&recording.inputs, &first.inputs), (&recording.targets, &first.targets)]
        {
            if table.names != wanted.names {
                return Err(FitError::Mismatch {
                    recording: recording.name(),
                    problem: format!(
                        "columns {} where the first recording has {}",
                        table.names.join(", "),
                        wanted.names.join(", ")
                    ),
                    mend: "fit recordings of one sensor at a time".into(),
                });
            }
        }
        rows.push((recording.inputs.rows.clone(), recording.targets.rows.clone()));
    }
    let (mut warnings, left_out) = check(recordings, &mut rows, options.family)?;
    warnings.extend(shear::of_table(&first.targets.names, rows.iter().flat_map(|(_, y)| y)));
    let conditioning = duplicate_channels::conditioning(&rows);
    if let Some(found) = &conditioning {
        warnings.extend(uneven(found, options.family, &first.inputs.names));
    }
    let condition = conditioning.as_ref().map(|found| found.number);
    let x: Vec<&[f64]> = rows.iter().flat_map(|(x, _)| x).map(Vec::as_slice).collect();
    let names = &first.inputs.names;
    let column = |i: usize| x.iter().map(move |row| row[i] as f32);
    let constant: Vec<&str> = (0..names.len())
        .filter(|i| column(*i).all(|value| value == x[0][*i] as f32))
        .map(|i| names[i].as_str())
        .collect();
    if constant.len() == names.len() {
        return Err(FitError::Mismatch {
            recording: first.name(),
            problem: format!(
                "{}: the same value in every row, and there is no other input",
                constant.join(", ")
            ),
            mend: "look for a cable that came off, or name other columns with --inputs".into(),
        });
    }
    if !constant.is_empty() {
        warnings.push(format!(
            "{}: the same value in every row, ignored; leave constant columns out of the inputs",
            constant.join(", ")
        ));
    }
    let kind = kind(
        (0..names.len()).filter(|i| !constant.contains(&&*names[*i])).map(|i| range_of(column(i))),
    );
    let range = (0..names.len()).map(|i| trained_range(column(i), f32::MIN_POSITIVE)).collect();
    let expansion = match options.family {
        Family::Cubic => Expansion::Cubic,
        Family::Quadratic => Expansion::Quadratic,
        _ => Expansion::None,
    };
    let mut model = TableModel {
        inputs: names.clone(),
        targets: first.targets.names.clone(),
        range,
        expansion,
        ..TableModel::default()
    };
    if let Some(law) = paper_models::fit(options.family, &rows) {
        model.law = Some(law?);
        model.residual = residual(&model, &rows);
        let (rows, effective) = (x.len(), 0.0);
        return Ok(FittedTable {
            model,
            warnings,
            rows,
            left_out,
            condition,
            chosen: None,
            effective,
        });
    }
    let (mut centre, mut kind, total) = (Vec::new(), kind, x.len());
    let mut terms = Cow::Borrowed(&rows);
    if expansion != Expansion::None {
        // Powers about the middle of each input are less correlated; each has a size of its own.
        centre = middles(&x);
        kind = Inputs::Unlike;
        for row in terms.to_mut().iter_mut().flat_map(|(x, _)| x) {
            row.iter_mut().zip(&centre).for_each(|(x, centre)| *x -= f64::from(*centre));
            *row = expansion.terms(row);
        }
    }
    let training = Training {
        part: &options.family.to_string(),
        targets: &first.targets.names,
        family: options.family,
        recordings: &terms,
        inputs: kind,
        hidden: options.hidden,
        usual: USUAL,
        most: widest(names.len(), first.targets.names.len()),
        options: options.net,
        teacher: None,
    };
    let (net, chosen) =
        training.run(progress, stop).map_err(|error| match (error, conditioning) {
            (FitError::Shape { part, .. }, Some(found)) => FitError::Shape {
                part,
                problem: format!(
                    "{} are linearly dependent; leave some of them out, or choose ridge",
                    listed(&found.weakest, names)
                ),
            },
            (error, _) => error,
        })?;
    warnings.extend(training.told(chosen.as_ref()));
    model = TableModel {
        centre,
        hidden: net.hidden,
        hidden_bias: net.hidden_bias,
        output: net.output,
        skip: net.skip,
        output_bias: net.output_bias,
        ..model
    };
    model.residual = residual(&model, &rows);
    let effective = net.effective;
    Ok(FittedTable { model, warnings, rows: total, left_out, condition, chosen, effective })
}

/// Checks the recordings; returns warnings and the number of rows left out.
fn check(
    recordings: &[TableRecording],
    rows: &mut [Recorded],
    family: Family,
) -> Result<(Vec<String>, usize), FitError> {
    let first = &recordings[0];
    let names: Vec<String> = recordings.iter().map(TableRecording::name).collect();
    let mut warnings = recording::put_on_time(recordings, rows);
    sign_check::same_sign(rows, &names, &first.targets.names)?;
    for (k, target) in first.targets.names.iter().enumerate().filter(|(_, t)| t.ends_with("_n")) {
        let pulls = |(_, y): &&Recorded| {
            let [low, high] = extremes(y.iter().map(|y| y[k] as f32));
            low < 0.0 && ONE_WAY * high < -low
        };
        if rows.iter().all(|recorded| pulls(&recorded)) {
            let names = names.join(", ");
            warnings
                .push(format!("{names}: {target}: always negative; look at the reference's sign"));
        }
    }
    let law = match paper_models::fit(family, rows) {
        Some(Ok(bent)) => {
            // The outliers distorted this law. A law of the remaining rows judges them.
            let mut kept = rows.to_vec();
            if let Ok(found) = Outliers::find(rows, &names, Some(&|x| said(&bent, x))) {
                found.remove_from(&mut kept);
            }
            paper_models::fit(family, &kept).and_then(Result::ok).or(Some(bent))
        }
        // The error is reported by the later fit.
        Some(Err(_)) => return Ok((warnings, 0)),
        None => None,
    };
    let outliers = match &law {
        Some(law) => Outliers::find(rows, &names, Some(&|x| said(law, x)))?,
        None => Outliers::find(rows, &names, None)?,
    };
    outliers.remove_from(rows);
    let left_out = outliers.wrong.iter().flatten().filter(|wrong| **wrong).count();
    warnings.extend(outliers.told);
    Ok((warnings, left_out))
}

fn said(law: &Law, x: &[f64]) -> Vec<f64> {
    law.estimate(&to_f32(x)).into_iter().map(f64::from).collect()
}

/// Warning about collinear channels or, without a decay, nearly collinear ones.
fn uneven(found: &Conditioning, family: Family, names: &[String]) -> Option<String> {
    let (weakest, number) = (listed(&found.weakest, names), found.number);
    if found.is_collinear() {
        let so = match family {
            Family::LeastSquares => {
                "without a decay their noise decides their weights; leave some of them out, or choose ridge or auto"
            }
            Family::Row | Family::Feeler | Family::Column | Family::Gap => {
                "look for channels that are joined"
            }
            _ => "their weights are shared out by the decay",
        };
        return Some(format!(
            "{weakest}: together they are linearly dependent (condition number {number:.0e}); {so}"
        ));
    }
    (family == Family::LeastSquares && number > EVEN).then(|| {
        format!(
            "{weakest}: in one combination they hardly move (condition number {number:.0} of the data), and \
             without a decay their noise decides its weights; load it more evenly, or choose ridge or auto"
        )
    })
}

fn listed(columns: &[usize], names: &[String]) -> String {
    columns.iter().map(|i| names[*i].as_str()).collect::<Vec<_>>().join(", ")
}

/// RMS error of each target on the fitted rows.
fn residual(model: &TableModel, rows: &[Recorded]) -> Vec<f32> {
    let errors = errors(model, rows.iter().flat_map(|(x, y)| x.iter().zip(y))).into_iter();
    errors.map(|errors| errors.into_metrics("").figures.map_or(0.0, |f| f.rmse as f32)).collect()
}

/// Most hidden units of a net, skip path included, within the multiply-adds.
fn widest(inputs: usize, outputs: usize) -> usize {
    let left = MOST_MULTIPLY_ADDS.saturating_sub(inputs * outputs);
    (left / (inputs + outputs).max(1)).clamp(1, MOST)
}

/// Mean of each column.
fn middles(x: &[&[f64]]) -> Vec<f32> {
    let n = x.len().max(1) as f64;
    let width = x.first().map_or(0, |row| row.len());
    (0..width).map(|i| (x.iter().map(|row| row[i]).sum::<f64>() / n) as f32).collect()
}

/// Range of a column, largest minus smallest.
fn range_of(column: impl Iterator<Item = f32>) -> f32 {
    let [low, high] = extremes(column);
    high - low
}

/// Classifies the columns: ranges within two orders of magnitude mean channels of one kind.
fn kind(moves: impl Iterator<Item = f32>) -> Inputs {
    let [least, most] = extremes(moves);
    if most <= 100.0 * least { Inputs::Alike } else { Inputs::Unlike }
}

/// Errors of a model on a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct TableEvaluation {
    /// Figures per target, over all rows.
    pub targets: Vec<TargetMetrics>,
    /// Number of rows with an input beyond the trained range; they are judged as well.
    pub beyond_range: usize,
}

/// Evaluates a model on a recording.
///
/// # Errors
///
/// The recording's columns differ from those of the model.
pub fn evaluate(
    model: &TableModel,
    recording: &TableRecording,
) -> Result<TableEvaluation, FitError> {
    if recording.inputs.names != model.inputs || recording.targets.names != model.targets {
        return Err(FitError::Mismatch {
            recording: recording.name(),
            problem: format!(
                "columns {} → {} where the model has {} → {}",
                recording.inputs.names.join(", "),
                recording.targets.names.join(", "),
                model.inputs.join(", "),
                model.targets.join(", ")
            ),
            mend: "evaluate with the columns that the model was fitted to".into(),
        });
    }
    let beyond = |row: &&Vec<f64>| !model.within_range(&to_f32(row));
    let targets = errors(model, recording.inputs.rows.iter().zip(&recording.targets.rows));
    Ok(TableEvaluation {
        targets: targets
            .into_iter()
            .zip(&model.targets)
            .map(|(errors, name)| errors.into_metrics(name))
            .collect(),
        beyond_range: recording.inputs.rows.iter().filter(beyond).count(),
    })
}

fn to_f32(row: &[f64]) -> Vec<f32> {
    row.iter().map(|value| *value as f32).collect()
}

fn errors<'r>(
    model: &TableModel,
    rows: impl Iterator<Item = (&'r Vec<f64>, &'r Vec<f64>)>,
) -> Vec<Errors> {
    let mut errors = vec![Errors::default(); model.targets.len()];
    for (x, y) in rows {
        for ((errors, found), wanted) in errors.iter_mut().zip(model.estimate(&to_f32(x))).zip(y) {
            errors.add(f64::from(found) - wanted);
        }
    }
    errors
}
