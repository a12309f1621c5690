//! Links of the Markdown pages, and the list of pages in docs/index.md.

#[cfg(test)]
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

#[cfg(test)]
use anyhow::{Context, Result};

#[cfg(test)]
use crate::run::{clean, lines, root};

/// Page that lists all others.
pub const INDEX: &str = "docs/index.md";

/// Pages that are listed under one heading of the index.
pub struct Chapter {
    /// Heading in the index.
    pub title: String,
    /// Title and path of each page, in order.
    pub pages: Vec<(String, String)>,
}

/// Lists the chapters of the index: headings of the second level with lists of links.
pub fn chapters(index: &str) -> Vec<Chapter> {
    let mut chapters: Vec<Chapter> = Vec::new();
    for line in index.lines() {
        if let Some(title) = line.strip_prefix("## ") {
            chapters.push(Chapter { title: title.to_owned(), pages: Vec::new() });
        }
        let Some((chapter, item)) = chapters.last_mut().zip(line.strip_prefix("- [")) else {
            continue;
        };
        if let Some((title, rest)) = item.split_once("](")
            && let Some((target, _)) = rest.split_once(')')
        {
            chapter.pages.push((title.to_owned(), resolve(INDEX, target)));
        }
    }
    chapters
}

/// Lines of a page with their numbers, each code span and block reduced to a backtick.
fn prose(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut code = false;
    for (at, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            code = !code;
            continue;
        }
        if code {
            continue;
        }
        let words: Vec<&str> = line.split('`').step_by(2).collect();
        found.push((at + 1, words.join("`")));
    }
    found
}

/// Targets of a page's links with their lines, without code.
pub fn links(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (line, prose) in prose(text) {
        for (from, _) in prose.match_indices("](") {
            let target = prose[from + 2..].split([')', ' ']).next().unwrap_or_default();
            found.push((line, target.to_owned()));
        }
    }
    found
}

/// Whether a link leads to a file of the repository.
pub fn is_local(target: &str) -> bool {
    !target.contains("://") && !target.starts_with("mailto:")
}

/// Path in the repository of a link's target, without its anchor.
pub fn resolve(page: &str, target: &str) -> String {
    let file = target.split('#').next().unwrap_or_default();
    if file.is_empty() {
        return page.to_owned();
    }
    let mut path = PathBuf::new();
    let joined = Path::new(page).parent().unwrap_or(Path::new("")).join(file);
    for part in joined.components() {
        if part == Component::ParentDir {
            path.pop();
        } else {
            path.push(part);
        }
    }
    path.display().to_string()
}

/// Anchors of a page's headings, as GitHub and mdBook make them.
#[cfg(test)]
pub fn anchors(text: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut code = false;
    for line in text.lines() {
        code ^= line.starts_with("```");
        let title = line.trim_start_matches('#');
        if code || title.len() == line.len() || !title.starts_with(' ') {
            continue;
        }
        let kept = title.trim().chars().filter_map(|c| match c {
            ' ' => Some('-'),
            '-' | '_' => Some(c),
            c if c.is_alphanumeric() => Some(c),
            _ => None,
        });
        let slug: String = kept.flat_map(char::to_lowercase).collect();
        let mut name = slug.clone();
        for n in 1.. {
            if found.insert(name) {
                break;
            }
            name = format!("{slug}-{n}");
        }
    }
    found
}

/// Paths of all Markdown pages of the repository, those that git does not know yet included.
#[cfg(test)]
pub fn pages() -> Result<Vec<String>> {
    let root = root();
    let words = ["ls-files", "--cached", "--others", "--exclude-standard", "*.md"];
    let found = lines(clean("git", &root).args(words)).context("`git ls-files` fails")?;
    Ok(found.into_iter().filter(|page| root.join(page).is_file()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pages::tables::read;

    /// Links of a page that lead nowhere.
    fn broken(page: &str, text: &str) -> Vec<String> {
        let local = links(text).into_iter().filter(|(_, target)| is_local(target));
        local
            .filter(|(_, target)| {
                let path = resolve(page, target);
                let there = root().join(&path).exists();
                let anchor = target.split_once('#').map(|(_, anchor)| anchor);
                let named = anchor.is_none_or(|anchor| {
                    let other = if path == page { Ok(text.to_owned()) } else { read(&path) };
                    other.is_ok_and(|other| anchors(&other).contains(anchor))
                });
                !(there && named)
            })
            .map(|(line, target)| format!("{page}:{line}: {target}"))
            .collect()
    }

    #[test]
    fn every_page_is_listed_in_the_index_once() {
        let index = read(INDEX).unwrap();
        let listed: Vec<String> = chapters(&index)
            .into_iter()
            .flat_map(|chapter| chapter.pages.into_iter().map(|(_, path)| path))
            .collect();
        let expected: Vec<String> =
            pages().unwrap().into_iter().filter(|page| page != INDEX).collect();
        assert!(expected.len() > 40, "{}", expected.len());
        let lacking: Vec<_> = expected.iter().filter(|page| !listed.contains(page)).collect();
        assert!(lacking.is_empty(), "{INDEX} does not list {lacking:?}");
        for page in &expected {
            // Two ways lead through the pages of two readers; one of them lists a page again.
            let times = listed.iter().filter(|other| *other == page).count();
            assert_eq!(times, 1, "{INDEX} lists {page} {times} times");
        }
        let readme = links(&read("README.md").unwrap());
        assert!(
            readme.iter().any(|(_, target)| target == INDEX),
            "README.md does not link {INDEX}"
        );
    }

    #[test]
    fn each_link_of_each_page_resolves() {
        let mut count = 0;
        let mut found = Vec::new();
        for page in pages().unwrap() {
            let text = read(&page).unwrap();
            count += links(&text).len();
            found.extend(broken(&page, &text));
        }
        assert!(count > 250, "{count}");
        assert!(found.is_empty(), "links that lead nowhere:\n{}", found.join("\n"));
    }

    /// Lines in which `<` begins a name, which a browser takes for a tag and hides.
    fn tags(text: &str) -> Vec<usize> {
        let hidden = |prose: &str| {
            let mut after = prose.split('<').skip(1).filter_map(|rest| rest.chars().next());
            after.any(|c| c.is_ascii_alphabetic())
        };
        prose(text).into_iter().filter(|(_, prose)| hidden(prose)).map(|(line, _)| line).collect()
    }

    #[test]
    fn no_type_in_a_page_is_taken_for_html() {
        assert_eq!(tags("list<f32>\n`list<f32>`\n<!-- a -->\n```\nlist<f32>\n```\n1 < 2\n"), [1]);
        for page in pages().unwrap() {
            assert_eq!(
                tags(&read(&page).unwrap()),
                [0; 0],
                "{page}: put these types into backticks"
            );
        }
    }

    #[test]
    fn broken_link_and_anchor_are_found() {
        let text =
            "# A b: `c`\n[x](#a-b-c) [y](no.md) `[z](no.md)` [`w`](#a-b)\n```\n[v](no.md)\n```\n";
        assert_eq!(broken("docs/faq.md", text), ["docs/faq.md:2: no.md", "docs/faq.md:2: #a-b"]);
        assert!(broken("docs/faq.md", "[x](accuracy.md#specification)").is_empty());
        assert_eq!(broken("docs/faq.md", "[x](accuracy.md#no)").len(), 1);
    }
}
