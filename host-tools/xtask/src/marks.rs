//! Generated files, and generated parts of files: between a line with `KIND: NAME` and the next one
//! with `KIND: end`.

use std::path::Path;

use anyhow::{Context, Result};

/// Generated part of a file: its name and its lines.
pub type Part = (&'static str, String);

/// Returns whether the file differs from its parts; writes it unless `check`.
pub fn update(path: &Path, kind: &str, parts: &[Part], check: bool) -> Result<bool> {
    let text = std::fs::read_to_string(path)?;
    let filled = parts.iter().try_fold(text.clone(), |text, part| fill(&text, kind, part))?;
    let different = filled != text;
    if different && !check {
        std::fs::write(path, filled)?;
    }
    Ok(different)
}

/// Returns whether a file that is generated as a whole differs; writes it unless `check`.
pub fn whole(path: &Path, bytes: &[u8], check: bool) -> Result<bool> {
    let different = std::fs::read(path).unwrap_or_default() != bytes;
    if different && !check {
        let write = || {
            std::fs::create_dir_all(path.parent().unwrap_or(path))?;
            std::fs::write(path, bytes)
        };
        write().with_context(|| path.display().to_string())?;
    }
    Ok(different)
}

/// Replaces the lines of a part in the text.
fn fill(text: &str, kind: &str, (name, lines): &Part) -> Result<String> {
    let (begin, end) = (format!("{kind}: {name}"), format!("{kind}: end"));
    let start = text
        .lines()
        .position(|line| line.split(' ').collect::<Vec<_>>().join(" ").contains(&begin));
    let start = start.with_context(|| format!("no line with `{begin}`"))?;
    let rest = text.lines().skip(start + 1).position(|line| line.contains(&end));
    let stop = start + 1 + rest.with_context(|| format!("no `{end}` after `{begin}`"))?;
    let all: Vec<&str> = text.lines().collect();
    let mut filled = all[..=start].join("\n") + "\n" + lines;
    for line in &all[stop..] {
        filled += line;
        filled += "\n";
    }
    Ok(filled)
}

/// Joins the lines, each with a line feed.
pub fn lines(lines: impl IntoIterator<Item = String>) -> String {
    lines.into_iter().map(|line| line + "\n").collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_file_is_written_where_it_differs_unless_checked() {
        let folder = crate::run::target().join("marks");
        let _ = std::fs::remove_dir_all(&folder);
        let path = folder.join("a.csv");
        assert!(whole(&path, b"a\n", true).unwrap() && !path.exists());
        assert!(whole(&path, b"a\n", false).unwrap());
        assert!(!whole(&path, b"a\n", true).unwrap());
        assert!(whole(&path, b"b\n", true).unwrap());
        assert_eq!(std::fs::read(&path).unwrap(), b"a\n");
    }

    #[test]
    fn part_without_its_markers_is_an_error() {
        let part = ("names", "new\n".to_owned());
        let text = "a\n# schema: names\nold\n# schema: end\nb\n";
        let filled = fill(text, "schema", &part).unwrap();
        assert_eq!(filled, "a\n# schema: names\nnew\n# schema: end\nb\n");
        assert!(fill(text, "pages", &part).is_err());
        assert!(fill("# schema: name\n# schema: end\n", "schema", &part).is_err());
        assert!(fill("# schema: names\n", "schema", &part).is_err());
    }
}
