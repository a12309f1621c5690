//! Tests that run the manuals' shell blocks as written.

mod elsewhere;

use std::path::{Path, PathBuf};

use crate::common::In;
use taxel::measured::NoValue;

/// Pages with shell blocks, and some that may get one.
const MANUALS: [&str; 18] = [
    "README.md",
    "docs/accuracy.md",
    "docs/bench-protocol.md",
    "docs/boards/stm32f411.md",
    "docs/boards/stm32g431.md",
    "docs/boards/weact-stm32g431.md",
    "docs/build-a-finger.md",
    "docs/calibrate.md",
    "docs/getting-started.md",
    "docs/protocol.md",
    "docs/read-the-numbers.md",
    "docs/ros2.md",
    "docs/scenes.md",
    "docs/security.md",
    "docs/troubleshooting.md",
    "host-tools/c/README.md",
    "host-tools/cli/assets/README.md",
    "host-tools/python/README.md",
];

/// Pages whose shell blocks this file does not run, but the Python client's `test_c.py`.
const NOT_A_SCRIPT: [&str; 1] = ["host-tools/c/README.md"];

/// Shell prologue of a manual's blocks: substitutes for what a test cannot have.
#[cfg(unix)]
const PRELUDE: &str = r#"
set -euo pipefail
# Passes a command that is known to be run elsewhere.
elsewhere() {
    local all="$*" beginning
    while read -r beginning; do
        [[ "$all " != "$beginning "* ]] || return 0
    done <<< "$ELSEWHERE"
    echo "no test runs \`$all\`: run it in PRELUDE, or list it in elsewhere.rs" >&2
    return 1
}
taxel() {
    local all=" $* " word words=()
    case "$all" in
        " bench-report "*) cp "$ROOT/docs/$2" . ;;
        " chart "*) elsewhere taxel "$@"; set -- chart --help ;;
        *" --inputs "* | *" --sensor "*) ;;
        # A net of four units is fitted in seconds; how good nets are is no matter of the manuals.
        " calibrate fit "*) set -- "$@" --hidden 4 ;;
        " bridge "*)
            # The quick profile builds neither feature. The manual's address may be in use.
            for word; do
                [[ "$word" != --@(zenoh|foxglove) || " $FEATURES " == *" ${word#--} "* ]] || { "$TAXEL" help bridge; return; }
                words+=("$word")
                [[ "$word" != --foxglove ]] || words+=(127.0.0.1:0)
            done
            set -- "${words[@]}" ;;
    esac
    # A command that runs until Ctrl-C gets it after four seconds, once, and must end well. Another page may be served.
    case "$all" in
        *" --duration "* | *" --help "*) ;;
        " view "* | " serve "* | " demo "* | " bridge "*)
            [[ "$all" != " view "* ]] || set -- "$@" --listen 127.0.0.1:0
            timeout --foreground --preserve-status --signal=INT 4 "$TAXEL" "$@"
            return ;;
    esac
    "$TAXEL" "$@"
}
cargo() {
    case "$1 ${2-}" in
        "demo ") grep -q '^demo = "run .*taxel -- demo"' "$ROOT/.cargo/config.toml" && taxel demo && return ;;
        "install --path") test -f "$ROOT/$3/Cargo.toml" ;;
        "run -p") test -f "$ROOT/host-tools/${3#taxel-}/Cargo.toml" ;;
    esac
    elsewhere cargo "$@"
}
sudo() {
    case "$1" in
        tee) cat > "$(basename "$2")" ;;
        *) elsewhere sudo "$@" ;;
    esac
}
pip() { test -f "$ROOT/${2%[*}/pyproject.toml" && elsewhere pip "${@%[*}"; }
rust-objcopy() { [[ " $* " == *".elf "*".bin "* ]] && elsewhere rust-objcopy "$@"; }
dfu-util() { [[ " $* " == *" --download "*".bin "* ]] && elsewhere dfu-util "$@"; }
"#;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn text(manual: &str) -> String {
    std::fs::read_to_string(root().join(manual)).unwrap()
}

/// Collects the blocks of a kind.
fn blocks(manual: &str, kind: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    let mut inside = false;
    for line in text(manual).lines() {
        match line.trim().strip_prefix("```") {
            Some(named) => {
                inside = !inside && named == kind;
                if inside {
                    found.push(String::new());
                }
            }
            None if inside => *found.last_mut().unwrap() += &format!("{line}\n"),
            None => {}
        }
    }
    found
}

/// Runs a manual from top to bottom in one folder. A board's port in it becomes a pseudo-terminal
/// of an unloaded virtual finger.
#[cfg(unix)]
fn run(manual: &str) -> tempfile::TempDir {
    use taxel_cli::VirtualFinger;
    use taxel_cli::virtual_finger::Source;
    let folder = tempfile::tempdir().unwrap();
    let idle = root().join("host-tools/cli/tests/scenes/idle.toml");
    let source = Source::scene(idle.to_str().unwrap()).unwrap();
    let finger = VirtualFinger::on_pty(source, None).unwrap();
    for block in blocks(manual, "toml") {
        // The scene in a page is the file that its commands run.
        std::fs::write(folder.path().join("my.toml"), block).unwrap();
    }
    let features = [("zenoh", cfg!(feature = "zenoh")), ("foxglove", cfg!(feature = "foxglove"))];
    let features = features.iter().filter(|(_, built)| *built).map(|(name, _)| *name);
    let features = features.collect::<Vec<_>>().join(" ");
    for block in blocks(manual, "sh") {
        let script = block.replace("/dev/ttyACM0", &finger.port().to_string());
        let output = std::process::Command::new("bash")
            .args(["-c", &format!("{PRELUDE}{script}")])
            .env("TAXEL", env!("CARGO_BIN_EXE_taxel"))
            .env("ROOT", root())
            .env("ELSEWHERE", elsewhere::ELSEWHERE.map(|(beginning, _)| beginning).join("\n"))
            .env("FEATURES", &features)
            // A test must open no browser.
            .env_remove("DISPLAY")
            .env_remove("WAYLAND_DISPLAY")
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{manual}:\n{block}{said}");
    }
    folder
}

/// Lists all pages of the repository.
fn pages() -> Vec<String> {
    let mut open = vec![root()];
    let mut found = Vec::new();
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let (path, name) = (entry.path(), entry.file_name().into_string().unwrap());
            if path.is_dir() && !name.starts_with('.') && name != "target" {
                open.push(path);
            } else if name.ends_with(".md") && name != "CHANGELOG.md" {
                found.push(path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned());
            }
        }
    }
    found
}

#[test]
fn every_manual_with_shell_block_is_listed() {
    let found = pages();
    assert!(found.len() >= MANUALS.len(), "{found:?}");
    for manual in found {
        let listed = MANUALS.contains(&manual.as_str());
        assert!(listed || blocks(&manual, "sh").is_empty(), "{manual} is not among the manuals");
        // The Python client's `test_readme.py` runs those of its page.
        let python =
            blocks(&manual, "python").is_empty() || manual == "host-tools/python/README.md";
        assert!(python, "{manual}: no test runs its Python");
    }
}

#[cfg(unix)]
#[test]
fn other_manuals_run_as_written() {
    let apart = ["README.md", "docs/getting-started.md", "docs/calibrate.md"];
    let here = |manual: &&&str| !apart.contains(manual) && !NOT_A_SCRIPT.contains(manual);
    for manual in MANUALS.iter().filter(here) {
        run(manual);
    }
}

#[test]
fn every_flag_and_every_reason_is_explained() {
    let manual = include_str!("../../../../docs/read-the-numbers.md");
    let page = include_str!("../../assets/page/flags.js");
    for name in taxel::frame::schema::BITS.iter().map(|bit| bit.name) {
        if !name.starts_with("ran-") {
            assert!(manual.contains(&format!("| `{name}` |")), "{name}");
            assert!(page.contains(&format!("\"{name}\":")), "{name}");
        }
    }
    for reason in NoValue::ALL {
        let words = taxel_files::frames::reason(reason);
        assert!(manual.contains(&format!("| {words} |")), "{words}");
    }
}

#[test]
fn commands_named_in_manuals_exist() {
    let help = In(std::path::Path::new(".")).succeeds(&["--help"]);
    for manual in [
        "docs/build-a-finger.md",
        "docs/calibrate.md",
        "docs/getting-started.md",
        "docs/read-the-numbers.md",
        "docs/ros2.md",
        "docs/troubleshooting.md",
        "README.md",
    ]
    .map(text)
    {
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

/// Manuals that stream or fit for a minute.
#[cfg(unix)]
mod endurance {
    use super::{In, blocks, run};
    use crate::common::json;

    #[test]
    fn getting_started_runs_as_written() {
        let folder = run("docs/getting-started.md");
        for name in [
            "taxel.bash",
            "man1/taxel.1",
            "tour.mcap",
            "tour.csv",
            "tour.parquet",
            "second.csv",
            "again.csv",
        ] {
            let size = std::fs::metadata(folder.path().join(name)).unwrap().len();
            assert!(size > 1000, "{name}: {size} bytes");
        }
        let rule = std::fs::read_to_string(folder.path().join("70-taxel.rules")).unwrap();
        assert!(rule.contains("1209"), "{rule}");
    }

    #[test]
    fn readme_runs_as_written() {
        let folder = run("README.md");
        for name in ["finger.html", "today.toml", "frames.csv", "tour.mcap", "tour.parquet"] {
            assert!(folder.path().join(name).metadata().unwrap().len() > 1000, "{name}");
        }
    }

    #[test]
    fn calibration_manual_runs_as_written() {
        let folder = run("docs/calibrate.md");
        let read = |name| std::fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(read("finger.toml").contains("F-0042"));
        let weights = |text: &str| text.lines().filter(|line| line.contains("= [")).count();
        assert_eq!(weights(&read("read-back.toml")), weights(&read("finger.toml")));
        // The page quotes what it prints of an aged finger. Another processor rounds differently.
        let quoted = blocks("docs/calibrate.md", "text");
        let quoted = quoted.iter().find(|block| block.contains("stiffness of the skin")).unwrap();
        let args = "calibrate adjust --data aged.csv --reference cell-4.csv --calibration finger.toml --out again.toml";
        let args: Vec<&str> = args.split_whitespace().collect();
        let told = In(folder.path()).succeeds(&args);
        let told: Vec<&str> = told.lines().skip_while(|line| !line.ends_with("presses")).collect();
        for (quoted, told) in quoted.lines().zip(told) {
            let words = [quoted, told].map(|line| line.split_whitespace().collect::<Vec<_>>());
            let number = |word: &str| word.trim_start_matches('(').parse::<f64>().ok();
            let near = |(a, b): (&&str, &&str)| match (number(a), number(b)) {
                (Some(a), Some(b)) => (a - b).abs() < 0.3 + 0.1 * a.abs(),
                _ => a == b,
            };
            let same = words[0].len() == words[1].len();
            assert!(same && words[0].iter().zip(&words[1]).all(near), "{quoted}\n{told}");
        }
        // On an unseen recording the aged finger is as good as the given record, or as a young one.
        let unseen = "simulate --scene shear --finger reference --seed 5 --out";
        let aged = "aged-5.csv --set material.young_mpa=0.206 --set electronics.load_ohm=13950";
        for out in ["young-5.csv", aged] {
            let args = format!("{unseen} {out}");
            In(folder.path()).succeeds(&args.split_whitespace().collect::<Vec<_>>());
        }
        let judged = |record, data| {
            let args = ["calibrate", "evaluate", "--calibration", record, "--data", data, "--json"];
            json(&In(folder.path()).succeeds(&args))
        };
        let young = judged("finger.toml", "young-5.csv");
        let [given, repaired] = ["finger.toml", "today.toml"].map(|r| judged(r, "aged-5.csv"));
        for force in ["fx_n", "fy_n", "fz_n"] {
            let [young, given, repaired] =
                [&young, &given, &repaired].map(|of| of[force]["rmse"].as_f64().unwrap());
            let most = 1.05 * given.max(young);
            assert!(repaired < most, "{force}: {given} given, {repaired} repaired, {young} young");
        }
        let points = |of: &serde_json::Value| of["x_mm"]["n"].as_u64().unwrap();
        assert!(points(&given) < 100 && points(&repaired) > 30_000, "{given} {repaired}");
    }
}
