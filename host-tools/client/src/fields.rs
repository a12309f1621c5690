//! Names of the stream's fields, as the command line and the files use them.

use taxel::frame::Fields;
use taxel::frame::schema::{FIELD_NAMES, FIELDS};

/// Word in a list of fields that names none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown field `{0}`; choose from {FIELD_NAMES}")]
pub struct UnknownField(String);

/// Reads a list such as `force,point`.
///
/// # Errors
/// The first word is not a field.
pub fn parse(list: &str) -> Result<Fields, UnknownField> {
    list.split(',').map(str::trim).try_fold(Fields::empty(), |chosen, word| {
        let field = match word {
            "estimates" => Some(Fields::ESTIMATES),
            "all" => Some(Fields::ALL),
            _ => FIELDS.iter().find(|field| field.name == word).map(|field| field.mask),
        };
        Ok(chosen | field.ok_or_else(|| UnknownField(word.to_owned()))?)
    })
}

/// Formats fields as a list that [`parse`] reads.
#[must_use]
pub fn list(fields: Fields) -> String {
    let chosen = FIELDS.iter().filter(|field| fields.contains(field.mask));
    chosen.map(|field| field.name).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn field_list_reads_back() {
        for fields in (1..=Fields::ALL.0).map(Fields) {
            assert_eq!(parse(&list(fields)), Ok(fields));
        }
        assert_eq!(parse("estimates"), Ok(Fields::ESTIMATES));
        assert_eq!(parse("force, point"), Ok(Fields::FORCE | Fields::POINT));
    }

    #[test]
    fn unknown_field_is_named() {
        assert!(
            parse("force,torque").unwrap_err().to_string().starts_with("unknown field `torque`")
        );
        assert!(parse("").is_err());
    }
}
