//! Generated parts of the client's `messages.py` and `table.py`.

use taxel::frame::Fields;
use taxel::frame::schema::{BITS, CSV, FIELDS, Field, Group, Member, Type};

use super::{Part, columns, is_plain, lines, structures};

pub fn messages() -> Vec<Part> {
    vec![("masks", masks()), ("values", values()), ("frame", members()), ("readers", readers())]
}

pub fn table() -> Vec<Part> {
    vec![("columns", groups())]
}

fn masks() -> String {
    let bits = BITS
        .iter()
        .map(|bit| format!("    {} = 1 << {}", bit.constant, bit.status.0.trailing_zeros()));
    let fields = FIELDS.iter().map(|field| {
        format!("    {} = 1 << {}", field.name.to_uppercase(), field.mask.0.trailing_zeros())
    });
    let estimates = Fields::ESTIMATES;
    let estimates = FIELDS.iter().filter(|field| estimates.contains(field.mask));
    let estimates = estimates.map(|field| field.name.to_uppercase()).collect::<Vec<_>>();
    format!(
        "class Status(IntFlag):\n    \"\"\"State of a frame and the estimators that ran for it. Bits that this \
         package does not know are\n    kept.\"\"\"\n\n{}\n\nclass Fields(IntFlag):\n    \"\"\"Selection of fields: \
         those that a frame carries.\"\"\"\n\n{}    ESTIMATES = {}\n    ALL = (1 << {}) - 1\n\n\n",
        lines(bits),
        lines(fields),
        estimates.join(" | "),
        FIELDS.len()
    )
}

fn values() -> String {
    let classes = structures().into_iter().map(|(name, layout)| {
        let Type::Struct(_, meaning, members) = layout else { return String::new() };
        let members = members
            .iter()
            .map(|Member(name, _, layout)| format!("    {name}: {}", annotation(layout)));
        format!("class {name}(NamedTuple):\n{}\n{}", docstring(meaning), lines(members))
    });
    classes.collect::<Vec<_>>().join("\n\n") + "\n\n"
}

/// Formats a docstring in lines of at most 110 characters.
fn docstring(meaning: &str) -> String {
    let mut text = vec!["    \"\"\"".to_owned()];
    for word in meaning.split(' ') {
        let last = text.len() - 1;
        let room = text[last].chars().count() + word.chars().count() < 104;
        if !room {
            text.push(format!("    {word}"));
        } else {
            let space = if text[last].ends_with("\"\"\"") { "" } else { " " };
            text[last] += &format!("{space}{word}");
        }
    }
    text.join("\n") + "\"\"\"\n"
}

fn members() -> String {
    lines(FIELDS.iter().map(|field| {
        let default = if field.tail { " = None" } else { "" };
        format!("    {}: {} | None{default}", attribute(field), annotation(&field.layout))
    }))
}

fn annotation(layout: &Type) -> String {
    match layout {
        Type::Named(name) | Type::Struct(name, ..) => (*name).to_owned(),
        Type::F32 => "float".to_owned(),
        Type::Result(inner) => format!("{} | NoValue", annotation(inner)),
        Type::Array(inner, 2) => format!("tuple[{0}, {0}]", annotation(inner)),
        Type::Array(inner, _) => format!("tuple[{}, ...]", annotation(inner)),
    }
}

/// Name of a field's attribute; a single number carries its unit in it.
fn attribute(field: &Field) -> &'static str {
    match (field.layout, columns(field).as_slice()) {
        (Type::Result(Type::F32), [column]) => column,
        _ => field.name,
    }
}

fn readers() -> String {
    let structures = structures().into_iter().map(|(name, layout)| {
        let Type::Struct(_, _, members) = layout else { return String::new() };
        let function = name.to_lowercase();
        let head = format!("def _{function}(data: bytes, at: int) -> tuple[{name}, int]:\n");
        if members.iter().all(|member| matches!(member.2, Type::F32)) {
            // One read of all numbers is faster.
            let numbers = format!("_{}_F32", function.to_uppercase());
            return format!(
                "{numbers} = read.array(\"<{}f\")\n\n\n{head}    values, at = {numbers}(data, at)\n    return {name}(*values), at\n",
                members.len()
            );
        }
        let reads = members.iter().map(|Member(name, _, layout)| {
            format!("    {name}, at = {}(data, at)", reader(layout))
        });
        let names = members.iter().map(|member| member.0).collect::<Vec<_>>().join(", ");
        format!("{head}{}    return {name}({names}), at\n", lines(reads))
    });
    let structures = structures.collect::<Vec<_>>().join("\n\n");
    let constants = FIELDS.iter().map(|field| {
        let of = reader(&field.layout);
        let of = if field.tail { of } else { format!("read.option({of})") };
        format!("_{}_FIELD = {of}", field.name.to_uppercase())
    });
    let mut frame = "def _frame(data: bytes, at: int) -> tuple[Frame, int]:\n    seq, at = read.varint(data, at)\n    \
                     time, at = read.varint(data, at)\n    status, at = read.varint(data, at)\n"
        .to_owned();
    for field in FIELDS {
        let (name, upper) = (field.name, field.name.to_uppercase());
        frame += &if field.tail {
            format!("    {name}, at = _tail(_{upper}_FIELD, data, at)\n")
        } else {
            format!("    {name}, at = _{upper}_FIELD(data, at)\n")
        };
    }
    let names = FIELDS.iter().map(|field| format!("        {},", field.name));
    format!(
        "{structures}\n\n{}\n\n{frame}    return (\n        Frame(\n            seq,\n            time,\n            \
         Status(status),\n{}        ),\n        at,\n    )\n\n\n",
        lines(constants),
        lines(names.map(|name| format!("    {name}")))
    )
}

fn reader(layout: &Type) -> String {
    match layout {
        Type::Named(name) | Type::Struct(name, ..) => format!("_{}", name.to_lowercase()),
        Type::F32 => "read.f32".to_owned(),
        Type::Result(Type::F32) => "_number".to_owned(),
        Type::Result(inner) => format!("_measured({})", reader(inner)),
        Type::Array(inner, 2) if is_plain(inner) => format!("_pair({})", reader(inner)),
        Type::Array(inner, length) => format!("read.times({length}, {})", reader(inner)),
    }
}

fn groups() -> String {
    lines(CSV.iter().flat_map(|group| match group {
        Group::Flag { column, bit, with } => {
            let bit = BITS.iter().find(|known| known.status == *bit).map_or("", |bit| bit.constant);
            let with = FIELDS.iter().find(|field| field.mask == *with);
            let with = with
                .map_or("Fields(0)".to_owned(), |f| format!("Fields.{}", f.name.to_uppercase()));
            vec![format!("    _Flag({column:?}, Status.{bit}, {with}),")]
        }
        Group::Field(mask) => {
            FIELDS.iter().filter(|f| f.mask == *mask).flat_map(of_field).collect()
        }
    }))
}

fn of_field(field: &Field) -> Vec<String> {
    let row = match field.layout {
        Type::Named(name) => format!("_{}", name.to_lowercase()),
        layout => format!("lambda frame: _flat(frame.{}, {})", attribute(field), shape(&layout)),
    };
    let mut names = vec![String::new()];
    for name in columns(field) {
        match names.last_mut() {
            Some(last) if last.len() + name.len() <= 97 => *last += &format!("{name} "),
            _ => names.push(format!("{name} ")),
        }
    }
    let mut text = vec![
        "    _Field(".to_owned(),
        format!("        Fields.{},", field.name.to_uppercase()),
        format!("        {row},"),
    ];
    let last = names.len() - 1;
    names[last] = names[last].trim_end().to_owned();
    let names = names.iter().map(|names| format!("        {names:?}")).collect::<Vec<_>>();
    text.push(names.join("\n") + ",");
    text.push("    ),".to_owned());
    text
}

/// Formats the shape of a value's numbers: 1, or a tuple of shapes.
fn shape(layout: &Type) -> String {
    let tuple = |shapes: Vec<String>| {
        format!("({}{})", shapes.join(", "), if shapes.len() == 1 { "," } else { "" })
    };
    match layout {
        Type::Named(_) | Type::F32 => "1".to_owned(),
        Type::Result(inner) => shape(inner),
        Type::Array(inner, length) => tuple(vec![shape(inner); *length]),
        Type::Struct(_, _, members) => {
            tuple(members.iter().map(|member| shape(&member.2)).collect())
        }
    }
}
