//! Report of another sensor: a table of channels and its fitted model.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, SymmetricEigen};
use taxel_regress::shear;
use taxel_regress::table::{TableModel, TableRecording};

use super::coverage;
use super::doubts::{self, alike, condition};
use super::judge::{About, Part, Report, Trial, assemble};
use super::series::{Kind, Series, split_unit};
use super::verdict::{self, HeldOut};
use crate::finger::Channel;

/// Names of the inputs' principal directions, the axes of their map.
const DIRECTIONS: [&str; 2] = ["inputs, first direction", "inputs, second direction"];

/// Judges `model` on the recordings `judged`; `fitted` are those of the fit, if known.
///
/// All recordings have the model's columns.
#[must_use]
pub fn judge(model: &TableModel, judged: &[TableRecording], fitted: &[TableRecording]) -> Report {
    let trials: Vec<Trial> = judged.iter().map(|recording| trial(model, recording)).collect();
    let known = if fitted.is_empty() { judged } else { fitted };
    let mut warnings: Vec<String> = judged
        .iter()
        .filter(|recording| fitted.iter().any(|fitted| is_part_of(recording, fitted)))
        .map(|recording| doubts::no_forecast(&recording.name()))
        .collect();
    let held_out = HeldOut::of(fitted.is_empty(), &warnings);
    warnings.extend(doubts(model, fitted));
    for recording in judged {
        let rows = recording.inputs.rows.len();
        let beyond = recording.inputs.rows.iter().filter(|row| !within(model, row)).count();
        if beyond > 0 {
            warnings.push(format!(
                "{}: {beyond} of {rows} rows have inputs beyond the trained range",
                recording.name()
            ));
        }
    }
    let coverage =
        coverage::over(&pairs(model), &mapped(model, fitted, known), &mapped(model, judged, known));
    let quantities = verdict::of_table(&model.targets);
    let report = assemble(about(model, known), warnings, trials, coverage, (&quantities, held_out));
    let channel =
        |columns: &[String], used: &str| Channel::new(&columns.join(", "), vec![used.into()], "");
    let channels = vec![
        channel(&model.inputs, "inputs of the model"),
        channel(&model.targets, "labels that this page judges by"),
    ];
    Report { channels, ..report }
}

/// Series of every target of a recording with the model's estimates.
pub(crate) fn series(model: &TableModel, recording: &TableRecording) -> Vec<Series> {
    let (rows, times) = (&recording.inputs.rows, &recording.inputs.times);
    let timed = times.len() == rows.len();
    let begin = times.first().copied().unwrap_or_default();
    let time: Vec<f64> =
        (0..rows.len()).map(|i| if timed { times[i] - begin } else { i as f64 }).collect();
    let said: Vec<Vec<f32>> = rows.iter().map(|row| model.estimate(&single(row))).collect();
    let column = |(k, name): (usize, &String)| Series {
        time: time.clone(),
        reference: recording.targets.rows.iter().map(|row| row[k]).collect(),
        estimate: said.iter().map(|row| row.get(k).map(|said| f64::from(*said))).collect(),
        timed,
        ..Series::empty(Kind::Column(name.clone()))
    };
    model.targets.iter().enumerate().map(column).collect()
}

fn trial(model: &TableModel, recording: &TableRecording) -> Trial {
    let times = &recording.inputs.times;
    let seconds = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
    Trial::new(recording.name(), seconds, recording.inputs.rows.len(), series(model, recording))
}

fn about(model: &TableModel, recordings: &[TableRecording]) -> About {
    let units: Vec<&'static str> = model.targets.iter().map(|name| split_unit(name).1).collect();
    let part = Part {
        name: "table".into(),
        model: format!(
            "{} → {}: {}",
            shortened(&model.inputs),
            model.targets.join(", "),
            model.shape()
        ),
        residual: model.residual.iter().map(|r| f64::from(*r)).collect(),
        units,
        noise: None,
        condition: None,
        condition_of_data: condition(&centred(recordings)),
    };
    About { serial: model.serial.clone(), date: model.date, parts: vec![part] }
}

/// `m0 … m14`, or all names if they are few.
fn shortened(names: &[String]) -> String {
    match names {
        [first, .., last] if names.len() > 4 => format!("{first} … {last}"),
        names => names.join(", "),
    }
}

fn doubts(model: &TableModel, fitted: &[TableRecording]) -> Vec<String> {
    if fitted.is_empty() {
        return doubts::unknown();
    }
    let mut doubts = doubts::few(fitted.len());
    let rows = fitted.iter().flat_map(|recording| &recording.targets.rows);
    doubts.extend(shear::of_table(&model.targets, rows));
    doubts.extend(alike(&model.inputs, &centred(fitted)));
    doubts
}

/// Inputs relative to their mean.
fn centred(recordings: &[TableRecording]) -> Vec<Vec<f64>> {
    let rows = || recordings.iter().flat_map(|recording| &recording.inputs.rows);
    let n = rows().count().max(1) as f64;
    let width = rows().next().map_or(0, Vec::len);
    let mean: Vec<f64> = (0..width).map(|i| rows().map(|row| row[i]).sum::<f64>() / n).collect();
    rows().map(|row| row.iter().zip(&mean).map(|(x, mean)| x - mean).collect()).collect()
}

/// Pairs of columns with a map: the inputs' principal directions, and targets of one unit.
fn pairs(model: &TableModel) -> Vec<(Kind, Kind)> {
    let column = |name: &str| Kind::Column(name.into());
    let mut pairs = vec![(column(DIRECTIONS[0]), column(DIRECTIONS[1]))];
    for (i, y) in model.targets.iter().enumerate() {
        let alike = model.targets[..i].iter().filter(|x| split_unit(x).1 == split_unit(y).1);
        pairs.extend(alike.map(|x| (column(x), column(y))));
    }
    pairs
}

/// Series of the maps: targets, and inputs along the principal directions of those `known`.
fn mapped(
    model: &TableModel,
    recordings: &[TableRecording],
    known: &[TableRecording],
) -> Vec<Vec<Series>> {
    let Some(directions) = directions(&centred(known)) else { return Vec::new() };
    let along = |recording: &TableRecording, i: usize| Series {
        reference: recording
            .inputs
            .rows
            .iter()
            .map(|row| row.iter().zip(&directions[i]).map(|(x, d)| x * d).sum())
            .collect(),
        timed: false,
        ..Series::empty(Kind::Column(DIRECTIONS[i].into()))
    };
    let all = |recording: &TableRecording| {
        let mut all = series(model, recording);
        all.extend((0..DIRECTIONS.len()).map(|i| along(recording, i)));
        all
    };
    recordings.iter().map(all).collect()
}

/// Two principal directions of the rows.
fn directions(rows: &[Vec<f64>]) -> Option<[Vec<f64>; 2]> {
    let width = rows.first()?.len();
    let x = DMatrix::from_fn(rows.len(), width, |row, i| rows[row][i]);
    let eigen = SymmetricEigen::new(x.tr_mul(&x));
    let mut order: Vec<usize> = (0..width).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let direction = |i: &usize| eigen.eigenvectors.column(*i).iter().copied().collect();
    Some([direction(order.first()?), direction(order.get(1)?)])
}

/// Whether a recording was part of the fit: rows of the same file, or half the rows of any.
fn is_part_of(judged: &TableRecording, fitted: &TableRecording) -> bool {
    // A row is known by its time, if it has one, and its inputs.
    let keys = |recording: &TableRecording| -> Vec<Vec<u64>> {
        let rows = recording.inputs.rows.iter().enumerate();
        let key = rows.map(|(i, row)| recording.inputs.times.get(i).into_iter().chain(row));
        key.map(|values| values.map(|value| value.to_bits()).collect()).collect()
    };
    let known: BTreeSet<Vec<u64>> = keys(fitted).into_iter().collect();
    let rows = keys(judged);
    let shared = rows.iter().filter(|row| known.contains(*row)).count();
    let most = if judged.inputs.path == fitted.inputs.path { 0 } else { rows.len() / 2 };
    shared > most
}

fn within(model: &TableModel, row: &[f64]) -> bool {
    model.within_range(&single(row))
}

fn single(row: &[f64]) -> Vec<f32> {
    row.iter().map(|value| *value as f32).collect()
}
