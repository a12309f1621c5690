//! Which finger a recording is of.

use std::collections::BTreeMap;

/// What is known about a recording as a whole.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Facts by name: `board`, `serial`, `firmware`, `full_scale`, `calibration_crc`, ….
    pub facts: BTreeMap<String, String>,
    /// The calibration in force, as the TOML file that `taxel calibrate` writes. Not kept in CSV.
    pub calibration: Option<String>,
}

impl Header {
    /// Sets a fact.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl ToString) -> Self {
        self.facts.insert(name.to_owned(), value.to_string());
        self
    }
}
