//! Text of the page on a form that is filled in as far as the first days get.

use super::*;

/// Blank form, filled in by `found`: a step's cells `measured`, `passed` and `note`.
fn judged(head: &[(&str, &str)], found: &[(&str, &str)]) -> Judged {
    let blank = include_str!("../../../../../../docs/bench-stm32g431.csv");
    let lines = blank.lines().map(|line| {
        let given = head.iter().find(|(key, _)| line == format!("# {key}="));
        let cells = found.iter().find(|(step, _)| line.starts_with(&format!("{step},")));
        match (given, cells) {
            (Some((_, value)), _) => format!("{line}{value}\n"),
            (_, Some((_, cells))) => format!("{}{cells}\n", line.strip_suffix(",,").unwrap()),
            _ => format!("{line}\n"),
        }
    });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("form.csv");
    std::fs::write(&path, lines.collect::<String>()).unwrap();
    Judged::new(taxel_files::bench::read(&path).unwrap())
}

const HEAD_GIVEN: [(&str, &str); 4] =
    [("serial", "<0042>"), ("firmware", "0.1.0"), ("date", "2027-03-01"), ("by", "Ann")];

/// Text of a page, a line for each block.
fn text(page: &str) -> String {
    let mut text = String::new();
    for part in page.split('<').skip(1) {
        let Some((tag, words)) = part.split_once('>') else { continue };
        match tag.split(' ').next() {
            Some("h1" | "h2" | "p" | "li" | "tr") => text.push('\n'),
            Some("td" | "th") => text.push_str(" | "),
            Some("style") => continue,
            _ => {}
        }
        text += words;
    }
    text.lines().map(|line| line.trim_start_matches(" | ").trim_end().to_owned() + "\n").collect()
}

#[test]
fn page_begins_with_verdict_and_lists_every_step() {
    let judged = judged(
        &HEAD_GIVEN,
        &[
            ("B1", "`0483:df11` <usb>,1,"),
            ("B2", "61.5,1,\"stream on, finger dark\""),
            ("B3", ",1,"),
            ("B6", "power; pin,,"),
            ("B16a", "239876,,"),
            ("B19", ",0,"),
            ("F2", "3000,,"),
        ],
    );
    let text = text(&page(&judged));
    let blank = |line: &&str| line.contains(" | not measured | – | ");
    // Step B3 has no value, but a reason.
    assert_eq!(text.lines().filter(blank).count(), judged.count(Verdict::NotMeasured) - 1);
    let filled: Vec<&str> = text.lines().filter(|line| !blank(line)).collect();
    let filled = filled.join("\n");
    assert_eq!(filled, include_str!("page.txt").trim(), "{filled}");
}

#[test]
fn page_of_blank_form_claims_nothing() {
    let judged = judged(&[], &[]);
    let (text, all) = (text(&page(&judged)), judged.steps.len());
    let verdict = format!(
        "\nNothing measured yet: none of {all} steps\n0 met\n0 missed\n{all} not measured\n"
    );
    assert!(text.contains(&verdict), "{text}");
    assert!(text.contains("the form has none") && !text.contains("Measured on hardware"));
    assert_eq!(text.matches("| not measured | – |").count(), all);
}

#[test]
fn page_of_matrix_alone_has_its_limits() {
    let head = [HEAD_GIVEN.to_vec(), vec![("force_sensors", "0")]].concat();
    let text = text(&page(&judged(&head, &[("F6a", "50,,")])));
    assert!(text.contains("The matrix alone, without force sensors."), "{text}");
    let judged = |line: &str| line.starts_with("F6a accuracy | met | 50 mN | 0 to ");
    assert!(text.lines().any(judged), "{text}");
}
