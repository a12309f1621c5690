//! Tests of the glossary.

use super::tables::read;

#[test]
fn glossary_has_few_terms_each_with_a_link() {
    let text = read("docs/glossary.md").unwrap();
    let rows: Vec<&str> = text.lines().filter(|line| line.starts_with("| ")).skip(1).collect();
    assert!((20..=30).contains(&rows.len()), "{} terms", rows.len());
    let mut terms: Vec<&str> = Vec::new();
    for row in rows {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let [term, meaning, more] = cells[..] else { panic!("{row}") };
        assert!(!terms.contains(&term), "`{term}` stands twice");
        assert!(meaning.split_whitespace().count() <= 25, "`{term}` takes more than a sentence");
        assert!(more.contains("]("), "`{term}` leads nowhere");
        terms.push(term);
    }
}
