//! Generated tables of `docs/protocol.md` and `docs/read-the-numbers.md`.

use taxel::frame::Fields;
use taxel::frame::schema::{BITS, Bit, CSV, FIELDS, Group, HEAD, Kind, Row, Type};

use super::{Part, lines, structures};

pub fn protocol() -> Vec<Part> {
    vec![("frame", frame()), ("status", status())]
}

pub fn manual() -> Vec<Part> {
    vec![("columns", columns()), ("flags", flags())]
}

fn frame() -> String {
    let mut text = "```\nstruct Frame {\n  seq: u32, time_us: u64, status: u32,\n".to_owned();
    for field in FIELDS {
        let kind = if field.tail { "tail" } else { "option" };
        let member = format!("{}: {kind}<{}>,", field.name, name(&field.layout));
        text += &format!("  {member:<48} mask bit {}\n", field.mask.0.trailing_zeros());
    }
    text += "}\n";
    for (structure, layout) in structures() {
        if let Type::Struct(_, _, members) = layout {
            let members = members.iter().map(|member| format!("{}: {}", member.0, name(&member.2)));
            let members = members.collect::<Vec<_>>().join(", ");
            text += &format!("struct {structure} {{ {members} }}\n");
        }
    }
    text + "```\n"
}

fn name(layout: &Type) -> String {
    match layout {
        Type::Named(name) | Type::Struct(name, ..) => (*name).to_owned(),
        Type::F32 => "f32".to_owned(),
        Type::Result(inner) => format!("result<{}, NoValue>", name(inner)),
        Type::Array(inner, length) => format!("[{}; {length}]", name(inner)),
    }
}

fn status() -> String {
    let rows = BITS.iter().map(|Bit { status, name, meaning, .. }| {
        format!("| {} | {name} | {meaning} |", status.0.trailing_zeros())
    });
    table("| bit | name | meaning |\n|---|---|---|\n", rows)
}

fn columns() -> String {
    let quoted = |Row(name, unit, meaning): &Row| {
        format!("| `{name}` | {unit}{}| {meaning} |", if unit.is_empty() { "" } else { " " })
    };
    let fields = CSV.iter().flat_map(|group| match group {
        Group::Field(mask) => {
            let field = FIELDS.iter().filter(|field| field.mask == *mask);
            let rows = field.flat_map(|field| field.rows);
            rows.map(|Row(names, unit, meaning)| format!("| {names} | {unit} | {meaning} |"))
                .collect()
        }
        Group::Flag { column, bit, with } if *with == Fields::empty() => {
            let bit = BITS.iter().filter(|known| known.status == *bit);
            bit.map(|bit| quoted(&Row(column, "0, 1", bit.meaning))).collect::<Vec<_>>()
        }
        // The rows of the flag's field list it.
        Group::Flag { .. } => Vec::new(),
    });
    let rows = HEAD.iter().map(quoted).chain(fields);
    table("| column | unit | meaning |\n|---|---|---|\n", rows)
}

fn flags() -> String {
    let flags = BITS.iter().filter(|bit| bit.kind != Kind::Estimator);
    let rows = flags.map(|Bit { name, meaning, remedy, .. }| {
        format!("| `{name}` | {meaning} | {remedy}{}|", if remedy.is_empty() { "" } else { " " })
    });
    let ran = "| `ran-…` | estimators that ran for this frame | nothing: without contact most do not run |";
    table("| flag | what it means | what to do |\n|---|---|---|\n", rows.chain([ran.to_owned()]))
}

fn table(head: &str, rows: impl Iterator<Item = String>) -> String {
    head.to_owned() + &lines(rows)
}
