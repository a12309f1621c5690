//! Reads a scene from its text, or reports what is wrong with it.
//!
//! A message is one line: the place, what is there, what is allowed and how to mend it.

use std::borrow::Cow;
use std::ops::Range;
use std::path::Path;

use taxel_files::FileError;
use toml::de::{DeTable, DeValue};

use super::{Scene, built_in};

/// Byte range in the text, and the message about it.
pub(super) type Problem = (Range<usize>, String);

/// Tables that may occur several times in a scene.
const SEVERAL: [&str; 8] = ["press", "slide", "tap", "roll", "random", "grid", "plate", "fault"];
/// Tables that may occur once in a scene.
const ONCE: [&str; 10] = [
    "scan",
    "device",
    "material",
    "layer",
    "indenter",
    "friction",
    "light",
    "electronics",
    "temperature",
    "bench",
];

impl Scene {
    /// Loads a built-in scene by its name, or a file by its path.
    ///
    /// # Errors
    /// The scene does not exist or is not valid; the message is one line.
    pub fn load(name_or_path: &str) -> Result<Self, FileError> {
        let (path, text) = text_of(name_or_path)?;
        Self::parse(path, &text)
    }

    /// Parses a scene from its text; `path` is for error messages.
    ///
    /// # Errors
    /// The scene is not valid; the message is one line.
    pub fn parse(path: impl AsRef<Path>, text: &str) -> Result<Self, FileError> {
        let error = |at: Range<usize>, problem: String| {
            FileError::new(&path, problem).line(line_of(text, at.start))
        };
        let syntax = |e: toml::de::Error| {
            error(e.span().unwrap_or_default(), format!("this is not TOML: {}", e.message()))
        };
        let document = DeTable::parse(text).map_err(syntax)?.into_inner();
        if !document.contains_key("scan") {
            return Err(FileError::new(&path, "there is no table [scan]").mend(
                "write `[scan]` and below it, for example, `rate_hz = 1000` and `duration_s = 2`",
            ));
        }
        tables(&document).map_err(|(at, problem)| error(at, problem))?;
        let at_key = |at: Range<usize>, problem: String| {
            let key = key_at(text, &document, at.start);
            let error = error(at, problem);
            match key {
                Some(key) => error.column(key),
                None => error,
            }
        };
        let scene: Self = toml::from_str(text).map_err(|e| {
            let at = e.span().unwrap_or_default();
            at_key(at.clone(), in_words(e.message()).unwrap_or_else(|| words_allowed(text, at, &e)))
        })?;
        scene.check().map_err(|(at, problem)| at_key(at, problem))?;
        Ok(scene)
    }
}

/// Path for messages, and text of a built-in scene or a file.
pub(super) fn text_of(name_or_path: &str) -> Result<(String, Cow<'static, str>), FileError> {
    if let Some((name, text)) = built_in().find(|(name, _)| *name == name_or_path) {
        return Ok((format!("{name}.toml"), text.into()));
    }
    let text = std::fs::read_to_string(name_or_path).map_err(|error| {
        if error.kind() == std::io::ErrorKind::NotFound {
            FileError::new(name_or_path, "no such scene")
                .mend("give a path to a TOML file, or a name that `taxel simulate --list` shows")
        } else {
            FileError::io(name_or_path, &error)
        }
    })?;
    Ok((name_or_path.to_owned(), text.into()))
}

/// Line number of byte `at`, counted from 1.
fn line_of(text: &str, at: usize) -> u64 {
    1 + text.get(..at).unwrap_or(text).matches('\n').count() as u64
}

/// Checks that a table occurs once, or as a list where several are allowed.
fn tables(document: &DeTable<'_>) -> Result<(), Problem> {
    for (key, value) in document {
        let name = key.get_ref().as_ref();
        let is_list = |value: &DeValue<'_>| {
            value.as_array().is_some_and(|list| list.iter().all(|one| one.get_ref().is_table()))
        };
        let value = value.get_ref();
        let problem = if SEVERAL.contains(&name) && !is_list(value) {
            format!("a scene may have several of these; write `[[{name}]]` and its keys below it")
        } else if ONCE.contains(&name) && !value.is_table() {
            format!("a scene has one of these; write `[{name}]` and its keys below it")
        } else {
            continue;
        };
        return Err((key.span(), problem));
    }
    Ok(())
}

/// Finds the key whose value holds byte `at`, or the header of the table there.
fn key_at(text: &str, document: &DeTable<'_>, at: usize) -> Option<String> {
    fn within(table: &DeTable<'_>, at: usize) -> Option<String> {
        table.iter().find_map(|(key, value)| {
            let (begin, span) = (key.span().start, value.span());
            // The span of a table with a header begins before its key.
            let written_out = span.start > begin;
            if written_out && (begin..span.end.max(begin + 1)).contains(&at) {
                let inner = value.get_ref().as_table().and_then(|table| within(table, at));
                return inner.or_else(|| Some(key.get_ref().to_string()));
            }
            match value.get_ref() {
                DeValue::Table(table) if !written_out => within(table, at),
                DeValue::Array(list) if !written_out => list
                    .iter()
                    .filter_map(|one| one.get_ref().as_table())
                    .find_map(|t| within(t, at)),
                _ => None,
            }
        })
    }
    within(document, at).or_else(|| {
        let begin = text.get(..at)?.rfind('\n').map_or(0, |newline| newline + 1);
        let header = text.get(begin..)?.lines().next()?.split('#').next()?.trim();
        header.starts_with('[').then(|| header.to_owned())
    })
}

/// Asks the TOML library for the words that a key may have.
///
/// The library names them only if the value is a word.
fn words_allowed(text: &str, at: Range<usize>, error: &toml::de::Error) -> String {
    let (before, after) = (text.get(..at.start), text.get(at.end..));
    let asked = before.zip(after).map(|(before, after)| format!("{before}'?'{after}"));
    let answer = asked.and_then(|text| toml::from_str::<Scene>(&text).err());
    let answer = answer.and_then(|error| in_words(error.message()));
    match answer.as_deref().and_then(|answer| answer.strip_prefix("`?` is not known; ")) {
        Some(allowed) => format!("found no word in quotes; {allowed}"),
        None => error.message().to_owned(),
    }
}

/// Rewrites a message of the TOML library in the words of scenes; `None` if it has too little
/// information.
fn in_words(message: &str) -> Option<String> {
    let quoted = |text: &str| text.trim_start_matches("one of ").replace(" or ", ", ");
    if let Some((found, expected)) =
        message.strip_prefix("unknown field ").and_then(|m| m.split_once(", expected "))
    {
        return Some(format!("there is no key {found} here; allowed are {}", quoted(expected)));
    }
    if let Some((found, expected)) =
        message.strip_prefix("unknown variant ").and_then(|m| m.split_once(", expected "))
    {
        return Some(format!("{found} is not known; allowed are {}", quoted(expected)));
    }
    if let Some(key) = message.strip_prefix("missing field ") {
        return Some(format!("{key} is missing here; add a line with it"));
    }
    for kind in ["invalid type: ", "invalid value: ", "invalid length "] {
        if let Some((found, expected)) =
            message.strip_prefix(kind).and_then(|m| m.split_once(", expected "))
        {
            let found = match found {
                "sequence" => "an array",
                "map" => "a table",
                other => other,
            };
            let expected = match expected {
                "a boolean" => "true or false".to_owned(),
                "a string" => "a text in quotes".to_owned(),
                "a sequence" => "a list in square brackets".to_owned(),
                "u64" => format!("a whole number from 0 to {}", i64::MAX),
                other if other.starts_with("struct ") => "a table, { key = value, … }".to_owned(),
                other => {
                    other.replace("an array of length", "a list in square brackets, its length")
                }
            };
            return Some(format!("found {found}; allowed is {expected}"));
        }
    }
    (!message.starts_with("wanted ")).then(|| message.to_owned())
}
