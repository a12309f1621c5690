//! Section of `docs/accuracy.md` that quotes the table: aims and figures, and what stays unnamed.

use std::fmt::Write as _;

use super::table::{Fault, LIMITS, Row, faults};

/// Share of the cases in per cent that must be named in time.
const NAMED: f64 = 99.9;
/// Most false alarms in a frame.
const ALARMS: f64 = 1e-7;

/// Groups of faults: name, aim, and whether a row belongs to it.
type Group = (&'static str, &'static str, fn(&Row) -> bool);
const GROUPS: [Group; 10] = [
    ("**no signal left**, all places", "100 % in the first frame", |row| row.class == "total"),
    ("stuck codes", "99.9 % in 10 ms", |row| sudden(row, &["stuck", "frozen"])),
    ("swapped or copied channels, shifted scans", "99.9 % in 10 ms", |row| {
        sudden(row, &["swapped", "reads", "shifted"])
    }),
    ("a wrong bit", "99.9 % in 10 ms", |row| sudden(row, &["bit"])),
    ("noise", "99.9 % in 10 ms", |row| sudden(row, &["noise"])),
    ("floating", "99.9 % in 10 ms", |row| sudden(row, &["floating"])),
    ("at zero now and then", "99.9 % in 10 ms", |row| sudden(row, &["at zero"])),
    ("**all of these six**", "99.9 % in 10 ms", |row| row.class == "sudden"),
    ("LED row −5 %", "in 50 ms", |row| row.class == "row"),
    ("gain, offset, drift", "–", |row| row.class == "gradual"),
];

fn sudden(row: &Row, begins: &[&str]) -> bool {
    row.class == "sudden" && begins.iter().any(|word| row.kind.starts_with(word))
}

/// Share of the cases in per cent; `None` without cases.
fn share<'r>(rows: impl Iterator<Item = &'r Row>, count: fn(&Row) -> u64) -> Option<f64> {
    let (part, all) = rows.fold((0, 0), |(part, all), row| (part + count(row), all + row.cases));
    (all > 0).then(|| 100.0 * part as f64 / all as f64)
}

fn name(fault: &Fault<'_>) -> String {
    format!("{} {}", fault.place, fault.kind)
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "–".into(), |share| format!("{share:.1} %"))
}

/// Writes the section: two tables and the list of the unnamed faults, worst first.
#[must_use]
pub fn section(rows: &[Row]) -> String {
    let faults = faults(rows);
    let text = groups(rows) + &errors(&faults) + &alarms(rows) + &unnamed(&faults);
    text.lines().map(wrapped).collect()
}

/// Longest line of a paragraph in characters.
const LONGEST: usize = 118;

/// Breaks a paragraph into lines; a row of a table stays whole.
fn wrapped(paragraph: &str) -> String {
    if paragraph.starts_with('|') || paragraph.is_empty() {
        return format!("{paragraph}\n");
    }
    let (mut text, mut long) = (String::new(), 0);
    for word in paragraph.split(' ') {
        let letters = word.chars().count();
        if long > 0 && long + 1 + letters > LONGEST {
            text.push('\n');
            long = 0;
        } else if long > 0 {
            text.push(' ');
            long += 1;
        }
        text += word;
        long += letters;
    }
    text + "\n"
}

/// Table of the groups: aims and figures.
fn groups(rows: &[Row]) -> String {
    let mut text = "| fault | aim | cases | named in time, matrix alone | with force sensors | named at all | \
                    a sound channel named | false gross slip |\n|---|---|---|---|---|---|---|---|\n"
        .to_owned();
    for (name, aim, holds) in GROUPS {
        let of = || rows.iter().filter(|row| !row.is_clean() && holds(row));
        let by = |finger: &'static str| of().filter(move |row| row.finger == finger);
        let cases: u64 = of().map(|row| row.cases).sum();
        let in_time = LIMITS.map(|(finger, _)| percent(share(by(finger), |row| row.in_time)));
        let [matrix, sensors] =
            if aim == "–" { ["–".to_owned(), "–".to_owned()] } else { in_time };
        let all = |count: fn(&Row) -> u64| percent(share(of(), count));
        let (named, wrong) = (all(|row| row.named), all(|row| row.wrong));
        let slides = all(|row| row.slides);
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "| {name} | {aim} | {cases} | {matrix} | {sensors} | {named} | {wrong} | {slides} |"
        );
    }
    text
}

/// Table of the errors without a flag: aims and figures.
fn errors(faults: &[Fault<'_>]) -> String {
    let mut text = "\n| error of force without a flag | aim | kinds within, of all frames | kinds within, of 99 in 100 frames | \
                    largest |\n|---|---|---|---|---|\n"
        .to_owned();
    for ((finger, limit), name) in LIMITS.iter().zip(["matrix alone", "with force sensors"]) {
        let own: Vec<&Fault<'_>> = faults.iter().filter(|f| f.is_of(finger)).collect();
        let within = |figure: fn(&Row) -> Option<f64>| {
            own.iter().filter(|f| f.most(finger, figure).is_none_or(|mn| mn <= *limit)).count()
        };
        let most = own.iter().filter_map(|f| f.most(finger, |row| row.max_mn)).fold(0.0, f64::max);
        let (all, usual) = (within(|row| row.max_mn), within(|row| row.p99_mn));
        let of = own.len();
        let _ = writeln!(
            text,
            "| {name} | {limit:.0} mN | {all} of {of} | {usual} of {of} | {most:.0} mN |"
        );
    }
    text
}

/// Paragraph about the false alarms. Both fingers read the same scans, which are counted once.
fn alarms(rows: &[Row]) -> String {
    let clean = || rows.iter().filter(|row| row.is_clean());
    let sum = |count: fn(&Row) -> u64| clean().map(count).sum::<u64>();
    let [frames, flagged, wrong] =
        [sum(|row| row.cases), sum(|row| row.flagged), sum(|row| row.wrong)];
    let both = clean().filter(|row| row.finger == LIMITS[1].0);
    let scans = both.map(|row| row.cases).sum::<u64>() as f64;
    let scenes = |holds: fn(&&Row) -> bool| {
        let mut names: Vec<&str> = clean().filter(holds).map(|row| row.kind.as_str()).collect();
        names.dedup();
        names
    };
    let lit = scenes(|row| row.flagged > row.wrong).join("`, `");
    // Poisson's bound for none, at 95 %.
    let bound = 3.0 / scans;
    let verdict = if wrong > 0 {
        let of = scenes(|row| row.wrong > 0).join("`, `");
        let rate = wrong as f64 / frames as f64;
        format!("{wrong} others are false alarms, {rate:.1e} of all, in `{of}`: the aim is missed")
    } else if bound <= ALARMS {
        format!(
            "no other frame has one: fewer than 1 in 10⁷ scans, with 95 % confidence ({bound:.1e})"
        )
    } else {
        format!(
            "no other frame has one. With 95 % confidence that is fewer than {bound:.1e} of the scans: no false alarm is known, \
             but too few scans were judged to show the aim"
        )
    };
    format!(
        "\n**False alarms** (aim: fewer than 1 in 10⁷ sound frames). {:.1} million scans of {} sound scenes, each judged by both \
         fingers: {} frames have a flag of a fault because light does clip taxels (`{lit}`), and {verdict}.\n",
        scans / 1e6,
        scenes(|_| true).len(),
        flagged - wrong
    )
}

/// Number of faults that the table lists.
const LISTED: usize = 20;

/// List of the faults that are not named in all cases, worst first.
fn unnamed(faults: &[Fault<'_>]) -> String {
    let missed = |fault: &&Fault<'_>| {
        let named = share(fault.rows.iter().copied(), |row| row.named);
        named.is_some_and(|named| named < NAMED)
    };
    let mut missed: Vec<&Fault<'_>> = faults.iter().filter(missed).collect();
    missed.sort_by(|a, b| b.silent().total_cmp(&a.silent()));
    let (silent, rest): (Vec<&Fault<'_>>, Vec<&Fault<'_>>) =
        missed.into_iter().partition(|fault| fault.silent() >= 0.05);
    let (listed, few) = silent.split_at(LISTED.min(silent.len()));
    let mut text = "\n**Not named, worst first**: by the share of frames whose force is off by more than the limit while no \
                    flag is set. Error in mN: 99 of 100 frames without a flag (the largest).\n\n\
                    | fault | off without a flag, matrix alone | with force sensors | error, matrix alone | with force sensors | \
                    false gross slip |\n|---|---|---|---|---|---|\n"
        .to_owned();
    for fault in listed {
        let [silent, silent_both] = LIMITS.map(|(finger, _)| percent(fault.silent_of(finger)));
        let [own, both] = LIMITS.map(|(finger, _)| {
            let figures =
                [fault.most(finger, |row| row.p99_mn), fault.most(finger, |row| row.max_mn)];
            match figures {
                [Some(usual), Some(most)] => format!("{usual:.0} ({most:.0})"),
                _ => "–".into(),
            }
        });
        let slides = percent(share(fault.rows.iter().copied(), |row| row.slides));
        let name = name(fault);
        let _ = writeln!(text, "| {name} | {silent} | {silent_both} | {own} | {both} | {slides} |");
    }
    let names =
        |of: &[&Fault<'_>]| of.iter().map(|fault| name(fault)).collect::<Vec<_>>().join("; ");
    if !few.is_empty() {
        let _ = writeln!(
            text,
            "\nNot named either, with fewer such frames, worst first: {}.",
            names(few)
        );
    }
    let _ = writeln!(
        text,
        "\nNot named, but withheld, flagged or within the limit in 99.95 % of the frames: {}.",
        names(&rest)
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(class: &str, kind: &str, finger: &str, [cases, in_time]: [u64; 2]) -> Row {
        Row {
            kind: kind.into(),
            place: "taxel".into(),
            class: class.into(),
            phase: "loaded".into(),
            finger: finger.into(),
            cases,
            named: in_time,
            in_time,
            p99_mn: Some(70.0),
            max_mn: Some(90.0),
            ..Row::default()
        }
    }

    #[test]
    fn every_sudden_fault_is_in_one_group() {
        for kind in crate::faults::KINDS {
            let row = row(kind.class.name(), kind.name, "matrix", [1, 0]);
            let groups = GROUPS.iter().filter(|(_, _, holds)| holds(&row)).count();
            let expected = if row.class == "sudden" { 2 } else { 1 };
            assert_eq!(groups, expected, "{}", kind.name);
        }
    }

    #[test]
    fn unnamed_faults_are_listed_by_their_silent_frames() {
        let rows = [
            Row { silent: 3.0, ..row("sudden", "bit 6 at 1", "matrix", [8, 2]) },
            Row { silent: 9.0, ..row("sudden", "floating", "matrix", [8, 2]) },
            Row { silent: 5.0, ..row("total", "at zero", "matrix", [8, 8]) },
            row("gradual", "gain −5 %", "matrix", [8, 0]),
        ];
        let text = section(&rows);
        let at = |words: &str| text.find(words).unwrap_or_else(|| panic!("{words} in {text}"));
        let floating = at("| taxel floating | 9.0 % | – | 70 (90) | – | 0.0 % |");
        assert!(floating < at("| taxel bit 6 at 1 | 3.0 % | – | 70 (90) | – | 0.0 % |"));
        assert!(!text.contains("| taxel at zero |"), "it is named");
        at("| **no signal left**, all places | 100 % in the first frame | 8 | 100.0 % |");
        at("the frames: taxel gain −5 %.");
        at("| matrix alone | 50 mN | 0 of 4 | 0 of 4 | 90 mN |");
    }

    #[test]
    fn paragraphs_are_wrapped_and_tables_are_not() {
        let words = "seven letters ".repeat(30);
        let lines = wrapped(words.trim_end());
        assert!(lines.lines().count() > 3 && lines.lines().all(|line| line.len() <= LONGEST));
        assert_eq!(lines.split_whitespace().count(), 60);
        let row = format!("| {words} |");
        assert_eq!(wrapped(&row), format!("{row}\n"));
    }

    #[test]
    fn few_sound_frames_do_not_show_the_rate() {
        let clean = |cases, wrong| Row {
            cases,
            flagged: wrong,
            wrong,
            class: "clean".into(),
            finger: "matrix and sensors".into(),
            ..Row::default()
        };
        assert!(alarms(&[clean(20_000_000, 0)]).contains("too few scans"));
        assert!(alarms(&[clean(40_000_000, 0)]).contains("fewer than 1 in 10⁷ scans, with"));
        // The other finger reads the same scans.
        let twice = [clean(20_000_000, 0), Row { finger: "matrix".into(), ..clean(20_000_000, 0) }];
        assert!(alarms(&twice).contains("too few scans"));
        assert!(alarms(&[clean(1000, 2)]).contains("2 others are false alarms"));
    }
}
