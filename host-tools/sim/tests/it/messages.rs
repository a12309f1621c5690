//! Messages about wrong scenes, verbatim: file, line, key, value, allowed values and mend.

use taxel_sim::Scene;

/// Message after `my.toml:` for a scene with `line` in `table`, on line 5.
fn said(table: &str, line: &str) -> String {
    let scan = "[scan]\nrate_hz = 1000\nduration_s = 2\n";
    let text = format!("{scan}[{table}]\n{line}\n");
    whole(&text)
}

fn whole(text: &str) -> String {
    let message = Scene::parse("my.toml", text).unwrap_err().to_string();
    assert_eq!(message.lines().count(), 1, "{message}");
    message.strip_prefix("my.toml:").unwrap().to_owned()
}

#[track_caller]
fn all(cases: &[(String, &str)]) {
    let wrong = cases.iter().filter(|(said, expected)| said != expected);
    let wrong: Vec<String> = wrong.map(|(said, e)| format!("{said}\n  not {e}")).collect();
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn number_out_of_range_reports_the_range() {
    all(&[
        (said("friction", "mu = -1"), "5: `mu`: -1 is out of range; allowed are 0 to 10"),
        (
            said("friction", "mu = 'much'"),
            "5: `mu`: a text instead of a number; allowed are 0 to 10",
        ),
        (
            said("friction", "mu_kinetic = true"),
            "5: `mu_kinetic`: true or false instead of a number; allowed are 0 to 0.8, which is `mu`",
        ),
        (
            said("indenter", "radius_mm = [6]"),
            "5: `radius_mm`: an array instead of a number; allowed are 0.5 to 1000",
        ),
        (
            said("electronics", "pga_gain = 3"),
            "5: `pga_gain`: found integer `3`; allowed is one of 1, 2, 4, 8, 16, 32, 64",
        ),
        (
            said("device", "bits = 14.5"),
            "5: `bits`: found floating point `14.5`; allowed is one of 12, 16",
        ),
        (
            said("device", "seed = -1"),
            "5: `seed`: found integer `-1`; allowed is a whole number from 0 to 9223372036854775807",
        ),
        (said("bench", "sensor = 4"), "5: `sensor`: 4 is out of range; allowed are 0 to 3"),
        (
            whole("[scan]\nrate_hz = 1000.5\nduration_s = 1\n"),
            "2: `rate_hz`: found floating point `1000.5`; allowed is a whole number from 1 to 20000",
        ),
        (
            whole("[scan]\nrate_hz = 1000\nduration_s = 1\nstep_us = 0\n"),
            "4: `step_us`: 0 is out of range; allowed are 1 to 200000",
        ),
        (
            whole("[scan]\nrate_hz = 10000\nduration_s = 1\n"),
            "2: `rate_hz`: a frame lasts 100 µs at 10000 Hz but its five steps of `step_us` 30 µs last \
             150 µs; allowed are `rate_hz` up to 6666 or `step_us` up to 20",
        ),
    ]);
}

#[test]
fn unknown_word_reports_the_known_words() {
    all(&[
        (
            said("electronics", "ratiometric = 'yes'"),
            "5: `ratiometric`: found string \"yes\"; allowed is true or false",
        ),
        (
            said("indenter", "kind = 'ball'"),
            "5: `kind`: `ball` is not known; allowed are `point`, `sphere`, `punch`, `corner`, `cylinder`, \
             `block`, `edge`",
        ),
        (
            said("device", "coating = 3"),
            "5: `coating`: found no word in quotes; allowed are `bare`, `rA`, `rB`, `rC`, `rD`, `F02`",
        ),
        (
            said("device", "bridges = [true, false]"),
            "5: `bridges`: found 2; allowed is a list in square brackets, its length 4",
        ),
        (
            said("device", "wrong_side = [3]"),
            "5: `wrong_side`: found integer `3`; allowed is a text in quotes",
        ),
        (
            said("device", "wrong_side = ['r4c0']"),
            "5: `wrong_side`: no taxel `r4c0`; allowed are r0c0 to r3c3",
        ),
        (
            said("material", "yuong_mpa = 0.2"),
            "5: `yuong_mpa`: there is no key `yuong_mpa` here; allowed are `young_mpa`, `poisson`, \
             `first_cycle_ratio`, `follows`",
        ),
        (
            said(
                "device",
                "kind = 'mems-array'\n[[fault]]\nat_s = 1\nkind = 'dead-led'\nchannel = 'r0c0'",
            ),
            "9: `channel`: no channel `r0c0`; allowed are none: the finger has no such part",
        ),
    ]);
}

#[test]
fn list_error_reports_line_and_key() {
    let scan = "[scan]\nrate_hz = 1000\nduration_s = 2\n";
    all(&[
        (
            whole(&format!("effects = [\n  'noise',\n  'flikker',\n]\n{scan}"))
                .chars()
                .take(40)
                .collect(),
            "3: `effects`: `flikker` is not known; al",
        ),
        (
            whole(&format!(
                "effects = [\n  'noise',\n  'walls',\n]\n{scan}[device]\nkind = 'taxel-4x1'\n"
            )),
            "3: `effects`: `walls` acts on the walls of the 4×4 finger, which this `kind` of device lacks; \
             leave it out",
        ),
        (
            whole(&format!("effects = 'noise'\n{scan}")),
            "1: `effects`: found string \"noise\"; allowed is a list in square brackets",
        ),
        (
            said("[slide]", "at_s = 1\nfrom_mm = [\n  0,\n  7,\n]"),
            "6: `from_mm`: 7 is off the pad; allowed are -5 to 5",
        ),
        (
            said("[slide]", "at_s = 1\nfrom_mm = [0]"),
            "6: `from_mm`: found 1; allowed is 2 numbers from -5 to 5 in square brackets",
        ),
        (
            said("[slide]", "at_s = 1\nfrom_mm = 3"),
            "6: `from_mm`: found integer `3`; allowed is 2 numbers from -5 to 5 in square brackets",
        ),
    ]);
}

#[test]
fn missing_or_repeated_table_reports_syntax() {
    let scan = "[scan]\nrate_hz = 1000\nduration_s = 2\n";
    all(&[
        (
            whole("description = 'a scene'\n"),
            " there is no table [scan]; write `[scan]` and below it, for example, `rate_hz = 1000` and \
             `duration_s = 2`",
        ),
        (
            whole("[scan]\nrate_hz = 1000\n"),
            "1: `[scan]`: `duration_s` is missing here; add a line with it",
        ),
        (
            said("press", "at_s = 1"),
            "4: a scene may have several of these; write `[[press]]` and its keys below it",
        ),
        (
            said("[indenter]", "radius_mm = 6"),
            "4: a scene has one of these; write `[indenter]` and its keys below it",
        ),
        (whole("scan = 3\n"), "1: a scene has one of these; write `[scan]` and its keys below it"),
        (
            whole(&format!("{scan}[[press]]\nx_mm = 0\n")),
            "4: `[[press]]`: `at_s` is missing here; add a line with it",
        ),
        (whole(&format!("{scan}rate_hz = 500\n")), "4: this is not TOML: duplicate key"),
    ]);
}

#[test]
fn contact_conflict_reports_when_and_where() {
    let press = |at: f64, x: f64| {
        format!(
            "at_s = {at}\nx_mm = {x}\ny_mm = 0\nfz_n = 1\nrise_s = 0.1\nhold_s = 0.4\nfall_s = 0.1"
        )
    };
    all(&[
        (
            said("[press]", &press(1.5, 0.0)),
            "4: `[[press]]`: ends at 2.1 s but the scene at `duration_s` 2 s; let it begin earlier or be \
             shorter, or make `duration_s` at least 2.1",
        ),
        (
            said("[press]", &format!("{}\n[[press]]\n{}", press(1.0, 0.0), press(1.3, 0.5))),
            "12: `[[press]]`: comes within 0.50 mm of the contact that lasts until 1.6 s, and their areas \
             reach 4.85 mm; move them apart or let one end first",
        ),
        (
            said(
                "device",
                &format!(
                    "kind = 'ohka-sheet'\n[indenter]\nradius_mm = 1\n[[press]]\n{}",
                    press(1.0, 0.0)
                ),
            ),
            "8: `[[press]]`: a feeler would carry 0.0877 N; its law holds up to 0.012 N: press less or take a \
             wider indenter",
        ),
    ]);
}

#[test]
fn sheet_reports_its_limits() {
    let sheet = |more: &str| said("device", &format!("kind = 'ohka-sheet'\n{more}"));
    all(&[
        (
            sheet(
                "[indenter]\nradius_mm = 20\n[[press]]\nat_s = 1\nx_mm = 2\ny_mm = 0\nfz_n = 0.1\n\
                 rise_s = 0.1\nhold_s = 0.4\nfall_s = 0.1",
            ),
            "8: `[[press]]`: with its middle at 2.00, 0.00 mm the contact goes beyond the outer feelers at \
             ±2.7, ±3.3 mm; move it inwards, press less or take a smaller indenter",
        ),
        (
            sheet(
                "[[random]]\nat_s = 0\npresses = 1\neach_s = 1\nx_mm = [0, 0]\ny_mm = [0, 0]\n\
                 fz_n = [0, 0.01]",
            ),
            "6: `[[random]]`: the sheet takes [[press]], [[tap]], [[roll]] and [[slide]]",
        ),
    ]);
}

#[test]
fn non_utf8_file_reports_the_encoding() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("latin1.toml");
    std::fs::write(&path, b"description = \"\xe9\"\n").unwrap();
    let message = Scene::load(path.to_str().unwrap()).unwrap_err().to_string();
    assert!(message.ends_with("; save it as plain text, UTF-8"), "{message}");
    assert_eq!(message.lines().count(), 1);
}
