//! Dates of a record: seconds since 1970-01-01 UTC, written in RFC 3339.

use std::time::{Duration, UNIX_EPOCH};

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serializer};

/// Last date of RFC 3339: 9999-12-31.
const LAST: u64 = 253_402_300_799;

/// Formats a date like `2026-11-21T09:30:00Z`.
#[must_use]
pub fn to_text(seconds: u64) -> String {
    let time = UNIX_EPOCH + Duration::from_secs(seconds.min(LAST));
    humantime::format_rfc3339_seconds(time).to_string()
}

/// Parses such a date.
///
/// # Errors
/// The text is no date.
pub fn from_text(text: &str) -> Result<u64, String> {
    humantime::parse_rfc3339(text)
        .ok()
        .and_then(|time| time.duration_since(UNIX_EPOCH).ok())
        .map(|since| since.as_secs())
        .ok_or_else(|| format!("`{text}` is not a date like 2026-11-21T09:30:00Z"))
}

/// Serializes a date, for `#[serde(with = …)]`.
///
/// # Errors
/// The serializer fails.
pub fn serialize<S: Serializer>(seconds: &u64, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(&to_text(*seconds))
}

/// Deserializes a date, for `#[serde(with = …)]`.
///
/// # Errors
/// The deserializer fails, or the text is no date.
pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<u64, D::Error> {
    from_text(&String::deserialize(from)?).map_err(D::Error::custom)
}
