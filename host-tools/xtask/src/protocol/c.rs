//! Generated parts of `taxel_frame.h` and of its example.

use taxel::frame::schema::{BITS, FIELDS, Field, Type};

use super::{Part, columns, is_plain, lines, numbers};

/// Presence of a member's values on the wire.
#[derive(Clone, Copy, PartialEq)]
enum Given {
    /// Each value or its own reason.
    Each,
    /// All values, or one reason for all.
    Together,
}

/// Member of `struct taxel_frame`: its values and their columns.
struct Member {
    name: &'static str,
    dimensions: Vec<usize>,
    given: Given,
    columns: Vec<&'static str>,
}

pub fn header() -> Vec<Part> {
    vec![
        ("status", status()),
        ("members", declarations()),
        ("parts", parts()),
        ("absent", absent()),
        ("fields", fields()),
    ]
}

pub fn example() -> Vec<Part> {
    let values = FIELDS.iter().flat_map(members).flat_map(|member| {
        let columns = member.columns.clone();
        columns.into_iter().enumerate().map(move |(i, column)| {
            format!("        print(\"{column}\", frame.{}{});", member.name, index(&member, i))
        })
    });
    vec![("values", lines(values))]
}

fn status() -> String {
    lines(BITS.iter().map(|bit| {
        format!(
            "#define TAXEL_STATUS_{} (UINT32_C(1) << {})",
            bit.constant,
            bit.status.0.trailing_zeros()
        )
    }))
}

fn declarations() -> String {
    lines(FIELDS.iter().flat_map(|field| match field.layout {
        Type::Named(name) => {
            let (field, name) = (field.name, name.to_lowercase());
            vec![format!("    uint8_t has_{field};"), format!("    struct taxel_{name} {field};")]
        }
        _ => members(field).iter().map(declaration).collect(),
    }))
}

fn declaration(member: &Member) -> String {
    let dimensions: String = member.dimensions.iter().map(|n| format!("[{n}]")).collect();
    let columns = match member.columns.as_slice() {
        [first, .., last] if member.columns.len() > 5 => format!("{first} ... {last}"),
        few => few.join(" "),
    };
    format!("    struct taxel_value {}{dimensions}; /* {columns} */", member.name)
}

/// Writes the functions for fields whose parts have one reason together or one each.
fn parts() -> String {
    let functions = FIELDS.iter().filter(|field| members(field).len() > 1).map(|field| {
        let members = members(field);
        let withheld = members.iter().map(|member| {
            format!("        taxel_withheld({}, {}, why);", pointer(member), member.columns.len())
        });
        let read = members.iter().map(|member| format!("    {}", reading(member, "r")));
        format!(
            "static inline void taxel_decode_{}(struct taxel_reader *r, struct taxel_frame *frame) {{\n    \
             if (taxel_choice(r)) {{\n        int8_t why = (int8_t)(taxel_byte(r) & 0x7f);\n{}        return;\n    \
             }}\n{}}}\n",
            field.name,
            lines(withheld),
            lines(read)
        )
    });
    functions.collect()
}

fn absent() -> String {
    lines(FIELDS.iter().flat_map(members).map(|member| {
        let (pointer, count) = (pointer(&member), member.columns.len());
        format!("    taxel_withheld({pointer}, {count}, TAXEL_NOT_SENT);")
    }))
}

fn fields() -> String {
    lines(FIELDS.iter().map(|field| match (field.layout, members(field).as_slice()) {
        (Type::Named(name), _) => {
            let (field, name) = (field.name, name.to_lowercase());
            let has = format!("frame->has_{field} = (uint8_t)taxel_field(&r)");
            format!("    if (({has})) taxel_decode_{name}(&r, &frame->{field});")
        }
        (_, [member]) => format!("    if (taxel_field(&r)) {}", reading(member, "&r")),
        _ => format!("    if (taxel_field(&r)) taxel_decode_{}(&r, frame);", field.name),
    }))
}

fn reading(member: &Member, reader: &str) -> String {
    let function = if member.given == Given::Each { "taxel_each" } else { "taxel_values" };
    format!("{function}({reader}, {}, {});", pointer(member), member.columns.len())
}

fn members(field: &Field) -> Vec<Member> {
    let mut columns = columns(field).into_iter();
    let mut member = |name, layout: &Type| {
        let (given, dimensions) = match layout {
            Type::Result(inner) if is_plain(inner) => (Given::Together, dimensions(inner)),
            layout => (Given::Each, dimensions(layout)),
        };
        let columns = columns.by_ref().take(numbers(layout).unwrap_or(0)).collect();
        Member { name, dimensions, given, columns }
    };
    match field.layout {
        Type::Named(_) => Vec::new(),
        Type::Result(Type::Struct(_, _, parts)) if !parts.iter().all(|part| is_plain(&part.2)) => {
            parts.iter().map(|part| member(part.1, &part.2)).collect()
        }
        layout => vec![member(field.name, &layout)],
    }
}

/// Dimensions of an array of values; a structure counts as one dimension more.
fn dimensions(layout: &Type) -> Vec<usize> {
    match layout {
        Type::Named(_) | Type::F32 => Vec::new(),
        Type::Result(inner) => dimensions(inner),
        Type::Array(inner, length) => [vec![*length], dimensions(inner)].concat(),
        Type::Struct(..) => vec![numbers(layout).unwrap_or(0)],
    }
}

/// Returns a pointer expression to the first value of a member.
fn pointer(member: &Member) -> String {
    match member.dimensions.as_slice() {
        [] => format!("&frame->{}", member.name),
        [_] => format!("frame->{}", member.name),
        [_, rest @ ..] => format!("frame->{}{}", member.name, "[0]".repeat(rest.len())),
    }
}

/// Returns the index expression of the `i`th value of a member.
fn index(member: &Member, i: usize) -> String {
    let mut left = i;
    let mut indices: Vec<String> = Vec::new();
    for n in member.dimensions.iter().rev() {
        indices.insert(0, format!("[{}]", left % n));
        left /= n;
    }
    indices.concat()
}
