//! Names of the stream's fields, as the command line and the files use them.

use taxel::frame::Fields;

/// Every name and what it stands for.
pub const NAMES: [(&str, Fields); 11] = [
    ("codes", Fields::CODES),
    ("signals", Fields::SIGNALS),
    ("sensors", Fields::SENSORS),
    ("force", Fields::FORCE),
    ("point", Fields::POINT),
    ("slip", Fields::SLIP),
    ("torsion", Fields::TORSION),
    ("contacts", Fields::CONTACTS),
    ("uncertainty", Fields::UNCERTAINTY),
    ("estimates", Fields::ESTIMATES),
    ("all", Fields::ALL),
];

/// A word in a list of fields that is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no field; choose from codes, signals, sensors, force, point, slip, torsion, contacts, \
     uncertainty, estimates, all"
)]
pub struct UnknownField(String);

/// Reads a list such as `force,point`.
///
/// # Errors
/// The first word that is no field.
pub fn parse(list: &str) -> Result<Fields, UnknownField> {
    list.split(',').map(str::trim).try_fold(Fields(0), |chosen, word| {
        let (_, field) = NAMES
            .iter()
            .find(|(name, _)| *name == word)
            .ok_or_else(|| UnknownField(word.to_owned()))?;
        Ok(Fields(chosen.0 | field.0))
    })
}

/// The list that [`parse`] reads back.
#[must_use]
pub fn list(fields: Fields) -> String {
    let single = NAMES.iter().filter(|(_, field)| field.0.is_power_of_two());
    let names: Vec<_> =
        single.filter(|(_, field)| fields.contains(*field)).map(|(name, _)| *name).collect();
    names.join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_reads_back_as_the_same_fields() {
        for fields in (1..=Fields::ALL.0).map(Fields) {
            assert_eq!(parse(&list(fields)), Ok(fields));
        }
        assert_eq!(parse("estimates"), Ok(Fields::ESTIMATES));
        assert_eq!(parse("force, point").unwrap().0, Fields::FORCE.0 | Fields::POINT.0);
    }

    #[test]
    fn an_unknown_field_is_named() {
        assert!(parse("force,torque").unwrap_err().to_string().starts_with("`torque` is no field"));
        assert!(parse("").is_err());
    }
}
