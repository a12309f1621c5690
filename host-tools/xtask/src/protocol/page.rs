//! Generated table of flags of the live page.

use taxel::frame::schema::{BITS, Kind};

use super::{Part, lines};

pub fn flags() -> Vec<Part> {
    let flags = BITS.iter().filter_map(|bit| {
        let kind = match bit.kind {
            Kind::Good => "good",
            Kind::Warning => "warn",
            Kind::Fault => "bad",
            Kind::Estimator => return None,
        };
        Some(format!("  {:?}: [{kind:?}, {:?}, {:?}],", bit.name, bit.title, sentence(bit.remedy)))
    });
    vec![("flags", lines(flags))]
}

/// Returns `text` with a capital letter and a full stop, without code quotes.
fn sentence(text: &str) -> String {
    let plain = text.replace('`', "");
    let mut letters = plain.chars();
    letters.next().map_or_else(String::new, |first| match text.starts_with('`') {
        // A command in code quotes keeps its small letter.
        true => plain.clone() + ".",
        false => first.to_uppercase().chain(letters).chain(['.']).collect(),
    })
}
