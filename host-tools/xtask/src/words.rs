//! Tests that comments, names, messages, pages and commits keep the rules of style that a machine
//! can see; CONTRIBUTING.md has all of them.

use std::fs;
use std::path::Path;

use crate::run::{lines, program, root};

/// Words that no comment begins with.
const OPENERS: [&str; 7] = ["What", "Of", "Where", "Whose", "That which", "The same", "By"];

/// Words that a stranger stumbles over, in comments, names, messages and pages.
const ARCHAIC: [&str; 8] =
    ["dear", "dearer", "dearest", "anew", "afresh", "nought", "for ever", "in force"];

/// Collects the files with an extension below a folder, without what cargo builds.
fn files(folder: &Path, extension: &str, found: &mut Vec<std::path::PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("target") {
            files(&path, extension, found);
        } else if path.extension().is_some_and(|found| found == extension) {
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

/// Whether `text` has `word` between characters of no name.
fn has(text: &str, word: &str) -> bool {
    let letter = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    text.match_indices(word).any(|(at, _)| {
        !letter(text[..at].chars().next_back()) && !letter(text[at + word.len()..].chars().next())
    })
}

/// Lists the lines of a file that break a rule, each with the rule.
fn faults(text: &str) -> Vec<(usize, String)> {
    let (mut found, mut before) = (Vec::new(), None);
    for (at, line) in text.lines().enumerate() {
        let Some((marker, words)) = comment(line) else {
            // A loop over what is called `force` is no phrase.
            let plain =
                |word: &&&str| !line.trim_start().starts_with("for ") || !word.contains(' ');
            if let Some(word) = ARCHAIC.iter().filter(plain).find(|word| has(line, word)) {
                found.push((at + 1, format!("has `{word}`")));
            }
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
fn comments_and_messages_are_in_plain_words() {
    let mut sources = Vec::new();
    for folder in ["src", "boards", "host-tools", "tests", "examples"] {
        files(&root().join(folder), "rs", &mut sources);
    }
    assert!(sources.len() > 400, "{}", sources.len());
    let found: Vec<String> = sources
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
fn pages_are_in_plain_words() {
    let mut pages: Vec<_> = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"]
        .map(|page| root().join(page))
        .into();
    files(&root().join("docs"), "md", &mut pages);
    assert!(pages.len() > 40, "{}", pages.len());
    let found: Vec<String> = pages
        .iter()
        .flat_map(|path| {
            let text = fs::read_to_string(path).unwrap().to_lowercase();
            let faults = ARCHAIC.iter().filter(|word| has(&text, word));
            faults.map(|word| format!("{}: has `{word}`", path.display())).collect::<Vec<_>>()
        })
        .collect();
    assert!(found.is_empty(), "say it in today's words:\n{}", found.join("\n"));
}

#[test]
fn comment_that_breaks_a_rule_is_found() {
    let text = "/// What it is.\n/// Of the same comment.\nfn a() {}\n// Begun anew.\n// By day.\n";
    let lines: Vec<usize> = faults(text).into_iter().map(|(line, _)| line).collect();
    assert_eq!(lines, [1, 4]);
    assert!(faults("/// Bytes of a frame.\n/// Where\n//! Offset.\n").is_empty());
    assert_eq!(faults("bail!(\"{a}: fit anew\")\nlet dearer = 1;\nfor n in force {}\n").len(), 2);
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
