//! The manuals' commands, run as they are written: every line of a `sh` block that begins with `taxel`.

mod common;

use common::In;

/// The commands of a manual.
fn commands(manual: &str) -> Vec<String> {
    let mut inside = false;
    let mut commands = Vec::new();
    for line in manual.lines() {
        match line.trim() {
            "```sh" => inside = true,
            "```" => inside = false,
            line if inside && line.starts_with("taxel ") => commands.push(line.to_owned()),
            _ => {}
        }
    }
    commands
}

#[cfg(unix)]
#[test]
fn every_command_of_getting_started_does_what_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let commands = commands(include_str!("../../../docs/getting-started.md"));
    assert!(commands.len() >= 9, "{commands:?}");
    for command in commands {
        let script = command.replacen("taxel", "\"$TAXEL\"", 1);
        let output = std::process::Command::new("bash")
            .args(["-c", &script])
            .env("TAXEL", env!("CARGO_BIN_EXE_taxel"))
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
    }
    for name in ["taxel.bash", "tour.mcap", "tour.csv", "tour.parquet", "second.csv", "again.csv"] {
        let size = std::fs::metadata(folder.path().join(name)).unwrap().len();
        assert!(size > 1000, "{name}: {size} bytes");
    }
}

#[test]
fn every_flag_and_every_reason_is_explained() {
    let manual = include_str!("../../../docs/read-the-numbers.md");
    let page = include_str!("../../view/assets/flags.js");
    for (_, name) in taxel::frame::Status::NAMES {
        if !name.starts_with("ran-") {
            assert!(manual.contains(&format!("| `{name}` |")), "{name}");
            assert!(page.contains(&format!("\"{name}\":")), "{name}");
        }
    }
    for reason in taxel_formats::frames::REASONS {
        let words = taxel_formats::frames::reason(reason);
        assert!(manual.contains(&format!("| {words} |")), "{words}");
    }
}

#[test]
fn every_command_that_the_manuals_name_is_there() {
    let help = In(std::path::Path::new(".")).succeeds(&["--help"]);
    for manual in [
        include_str!("../../../docs/getting-started.md"),
        include_str!("../../../docs/read-the-numbers.md"),
        include_str!("../../../docs/troubleshooting.md"),
        include_str!("../../../README.md"),
    ] {
        let named = manual.split("taxel ").skip(1).filter_map(|rest| {
            let before = rest.split(|c: char| !c.is_ascii_lowercase() && c != '-').next();
            before
                .filter(|word| word.starts_with(|c: char| c.is_ascii_lowercase()) && word.len() > 2)
        });
        let in_code = named.filter(|word| {
            manual.contains(&format!("`taxel {word}"))
                || manual.contains(&format!("\ntaxel {word}"))
        });
        for word in in_code {
            assert!(help.contains(&format!("\n  {word} ")), "{word}");
        }
    }
}
