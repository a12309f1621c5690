//! `cargo xtask book`: the documentation as one book.
//!
//! Copies the pages of docs/index.md with the files they link to, in the repository's own folders,
//! into target/book/src, and writes mdBook's table of contents from the same list.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use crate::pages::links::{self, Chapter, INDEX, chapters, is_local, resolve};
use crate::run::{clean, root, run, target};

/// Page that the book opens with; it stands in the repository's own folder.
const COVER: &str = "README.md";

/// Builds the book and checks the links of what was built.
pub fn task() -> Result<()> {
    let book = target().join("book");
    let _ = std::fs::remove_dir_all(&book);
    let source = book.join("src");
    stage(&source)?;
    run(clean("mdbook", &root()).arg("build").arg("--dest-dir").arg(book.join("html"))).context(
        "no book; mdBook makes it: `cargo install --locked mdbook`, or your system's package",
    )?;
    let count = check(&book.join("html"))?;
    println!("{}", book.join("html/index.html").display());
    eprintln!("{count} links inside the book lead to a page, picture or heading");
    Ok(())
}

/// Copies all pages and what they link to, and writes SUMMARY.md.
fn stage(source: &Path) -> Result<()> {
    let index = std::fs::read_to_string(root().join(INDEX))?;
    let chapters = chapters(&index);
    let listed = chapters.iter().flat_map(|chapter| &chapter.pages).map(|(_, path)| path.as_str());
    let pages: BTreeSet<&str> = listed.chain([INDEX]).collect();
    for page in &pages {
        let text =
            std::fs::read_to_string(root().join(page)).with_context(|| (*page).to_owned())?;
        let mut staged = text.clone();
        for (_, target) in links::links(&text).into_iter().filter(|(_, target)| is_local(target)) {
            let path = resolve(page, &target);
            let from = root().join(&path);
            if from.is_dir() {
                staged = unlinked(&staged, &target);
            } else if !pages.contains(path.as_str()) {
                put(&source.join(&path), &std::fs::read(&from).with_context(|| path)?)?;
            }
        }
        put(&source.join(page), staged.as_bytes())?;
    }
    put(&source.join("SUMMARY.md"), summary(&chapters).as_bytes())
}

fn put(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::create_dir_all(path.parent().unwrap_or(path))?;
    std::fs::write(path, bytes).with_context(|| path.display().to_string())
}

/// Leaves the words of links to a folder, which a book cannot show.
fn unlinked(text: &str, target: &str) -> String {
    let end = format!("]({target})");
    let mut out = text.to_owned();
    while let Some(at) = out.find(&end) {
        let Some(begin) = out[..at].rfind('[') else { break };
        out.replace_range(at..at + end.len(), "");
        out.remove(begin);
    }
    out
}

/// Table of contents of the book.
fn summary(chapters: &[Chapter]) -> String {
    let mut out = format!("# Summary\n\n[taxel]({COVER})\n[All pages]({INDEX})\n");
    for Chapter { title, pages } in chapters {
        out += &format!("\n# {title}\n\n");
        for (title, path) in pages.iter().filter(|(_, path)| path != COVER) {
            out += &format!("- [{title}]({path})\n");
        }
    }
    out
}

/// Checks links and pictures of all pages of a built book; returns their number.
fn check(html: &Path) -> Result<usize> {
    let mut pages = Vec::new();
    collect(html, &mut pages)?;
    let mut count = 0;
    let mut broken = BTreeSet::new();
    for page in &pages {
        let text = std::fs::read_to_string(page)?;
        // Search, print view and the frame of a page are mdBook's own.
        let Some((_, main)) = text.split_once("<main>") else { continue };
        let main = main.split("</main>").next().unwrap_or_default();
        let here = page.strip_prefix(html)?.display().to_string();
        for target in values(main, "href").into_iter().chain(values(main, "src")) {
            if !is_local(target) {
                continue;
            }
            count += 1;
            let path = html.join(resolve(&here, target));
            let anchor = target.split_once('#').map(|(_, anchor)| anchor);
            let named = match anchor {
                Some(anchor) => std::fs::read_to_string(&path)
                    .is_ok_and(|other| values(&other, "id").contains(&anchor)),
                None => path.is_file(),
            };
            if !named {
                broken.insert(format!("{here}: {target}"));
            }
        }
    }
    let broken: Vec<String> = broken.into_iter().collect();
    ensure!(broken.is_empty(), "links of the book that lead nowhere:\n{}", broken.join("\n"));
    ensure!(count > 0, "{}: no page has a link", html.display());
    Ok(count)
}

/// Collects the HTML files of a folder.
fn collect(folder: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(&path, found)?;
        } else if path.extension().is_some_and(|kind| kind == "html") {
            found.push(path);
        }
    }
    Ok(())
}

/// Values of an attribute in an HTML text.
fn values<'t>(text: &'t str, attribute: &str) -> Vec<&'t str> {
    let begin = format!(" {attribute}=\"");
    text.match_indices(&begin)
        .filter_map(|(at, _)| text[at + begin.len()..].split('"').next())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn staged_book_has_all_pages_and_what_they_link_to() {
        let source = target().join("book-test");
        let _ = std::fs::remove_dir_all(&source);
        stage(&source).unwrap();
        let summary = std::fs::read_to_string(source.join("SUMMARY.md")).unwrap();
        let pages = links::pages().unwrap();
        assert!(pages.len() > 40, "{}", pages.len());
        let mut count = 0;
        for page in pages {
            assert!(summary.contains(&format!("]({page})\n")), "SUMMARY.md lacks {page}");
            let text = std::fs::read_to_string(source.join(&page)).unwrap();
            for (_, target) in links::links(&text).into_iter().filter(|(_, to)| is_local(to)) {
                assert!(source.join(resolve(&page, &target)).is_file(), "{page}: {target}");
                count += 1;
            }
        }
        assert!(count > 200, "{count}");
        std::fs::remove_dir_all(&source).unwrap();
    }

    #[test]
    fn link_to_a_folder_leaves_its_words() {
        let text = "See [a](b.md), [the folder](../src) and [again](../src).";
        assert_eq!(unlinked(text, "../src"), "See [a](b.md), the folder and again.");
    }

    #[test]
    fn broken_link_of_a_built_page_is_found() {
        let html = target().join("book-test-html");
        let page = |links: &str| format!("<a href=\"no.html\"></a><main>{links}</main>");
        put(&html.join("a.html"), page("<h2 id=\"x\"></h2><a href=\"#x\"></a>").as_bytes())
            .unwrap();
        put(&html.join("d/b.html"), page("<a href=\"../a.html#x\"></a>").as_bytes()).unwrap();
        assert_eq!(check(&html).unwrap(), 2);
        put(&html.join("d/b.html"), page("<a href=\"../a.html#y\"></a>").as_bytes()).unwrap();
        assert!(check(&html).unwrap_err().to_string().contains("d/b.html: ../a.html#y"));
        std::fs::remove_dir_all(&html).unwrap();
    }
}
