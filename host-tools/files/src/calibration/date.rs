//! A record's date, seconds since 1970-01-01 UTC, as people write it (RFC 3339).

use std::time::{Duration, UNIX_EPOCH};

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serializer};

/// 9999-12-31, the last date that RFC 3339 can write.
const LAST: u64 = 253_402_300_799;

/// Like `2026-11-21T09:30:00Z`.
#[must_use]
pub fn to_text(seconds: u64) -> String {
    let time = UNIX_EPOCH + Duration::from_secs(seconds.min(LAST));
    humantime::format_rfc3339_seconds(time).to_string()
}

/// The same back.
///
/// # Errors
/// It is no date.
pub fn from_text(text: &str) -> Result<u64, String> {
    humantime::parse_rfc3339(text)
        .ok()
        .and_then(|time| time.duration_since(UNIX_EPOCH).ok())
        .map(|since| since.as_secs())
        .ok_or_else(|| format!("`{text}` is not a date like 2026-11-21T09:30:00Z"))
}

/// For `#[serde(with = …)]`.
///
/// # Errors
/// What the serializer says.
pub fn serialize<S: Serializer>(seconds: &u64, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(&to_text(*seconds))
}

/// For `#[serde(with = …)]`.
///
/// # Errors
/// What the deserializer says, or it is no date.
pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<u64, D::Error> {
    from_text(&String::deserialize(from)?).map_err(D::Error::custom)
}
