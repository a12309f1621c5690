//! Rows as protobuf messages, in MCAP files and live, with a schema made from the columns.
//!
//! ```text
//! message Frame {
//!   oneof t_us_given { uint64 t_us = 1; }
//!   oneof fx_n_given { float fx_n = 2; NoValue fx_n_withheld = 3; }
//!   …
//! }
//! ```
//! Every column is a `oneof`, so that a reader can tell a missing value from zero. A measured
//! column holds its value or the reason for a missing one.

use crate::frames::{Cell, Column, Kind, reason};
use prost::Message;
use prost::encoding::{decode_key, float, int32, skip_field, uint64};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet, OneofDescriptorProto,
};
use taxel::measured::NoValue;

/// Full name of the message.
pub const NAME: &str = "taxel.Frame";
/// Prefix of a topic; the finger's serial number follows.
const TOPIC: &str = "/taxel/";
const WITHHELD: &str = "_withheld";
const GIVEN: &str = "_given";
/// Number of the first reason, because zero means nothing in enums of proto3.
const FIRST_REASON: i32 = 1;

/// Returns a column's tags: its field, and the field of its reason if measured.
///
/// Tags count from 1, two for each column.
fn tags(column: usize) -> (u32, u32) {
    let first = 2 * column as u32 + 1;
    (first, first + 1)
}

/// Returns the topic of a finger: the serial number as one segment of Foxglove's path.
#[must_use]
pub fn topic(serial: &str) -> String {
    let segment = serial
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' });
    format!("{TOPIC}{}", segment.collect::<String>())
}

/// Encodes the schema for MCAP and Foxglove: a serialised `FileDescriptorSet`.
#[must_use]
pub fn descriptor(columns: &[Column]) -> Vec<u8> {
    let mut message = DescriptorProto { name: Some("Frame".to_owned()), ..Default::default() };
    for (at, column) in columns.iter().enumerate() {
        let (value, withheld) = tags(at);
        let kind = if column.kind == Kind::Whole { Type::Uint64 } else { Type::Float };
        message.oneof_decl.push(OneofDescriptorProto {
            name: Some(format!("{}{GIVEN}", column.name)),
            options: None,
        });
        message.field.push(field(&column.name, value, kind, at));
        if column.kind == Kind::Measured {
            let name = format!("{}{WITHHELD}", column.name);
            let mut field = field(&name, withheld, Type::Enum, at);
            field.type_name = Some(".taxel.NoValue".to_owned());
            message.field.push(field);
        }
    }
    let reasons = (FIRST_REASON..).zip(NoValue::ALL);
    let reasons = reasons.map(|(number, why)| (number, constant(reason(why))));
    let values = [(0, "NONE".to_owned())].into_iter().chain(reasons);
    let file = FileDescriptorProto {
        name: Some("taxel/frame.proto".to_owned()),
        package: Some("taxel".to_owned()),
        message_type: vec![message],
        enum_type: vec![EnumDescriptorProto {
            name: Some("NoValue".to_owned()),
            value: values
                .map(|(number, name)| EnumValueDescriptorProto {
                    name: Some(name),
                    number: Some(number),
                    options: None,
                })
                .collect(),
            ..Default::default()
        }],
        syntax: Some("proto3".to_owned()),
        ..Default::default()
    };
    FileDescriptorSet { file: vec![file] }.encode_to_vec()
}

fn field(name: &str, number: u32, kind: Type, oneof: usize) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number as i32),
        label: Some(Label::Optional.into()),
        r#type: Some(kind.into()),
        oneof_index: Some(oneof as i32),
        json_name: Some(name.to_owned()),
        ..Default::default()
    }
}

/// Formats a reason as a protobuf constant: `no contact` becomes `NO_CONTACT`.
fn constant(words: &str) -> String {
    words.to_uppercase().replace([' ', '-'], "_")
}

/// Recovers the columns of a schema.
pub(crate) fn columns(descriptor: &[u8]) -> Option<Vec<Column>> {
    let file = FileDescriptorSet::decode(descriptor).ok()?.file.into_iter().next()?;
    let message = file.message_type.into_iter().next()?;
    let names: Vec<_> = message.field.iter().map(|field| field.name()).collect();
    let mut columns = Vec::new();
    for field in &message.field {
        let (value, withheld) = tags(columns.len());
        let kind = match field.r#type() {
            Type::Uint64 => Kind::Whole,
            Type::Float if names.contains(&format!("{}{WITHHELD}", field.name()).as_str()) => {
                Kind::Measured
            }
            Type::Float => Kind::Real,
            Type::Enum if columns.last().is_some_and(|c: &Column| c.kind == Kind::Measured) => {
                continue;
            }
            _ => return None,
        };
        if field.number() != value as i32 && field.number() != withheld as i32 {
            return None;
        }
        columns.push(Column { name: field.name().to_owned(), kind });
    }
    Some(columns)
}

/// Encodes a row as a message of that schema.
pub fn encode(row: &[Cell], message: &mut Vec<u8>) {
    message.clear();
    for (at, cell) in row.iter().enumerate() {
        let (value, withheld) = tags(at);
        match cell {
            Cell::Empty => {}
            Cell::Whole(whole) => uint64::encode(value, whole, message),
            Cell::Real(real) => float::encode(value, real, message),
            Cell::Withheld(reason) => {
                int32::encode(withheld, &(FIRST_REASON + *reason as i32), message);
            }
        }
    }
}

/// Decodes a message; `None` if it does not match the schema.
pub(crate) fn decode(mut message: &[u8], columns: &[Column]) -> Option<Vec<Cell>> {
    let mut row = vec![Cell::Empty; columns.len()];
    let context = prost::encoding::DecodeContext::default();
    while !message.is_empty() {
        let (tag, wire) = decode_key(&mut message).ok()?;
        let (at, second) = ((tag as usize - 1) / 2, tag.is_multiple_of(2));
        let Some((cell, column)) = row.get_mut(at).zip(columns.get(at)) else {
            skip_field(wire, tag, &mut message, context.clone()).ok()?;
            continue;
        };
        *cell = if second {
            let mut number = 0;
            int32::merge(wire, &mut number, &mut message, context.clone()).ok()?;
            let at = usize::try_from(number - FIRST_REASON).ok()?;
            Cell::Withheld(*NoValue::ALL.get(at)?)
        } else if column.kind == Kind::Whole {
            let mut whole = 0;
            uint64::merge(wire, &mut whole, &mut message, context.clone()).ok()?;
            Cell::Whole(whole)
        } else {
            let mut real = 0.0;
            float::merge(wire, &mut real, &mut message, context.clone()).ok()?;
            Cell::Real(real)
        };
    }
    Some(row)
}
