//! What the finger said as a row of named columns: the same in every kind of recording.
//!
//! `t_us seq status`, then a column for every value of the chosen fields, unit in the name. A cell is
//! empty where the frame does not carry its field or the finger has no such channel, and holds the reason
//! where the finger withheld the value.

use std::fmt;

use taxel::estimate::{Force, Uncertainty};
use taxel::frame::{Fields, Frame, Status};
use taxel::measured::{Measured, NoValue};
use taxel::scan::{ROWS, SENSORS, TAXELS};

use crate::trace::{bridge_names, sensor_truth_names, taxel_names};

/// A column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Its name, unit included.
    pub name: String,
    /// What its cells hold.
    pub kind: Kind,
}

/// What the cells of a column hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Whole numbers.
    Whole,
    /// Real numbers.
    Real,
    /// Real numbers, or the reason why there is none.
    Measured,
}

/// A value in a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cell {
    /// Not asked for, or no such channel.
    Empty,
    /// Of a [`Kind::Whole`] column.
    Whole(u64),
    /// Of the other two.
    Real(f32),
    /// Of a [`Kind::Measured`] column: withheld, and why.
    Withheld(NoValue),
}

/// As it stands in a CSV file: nothing where there is no value.
impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty | Self::Withheld(_) => Ok(()),
            Self::Whole(value) => value.fmt(f),
            Self::Real(value) => value.fmt(f),
        }
    }
}

/// The words for the reasons, as files and pages use them.
#[must_use]
pub const fn reason(reason: NoValue) -> &'static str {
    match reason {
        NoValue::Uncalibrated => "uncalibrated",
        NoValue::NoContact => "no contact",
        NoValue::Saturated => "saturated",
        NoValue::DeadChannel => "dead channel",
        NoValue::OutOfTrainedRange => "out of trained range",
        NoValue::IllConditioned => "ill-conditioned",
        NoValue::Absent => "absent",
        NoValue::NotEstimated => "not estimated",
    }
}

/// The columns of frames with these fields.
#[must_use]
pub fn columns(fields: Fields) -> Vec<Column> {
    let on = |field| fields.contains(field);
    let mut columns = Vec::new();
    let mut add = |kind: Kind, names: &[&str]| {
        columns.extend(names.iter().map(|name| Column { name: (*name).to_owned(), kind }));
    };
    add(Kind::Whole, &["t_us", "seq", "status"]);
    if on(Fields::FORCE) {
        add(Kind::Measured, &["fx_n", "fy_n", "fz_n"]);
    }
    if on(Fields::POINT) {
        add(Kind::Measured, &["x_mm", "y_mm"]);
    }
    if on(Fields::TORSION) {
        add(Kind::Measured, &["torsion_nmm"]);
    }
    add(Kind::Whole, &["contact"]);
    if on(Fields::SLIP) {
        add(Kind::Whole, &["slip"]);
        add(Kind::Measured, &["slip_margin", "friction", "grip_n"]);
    }
    if on(Fields::CONTACTS) {
        for i in ["1", "2"] {
            let names = ["x_mm", "y_mm", "fz_n"].map(|value| format!("contact{i}_{value}"));
            add(Kind::Measured, &names.each_ref().map(String::as_str));
        }
    }
    if on(Fields::UNCERTAINTY) {
        add(Kind::Measured, &["fx_sigma_n", "fy_sigma_n", "fz_sigma_n"]);
        add(Kind::Measured, &["x_sigma_mm", "y_sigma_mm", "misfit"]);
    }
    let mut add = |kind: Kind, names: Vec<String>| {
        columns.extend(names.into_iter().map(|name| Column { name, kind }));
    };
    if on(Fields::SENSORS) {
        add(Kind::Measured, (0..SENSORS).flat_map(sensor_truth_names).collect());
    }
    if on(Fields::SIGNALS) {
        add(Kind::Real, (0..TAXELS).map(|k| format!("c_r{}c{}", k / 4, k % 4)).collect());
        let bridge = |i| ["x", "y", "z"].map(|u| format!("s{i}_u{u}"));
        add(Kind::Real, (0..SENSORS).flat_map(bridge).collect());
        add(Kind::Whole, ["saturated", "dead", "bridge_faults"].map(str::to_owned).into());
    }
    if on(Fields::CODES) {
        add(Kind::Whole, taxel_names(ROWS));
        add(Kind::Whole, (0..SENSORS).flat_map(bridge_names).collect());
        add(Kind::Whole, ["aux_vref", "aux_temp"].map(str::to_owned).into());
    }
    columns
}

/// Appends the cells of a frame, one for each of [`columns`].
pub fn cells(frame: &Frame, fields: Fields, row: &mut Vec<Cell>) {
    row.extend([frame.time.0, frame.seq.into(), frame.status.0.into()].map(Cell::Whole));
    let on = |field| fields.contains(field);
    if on(Fields::FORCE) {
        push_force(row, frame.force);
    }
    if on(Fields::POINT) {
        row.push(measured(frame.point, |point| point.x.0));
        row.push(measured(frame.point, |point| point.y.0));
    }
    if on(Fields::TORSION) {
        row.push(measured(frame.torsion, |torsion| torsion.0));
    }
    row.push(Cell::Whole(frame.status.contains(Status::CONTACT).into()));
    if on(Fields::SLIP) {
        row.push(Cell::Whole(frame.status.contains(Status::SLIDES).into()));
        row.push(measured(frame.slip, |verdict| verdict.margin));
        row.push(measured(frame.slip, |verdict| verdict.friction));
        row.push(measured(frame.slip, |verdict| verdict.grip.0));
    }
    if on(Fields::CONTACTS) {
        for i in 0..2 {
            row.push(measured(frame.contacts, |contacts| contacts[i].point.x.0));
            row.push(measured(frame.contacts, |contacts| contacts[i].point.y.0));
            row.push(measured(frame.contacts, |contacts| contacts[i].normal.0));
        }
    }
    if on(Fields::UNCERTAINTY) {
        push_uncertainty(row, frame.uncertainty);
    }
    if on(Fields::SENSORS) {
        for i in 0..SENSORS {
            push_force(row, frame.sensors.map(|sensors| sensors[i]));
        }
    }
    if on(Fields::SIGNALS) {
        push_signals(row, frame);
    }
    if on(Fields::CODES) {
        push_codes(row, frame);
    }
}

fn measured<T>(value: Option<Measured<T>>, part: impl Fn(T) -> f32) -> Cell {
    match value {
        None => Cell::Empty,
        Some(Ok(value)) => Cell::Real(part(value)),
        Some(Err(reason)) => Cell::Withheld(reason),
    }
}

fn push_force(row: &mut Vec<Cell>, force: Option<Force>) {
    let axis = |axis: fn(Force) -> Measured<taxel::units::Newtons>| {
        measured(force.map(axis), |newtons| newtons.0)
    };
    row.extend([axis(|f| f.x), axis(|f| f.y), axis(|f| f.z)]);
}

fn push_uncertainty(row: &mut Vec<Cell>, uncertainty: Option<Measured<Uncertainty>>) {
    let (force, rest) = match uncertainty {
        None => (None, None),
        Some(Err(reason)) => (Some(Force::none(reason)), Some((Err(reason), Err(reason)))),
        Some(Ok(known)) => (Some(known.force), Some((known.point, known.misfit))),
    };
    push_force(row, force);
    let (point, misfit) = rest.unzip();
    row.push(measured(point, |point| point.x.0));
    row.push(measured(point, |point| point.y.0));
    row.push(measured(misfit, |misfit| misfit));
}

fn push_signals(row: &mut Vec<Cell>, frame: &Frame) {
    let real = |value: Option<f32>| value.map_or(Cell::Empty, Cell::Real);
    let taxels = frame.signals.and_then(|signals| signals.taxels);
    row.extend((0..TAXELS).map(|k| real(taxels.map(|c| c[k]))));
    for i in 0..SENSORS {
        let bridge = frame.signals.and_then(|signals| signals.bridges[i]);
        row.extend((0..3).map(|axis| real(bridge.map(|u| u[axis]))));
    }
    let health = frame.signals.map(|signals| signals.health);
    let bits = |bits: Option<u16>| bits.map_or(Cell::Empty, |bits| Cell::Whole(bits.into()));
    row.push(bits(health.map(|health| health.saturated)));
    row.push(bits(health.map(|health| health.dead)));
    row.push(bits(health.map(|health| health.bridge_faults.into())));
}

fn push_codes(row: &mut Vec<Cell>, frame: &Frame) {
    let code = |code: Option<taxel::units::Code>| {
        code.map_or(Cell::Empty, |code| Cell::Whole(code.0.into()))
    };
    let taxels = frame.codes.and_then(|codes| codes.taxels);
    row.extend((0..TAXELS).map(|k| code(taxels.map(|t| t.lit[k / 4][k % 4]))));
    row.extend((0..4).map(|c| code(taxels.map(|t| t.dark[c]))));
    for i in 0..SENSORS {
        let bridge = frame.codes.and_then(|codes| codes.bridges[i]);
        row.extend([
            code(bridge.map(|m| m.a)),
            code(bridge.map(|m| m.b)),
            code(bridge.map(|m| m.c)),
            code(bridge.map(|m| m.d)),
        ]);
    }
    row.push(code(frame.codes.and_then(|codes| codes.reference)));
    row.push(code(frame.codes.and_then(|codes| codes.temperature)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_has_a_cell_whatever_the_fields() {
        for fields in (0..=Fields::ALL.0).map(Fields) {
            let mut row = Vec::new();
            cells(&Frame::default(), fields, &mut row);
            assert_eq!(row.len(), columns(fields).len(), "{fields:?}");
        }
    }
}
