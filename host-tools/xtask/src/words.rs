//! Tests that comments and commits keep the rules of style that a machine can see; CONTRIBUTING.md
//! has all of them.

use std::fs;
use std::path::Path;

use crate::run::{lines, program, root};

/// Words that no comment begins with.
const OPENERS: [&str; 7] = ["What", "Of", "Where", "Whose", "That which", "The same", "By"];

/// Words that a stranger stumbles over.
const ARCHAIC: [&str; 6] = ["dearer", "dearest", "anew", "nought", "for ever", "in force"];

/// Collects the Rust files below a folder, without what cargo builds.
fn sources(folder: &Path, found: &mut Vec<std::path::PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("target") {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Returns the marker and the words of a line that is a comment.
fn comment(line: &str) -> Option<(&str, &str)> {
    let line = line.trim_start();
    let marker = ["///", "//!", "//"].into_iter().find(|marker| line.starts_with(marker))?;
    Some((marker, line[marker.len()..].trim()))
}

/// Whether `text` has `word` between other characters than letters.
fn has(text: &str, word: &str) -> bool {
    let letter = |c: Option<char>| c.is_some_and(char::is_alphanumeric);
    text.match_indices(word).any(|(at, _)| {
        !letter(text[..at].chars().next_back()) && !letter(text[at + word.len()..].chars().next())
    })
}

/// Lists the lines of a file that break a rule, each with the rule.
fn faults(text: &str) -> Vec<(usize, String)> {
    let (mut found, mut before) = (Vec::new(), None);
    for (at, line) in text.lines().enumerate() {
        let Some((marker, words)) = comment(line) else {
            before = None;
            continue;
        };
        let opener = OPENERS.iter().find(|word| has(words, word) && words.starts_with(**word));
        if let (Some(word), true) = (opener, before != Some(marker)) {
            found.push((at + 1, format!("begins with `{word}`")));
        }
        if let Some(word) = ARCHAIC.iter().find(|word| has(words, word)) {
            found.push((at + 1, format!("has `{word}`")));
        }
        before = Some(marker);
    }
    found
}

#[test]
fn comments_begin_with_their_subject_in_plain_words() {
    let mut files = Vec::new();
    for folder in ["src", "boards", "host-tools", "tests", "examples"] {
        sources(&root().join(folder), &mut files);
    }
    assert!(files.len() > 400, "{}", files.len());
    let found: Vec<String> = files
        .iter()
        .filter(|path| !path.ends_with("xtask/src/words.rs"))
        .flat_map(|path| {
            let faults = faults(&fs::read_to_string(path).unwrap());
            faults.into_iter().map(|(line, rule)| format!("{}:{line}: {rule}", path.display()))
        })
        .collect();
    assert!(found.is_empty(), "say what the item is or does:\n{}", found.join("\n"));
}

#[test]
fn comment_that_breaks_a_rule_is_found() {
    let text = "/// What it is.\n/// Of the same comment.\nfn a() {}\n// Begun anew.\n// By day.\n";
    let lines: Vec<usize> = faults(text).into_iter().map(|(line, _)| line).collect();
    assert_eq!(lines, [1, 4]);
    assert!(faults("/// Bytes of a frame.\n/// Where\n//! Offset.\n").is_empty());
}

#[test]
fn commit_subjects_have_72_characters_at_most() {
    // An archive of the sources has no commits.
    if !root().join(".git").exists() {
        return;
    }
    // Older ones may be longer.
    let log = ["log", "-20", "--since=2026-11-29T06:30:00Z", "--format=%s"];
    let subjects = lines(program("git", &root()).args(log)).unwrap();
    let long = |subject: &&String| subject.chars().count() > 72 && !subject.starts_with("Merge ");
    assert_eq!(subjects.iter().find(long), None, "shorten it: `git rebase -i` or `--amend`");
}
