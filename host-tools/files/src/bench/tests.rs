//! Tests of reading forms.

use super::*;

/// Blank form with replacements, each of which must be found.
fn filled(changes: &[(&str, &str)]) -> String {
    let mut text = BLANK[0].1.to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    text
}

fn parsed(text: &str) -> Result<Form, FileError> {
    parse(text.as_bytes(), Path::new("form.csv"))
}

fn refused(changes: &[(&str, &str)]) -> String {
    parsed(&filled(changes)).unwrap_err().to_string()
}

const SUPPLY: &str = "\"44 mA, at most 53 mA\",0,53,,mA,,,";

fn supply(cells: &str) -> String {
    format!("\"44 mA, at most 53 mA\",{cells}")
}

#[test]
fn blank_forms_have_steps_and_nothing_measured() {
    for (board, text) in BLANK {
        let form = parsed(text).unwrap();
        assert_eq!(form.head("board"), board);
        assert!(form.head[1..].iter().all(String::is_empty));
        assert!(form.steps.len() > 40, "{board}: {}", form.steps.len());
        assert!(form.steps.iter().all(|step| step.found == Found::default()), "{board}");
        let limits = form.steps.iter().filter_map(|step| step.limits.as_ref());
        let sound = |limits: &Limits| limits.min <= limits.max && !limits.unit.is_empty();
        assert!(limits.clone().count() > 10 && limits.into_iter().all(sound), "{board}");
    }
}

#[test]
fn filled_cells_are_read() {
    let form = parsed(&filled(&[
        ("# by=", "\"# by=Ann, Bob\",,,,,,,,,"),
        ("# serial=", "# serial=0042,,,,,,,,,"),
        (SUPPLY, &supply("0,53,,mA,−47.5,1,warm")),
    ]))
    .unwrap();
    assert_eq!([form.head("serial"), form.head("by")], ["0042", "Ann, Bob"]);
    let step = form.steps.iter().find(|step| step.step == "B2").unwrap();
    let limits = step.limits.as_ref().unwrap();
    assert_eq!((limits.max, limits.unit.as_str()), (53.0, "mA"));
    let found = &step.found;
    assert_eq!((found.value, found.passed, found.note.as_str()), (Some(-47.5), Some(true), "warm"));
}

#[test]
fn form_saved_by_a_spreadsheet_is_read() {
    let text = filled(&[(SUPPLY, &supply("0.0,53.00,,mA,44,,"))]);
    let text = format!("\u{feff}{}\r\n,,,,,,,,,\r\n", text.trim_end().replace('\n', "\r\n"));
    let form = parsed(&text).unwrap();
    assert_eq!(form.steps[1].found.value, Some(44.0));
}

#[test]
fn left_out_row_is_not_measured() {
    let text: Vec<&str> = BLANK[0].1.lines().filter(|line| !line.starts_with("B2,")).collect();
    let (form, whole) = (parsed(&text.join("\n")).unwrap(), parsed(BLANK[0].1).unwrap());
    assert_eq!(form, whole);
}

#[test]
fn file_that_is_no_form_is_refused() {
    let told = |text: &str| parsed(text).unwrap_err().to_string();
    let trace = told("# full_scale=65535\nt_us,lit_r0c0\n");
    assert!(
        trace.starts_with("form.csv:1: `# full_scale=`: unknown: expected a bench form"),
        "{trace}"
    );
    let table = told("a,b\n1,2\n");
    assert!(table.starts_with("form.csv:1: `step`: the column is missing"), "{table}");
    assert!(table.contains("; name the columns as docs/bench-BOARD.csv does: step,"), "{table}");
    assert!(told("").starts_with("form.csv: no header: expected a bench form; give"));
    let binary = parse(&b"\x89MCAP0\xff\n"[..], Path::new("a.mcap")).unwrap_err().to_string();
    assert!(binary.starts_with("a.mcap:1: not text: expected a CSV file"), "{binary}");
    let german = told(&BLANK[0].1.replace(',', ";"));
    assert!(german.contains("separated by ';': expected commas"), "{german}");
}

#[test]
fn missing_or_duplicate_column_is_named() {
    let missing = refused(&[("measured,passed,note", "measured,note,other")]);
    assert!(missing.starts_with("form.csv:8: `passed`: the column is missing"), "{missing}");
    let twice = refused(&[("passed,note", "measured,passed,note")]);
    assert_eq!(twice, "form.csv:8: `measured`: duplicate column; remove one of them");
}

#[test]
fn board_is_one_with_a_form() {
    for (to, found) in [("", "none"), ("x", "`x`")] {
        let told = refused(&[("board=stm32g431", &format!("board={to}"))]);
        let problem = format!("expected stm32g431 or stm32f411, found {found}; begin the file");
        assert!(told.starts_with(&format!("form.csv: `# board=`: {problem}")), "{told}");
    }
    let twice = refused(&[("# serial=", "# board=stm32f411")]);
    assert_eq!(twice, "form.csv:2: `# board=`: stands twice; keep one of the lines");
}

#[test]
fn value_that_is_no_number_is_refused() {
    let told = |measured: &str| {
        let cells = supply(&format!("0,53,,mA,{measured},,"));
        refused(&[(SUPPLY, &cells)])
    };
    let mend = "write the number alone, in mA; words belong in `note`";
    for (measured, expected) in [
        ("44 mA", "a finite number, found `44 mA`"),
        ("\"44,1\"", "a number with a decimal point, found `44,1`"),
        ("nan", "a finite number, found `nan`"),
        ("1e300", "a number up to 1e12, found `1e300`"),
    ] {
        let line = format!("form.csv:10: `measured`: expected {expected}; {mend}");
        assert_eq!(told(measured), line);
    }
    let passed = refused(&[(SUPPLY, &supply("0,53,,mA,44,yes,"))]);
    assert!(
        passed.starts_with("form.csv:10: `passed`: expected 1, 0 or nothing, found `yes`; 1 is"),
        "{passed}"
    );
}

#[test]
fn unknown_or_duplicate_step_is_named() {
    let mend = "copy your values into the form of this version, docs/bench-stm32g431.csv";
    let unknown = refused(&[("\nB2,", "\nC2,")]);
    let problem = "unknown step `C2`: expected one of stm32g431's, up to F10b";
    assert_eq!(unknown, format!("form.csv:10: `step`: {problem}; {mend}"));
    let twice = refused(&[("\nB3,", "\nB2,supply,,0,53,,mA,,,\nB3,")]);
    assert_eq!(
        twice,
        "form.csv:11: `step`: step `B2` stands in line 10 already; keep the row that counts, \
         remove the other"
    );
}

#[test]
fn changed_expectation_is_refused() {
    let mend = "copy your values into the form of this version, docs/bench-stm32g431.csv";
    for (cells, column, problem) in [
        ("0,60,,mA,55,,", "max", "expected 53, found 60"),
        ("0,53,9,mA,55,,", "matrix_max", "expected nothing, found 9"),
        ("0,53,,A,55,,", "unit", "expected mA, found A"),
    ] {
        let told = refused(&[(SUPPLY, &supply(cells))]);
        assert_eq!(told, format!("form.csv:10: `{column}`: {problem}; {mend}"));
    }
    let moved = refused(&[("B2,supply", "B2,serial number")]);
    assert!(moved.contains("`check`: expected supply, found serial number"), "{moved}");
    let short = refused(&[(SUPPLY, &supply("0,53"))]);
    assert!(short.starts_with("form.csv:10: 5 fields where the header has 10"), "{short}");
}
