//! Frames as rows of named columns, the same in every kind of recording.
//!
//! A row has `t_us seq status`, then a column for every value of the chosen fields, with its unit
//! in the name. A cell is empty if the frame lacks its field or the finger lacks the channel. A
//! missing value leaves the reason in its cell. [`taxel::frame::schema`] defines the columns and
//! their order.

use std::fmt;

use taxel::condition::{Health, Signals};
use taxel::estimate::slip::Verdict;
use taxel::estimate::{ContactPoint, Force, NormalContact, Uncertainty};
use taxel::frame::schema::{CSV, Columns, FIELDS, Group, HEAD, Row};
use taxel::frame::{Fields, Frame, Status};
use taxel::measured::{Measured, NoValue};
use taxel::scan::{Codes, Midpoints, SENSORS, TAXELS};
use taxel::units::{Code, Micros, Millimetres, NewtonMillimetres, Newtons};

/// Name and kind of a column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Name with its unit.
    pub name: String,
    /// Content of its cells.
    pub kind: Kind,
}

/// Kind of a column's cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Whole numbers.
    Whole,
    /// Real numbers.
    Real,
    /// Real numbers, or the reason for a missing one.
    Measured,
}

/// Cell of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cell {
    /// Field not requested, or no such channel.
    Empty,
    /// Value of a [`Kind::Whole`] column.
    Whole(u64),
    /// Value of a [`Kind::Real`] or [`Kind::Measured`] column.
    Real(f32),
    /// Reason of a missing value in a [`Kind::Measured`] column.
    Withheld(NoValue),
}

/// Formats the cell as in a CSV file; a missing value is empty.
impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty | Self::Withheld(_) => Ok(()),
            Self::Whole(value) => value.fmt(f),
            Self::Real(value) => value.fmt(f),
        }
    }
}

/// Returns a reason in the words of files and pages.
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

/// Lists the columns of frames with these fields.
#[must_use]
pub fn columns(fields: Fields) -> Vec<Column> {
    let whole = |name: &str| Column { name: name.to_owned(), kind: Kind::Whole };
    let mut columns: Vec<_> = HEAD.map(|Row(name, ..)| whole(name)).into();
    for group in CSV {
        match group {
            Group::Flag { column, with, .. } if fields.contains(with) => {
                columns.push(whole(column))
            }
            Group::Field(field) if fields.contains(field) => columns.extend(columns_of(field)),
            Group::Flag { .. } | Group::Field(_) => {}
        }
    }
    columns
}

fn columns_of(field: Fields) -> impl Iterator<Item = Column> {
    let parts = FIELDS.iter().filter(move |known| known.mask == field).flat_map(|f| f.columns);
    parts.flat_map(|part| {
        let (kind, names) = match part {
            Columns::Whole(names) => (Kind::Whole, names),
            Columns::Real(names) => (Kind::Real, names),
            Columns::Measured(names) => (Kind::Measured, names),
        };
        names.split_whitespace().map(move |name| Column { name: name.to_owned(), kind })
    })
}

/// Appends the cells of a frame, one for each of [`columns`].
pub fn cells(frame: &Frame, fields: Fields, row: &mut Vec<Cell>) {
    row.extend([frame.time.0, frame.seq.into(), frame.status.0.into()].map(Cell::Whole));
    for group in CSV {
        match group {
            Group::Flag { bit, with, .. } if fields.contains(with) => {
                row.push(Cell::Whole(frame.status.contains(bit).into()));
            }
            Group::Field(field) if fields.contains(field) => push_field(frame, field, row),
            Group::Flag { .. } | Group::Field(_) => {}
        }
    }
}

macro_rules! fields {
    (
        head {
            codes: $codes:ty = CODES $codes_bit:tt $about:literal $more:tt
            $($head:ident: $type:ty = $HEAD:ident $bit:tt $meaning:literal $head_about:tt)*
        }
        tail { $($tail:ident: $last:ty = $TAIL:ident $at:tt $last_meaning:literal $last_about:tt)* }
    ) => {
        fn push_field(frame: &Frame, field: Fields, row: &mut Vec<Cell>) {
            let sent = match field {
                Fields::CODES => frame.codes.map(|codes| push_codes(&codes, row)),
                $(Fields::$HEAD => frame.$head.map(|value| value.push(row)),)*
                $(Fields::$TAIL => frame.$tail.map(|value| value.push(row)),)*
                _ => Some(()),
            };
            if sent.is_none() {
                row.extend(columns_of(field).map(|_| Cell::Empty));
            }
        }

        fn read_field(frame: &mut Frame, field: Fields, row: &mut Cells) {
            match field {
                $(Fields::$HEAD => frame.$head = Some(Value::read(row)),)*
                $(Fields::$TAIL => frame.$tail = Some(Value::read(row)),)*
                _ => {}
            }
        }
    };
}
taxel::frame_fields!(fields);

/// Reader of frames from rows.
///
/// It skips the codes, because a recording with codes can be computed again.
#[derive(Clone, Debug)]
pub struct FrameReader {
    fields: Fields,
    head: [Option<usize>; 3],
    /// Positions of the columns of each field.
    places: Vec<(Fields, Vec<usize>)>,
}

impl FrameReader {
    /// Creates a reader of rows with these columns.
    ///
    /// It reads each field whose first column exists.
    ///
    /// # Errors
    /// A column of a field is missing; the error is its name.
    pub fn new(columns: &[Column]) -> Result<Self, String> {
        let place = |name: &str| columns.iter().position(|column| column.name == name);
        let mut places = Vec::new();
        for field in FIELDS.iter().filter(|field| field.mask != Fields::CODES) {
            let mut names = columns_of(field.mask).map(|column| column.name).peekable();
            if names.peek().is_some_and(|first| place(first).is_some()) {
                let of = names.map(|name| place(&name).ok_or(name)).collect::<Result<_, _>>()?;
                places.push((field.mask, of));
            }
        }
        let fields = places.iter().fold(Fields::empty(), |all, (field, _)| all | *field);
        for Column { name, .. } in self::columns(fields) {
            place(&name).ok_or(name)?;
        }
        Ok(Self { fields, head: HEAD.map(|Row(name, ..)| place(name)), places })
    }

    /// Returns the fields of the rows.
    #[must_use]
    pub fn fields(&self) -> Fields {
        self.fields
    }

    /// Returns the frame of a row.
    #[must_use]
    pub fn frame(&self, row: &[Cell]) -> Frame {
        let cell = |at: usize| row.get(at).copied().unwrap_or(Cell::Empty);
        let [time, seq, status] = self.head.map(|at| at.map_or(Cell::Empty, cell).whole());
        let mut frame = Frame {
            seq: seq as u32,
            time: Micros(time),
            status: Status(status as u32),
            ..Frame::default()
        };
        for (field, places) in &self.places {
            read_field(&mut frame, *field, &mut places.iter().map(|at| cell(*at)));
        }
        frame
    }
}

type Cells<'c> = dyn Iterator<Item = Cell> + 'c;

/// A field's value as cells, one for each of its columns.
trait Value: Sized {
    /// Appends the cells.
    fn push(&self, row: &mut Vec<Cell>);
    /// Reads the value from its cells.
    fn read(row: &mut Cells) -> Self;
}

impl Cell {
    fn measured(value: Measured<f32>) -> Self {
        value.map_or_else(Self::Withheld, Self::Real)
    }

    /// Returns the number of a [`Kind::Measured`] column.
    ///
    /// CSV holds no reasons, so an empty cell reads as not estimated.
    fn value(self) -> Measured<f32> {
        match self {
            Self::Real(value) => Ok(value),
            Self::Withheld(why) => Err(why),
            Self::Whole(_) | Self::Empty => Err(NoValue::NotEstimated),
        }
    }

    fn whole(self) -> u64 {
        match self {
            Self::Whole(value) => value,
            Self::Empty | Self::Real(_) | Self::Withheld(_) => 0,
        }
    }
}

fn next(row: &mut Cells) -> Cell {
    row.next().unwrap_or(Cell::Empty)
}

impl Value for Force {
    fn push(&self, row: &mut Vec<Cell>) {
        row.extend([self.x, self.y, self.z].map(|axis| Cell::measured(axis.map(|n| n.0))));
    }

    fn read(row: &mut Cells) -> Self {
        let [x, y, z] = [(); 3].map(|()| next(row).value().map(Newtons));
        Self { x, y, z }
    }
}

impl Value for [Force; SENSORS] {
    fn push(&self, row: &mut Vec<Cell>) {
        self.iter().for_each(|force| force.push(row));
    }

    fn read(row: &mut Cells) -> Self {
        [(); SENSORS].map(|()| Force::read(row))
    }
}

/// Implements [`Value`] for numbers that share one reason.
macro_rules! together {
    ($($type:ty: $numbers:expr, $of:expr;)*) => {
        $(
            impl Value for Measured<$type> {
                fn push(&self, row: &mut Vec<Cell>) {
                    push_together(self, $numbers, row);
                }

                fn read(row: &mut Cells) -> Self {
                    read_together(row, $of)
                }
            }
        )*
    };
}

together! {
    f32: |number| [*number], |[number]| number;
    ContactPoint: |p| [p.x.0, p.y.0], |[x, y]| ContactPoint { x: Millimetres(x), y: Millimetres(y) };
    Verdict: |v| [v.margin, v.friction, v.grip.0],
        |[margin, friction, grip]| Verdict { margin, friction, grip: Newtons(grip) };
    NewtonMillimetres: |moment| [moment.0], |[moment]| NewtonMillimetres(moment);
    [NormalContact; 2]: |[a, b]| {
        [a.point.x.0, a.point.y.0, a.normal.0, b.point.x.0, b.point.y.0, b.normal.0]
    }, |[ax, ay, a, bx, by, b]| [(a, [ax, ay]), (b, [bx, by])].map(NormalContact::new);
}

fn push_together<T, const N: usize>(
    value: &Measured<T>,
    numbers: impl Fn(&T) -> [f32; N],
    row: &mut Vec<Cell>,
) {
    match value {
        Ok(value) => row.extend(numbers(value).map(Cell::Real)),
        Err(reason) => row.extend([Cell::Withheld(*reason); N]),
    }
}

fn read_together<T, const N: usize>(row: &mut Cells, of: impl Fn([f32; N]) -> T) -> Measured<T> {
    let values = [(); N].map(|()| next(row).value());
    let mut numbers = [0.0; N];
    for (number, value) in numbers.iter_mut().zip(values) {
        *number = value?;
    }
    Ok(of(numbers))
}

impl Value for Measured<Uncertainty> {
    fn push(&self, row: &mut Vec<Cell>) {
        let none = |why| Uncertainty { force: Force::none(why), point: Err(why), misfit: Err(why) };
        let Uncertainty { force, point, misfit } = self.unwrap_or_else(none);
        force.push(row);
        point.push(row);
        misfit.push(row);
    }

    /// Reads one reason for the whole field without contact.
    fn read(row: &mut Cells) -> Self {
        let known = Uncertainty {
            force: Force::read(row),
            point: Measured::read(row),
            misfit: Measured::read(row),
        };
        if known.misfit == Err(NoValue::NoContact) { Err(NoValue::NoContact) } else { Ok(known) }
    }
}

impl Value for Signals {
    fn push(&self, row: &mut Vec<Cell>) {
        let real = |value: Option<f32>| value.map_or(Cell::Empty, Cell::Real);
        row.extend((0..TAXELS).map(|k| real(self.taxels.map(|c| c[k]))));
        for bridge in self.bridges {
            row.extend((0..3).map(|axis| real(bridge.map(|u| u[axis]))));
        }
        let Health { saturated, dead, bridge_faults } = self.health;
        row.extend([saturated, dead, bridge_faults.into()].map(|bits| Cell::Whole(bits.into())));
    }

    /// Reads a matrix or sensor that the finger lacks from its empty cells.
    fn read(row: &mut Cells) -> Self {
        fn all<const N: usize>(row: &mut Cells) -> Option<[f32; N]> {
            read_together(row, |numbers| numbers).ok()
        }
        Self {
            taxels: all(row),
            bridges: [(); SENSORS].map(|()| all(row)),
            health: Health {
                saturated: next(row).whole() as u16,
                dead: next(row).whole() as u16,
                bridge_faults: next(row).whole() as u8,
            },
        }
    }
}

fn push_codes(codes: &Codes, row: &mut Vec<Cell>) {
    let code = |code: Option<Code>| code.map_or(Cell::Empty, |code| Cell::Whole(code.0.into()));
    let taxels = codes.taxels;
    row.extend((0..TAXELS).map(|k| code(taxels.map(|t| t.lit[k / 4][k % 4]))));
    row.extend((0..4).map(|c| code(taxels.map(|t| t.dark[c]))));
    for bridge in codes.bridges {
        let arms = bridge.map_or([None; 4], |Midpoints { a, b, c, d }| [a, b, c, d].map(Some));
        row.extend(arms.map(code));
    }
    row.extend([codes.reference, codes.temperature].map(code));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_has_a_cell_for_any_fields() {
        for fields in (0..=Fields::ALL.0).map(Fields) {
            let mut row = Vec::new();
            cells(&Frame::default(), fields, &mut row);
            assert_eq!(row.len(), columns(fields).len(), "{fields:?}");
        }
    }
}
