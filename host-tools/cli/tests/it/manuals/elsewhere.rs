//! Commands of the pages that the manuals' tests do not run, each with the reason or the test that
//! does.

use super::{MANUALS, NOT_A_SCRIPT, pages, root, text};

/// Beginnings of the commands, word by word, and what runs them.
pub const ELSEWHERE: [(&str, &str); 44] = [
    // Steps of `cargo xtask test`, of which the manuals' tests are one: they would wait for its lock.
    ("cargo test -p taxel", "host tests of `cargo xtask test`"),
    ("cargo xtask cycles", "step `instructions and cycles of every stage`"),
    ("cargo xtask emulator", "step `tests on the emulated boards`"),
    ("cargo xtask firmware stm32g431", "step `firmware of stm32g431`"),
    ("cargo xtask hardware", "test of xtask, with --check"),
    ("cargo xtask pages", "step `parts made from tables`, with --check"),
    ("cargo xtask protocol", "step `parts made from the frame schema`, with --check"),
    ("cargo xtask registers", "step `tables of the chips' registers`, with --check"),
    ("cargo xtask test", "this run"),
    // Programs of the network that no part of `.ci/setup` installs.
    ("cargo xtask book", "needs mdBook; a test of xtask follows the pages' links"),
    (
        "cargo xtask release --out dist",
        "needs cargo-about and cargo-cyclonedx; release.yml runs it",
    ),
    (
        "cargo install --path host-tools/cli",
        "minutes; `cargo xtask release` builds the same program",
    ),
    ("pip install ./host-tools/cli", "minutes; `cargo xtask release` builds the wheel"),
    ("pip install ./host-tools/python", "step `Python client: types, lints, installation`"),
    ("pip install './host-tools/python[rerun,recordings]'", "step `Python client` has both"),
    ("pip install eclipse-zenoh rosbags", "step `Python client` has both in its environment"),
    ("ros2 topic echo", "needs ROS 2; test_bridge.py subscribes to the topic"),
    ("ros2 service call", "needs ROS 2; test_ros.py calls the service"),
    ("ros2 param set", "needs ROS 2; test_ros.py sets the parameter"),
    // A board, or a person who presses it.
    ("dfu-util", "needs a chip in its bootloader"),
    ("rust-objcopy", "needs LLVM's tools; the image is that of `cargo xtask firmware`"),
    ("sudo udevadm", "changes this machine; `taxel udev` is run"),
    (
        "taxel bridge --zenoh --port usb",
        "needs a board; the same bridge runs on `sim:` in this file",
    ),
    ("taxel calibrate record", "needs a person; tests `guided_recording` press a simulated finger"),
    // The emulator's own workspace, and the long forms of tests.
    ("cargo nextest run", "step `tests of the emulator`; long forms: profile nightly"),
    ("cargo run -- board", "step `tests of the emulator`"),
    ("cargo run -- faults", "step `tests of the emulator` compares its tables"),
    ("cargo run -- serve", "step `tests on the emulated boards`"),
    ("cargo run -p taxel-research -- peers", "needs arm-none-eabi-gcc; minutes"),
    ("taxel chart", "minutes; tests of `taxel-research` compare its tables"),
    ("taxel demo --emulated", "step `tests on the emulated boards`"),
    ("taxel replay TRACE.csv --on stm32g431", "step `tests on the emulated boards`"),
    ("TAXEL_LONG=1 cargo test --release -p taxel", "profile nightly"),
    ("TAXEL_LONG=1 cargo nextest run -p taxel-cli", "profile nightly"),
    // The Python client's tests.
    ("python3 host-tools/ros2/listen.py", "test_bridge.py"),
    ("python host-tools/python/examples/show_in_rerun.py", "test_rerun.py"),
    ("taxel bridge --zenoh --port sim:press --port sim:shear", "test_bridge.py"),
    ("cmake -S host-tools/c -B build", "test_c.py"),
    ("cmake --build build", "test_c.py"),
    ("cmake --install build", "test_c.py"),
    ("./build/finger", "test_c.py"),
    ("PKG_CONFIG_PATH=installed/share/pkgconfig pkg-config", "test_c.py"),
    ("alias taxel=", "an alias is for people; these tests define `taxel`"),
    ("cd", "leads to the next command"),
];

/// Programs by which a line of a block that is no script is known as a command.
const PROGRAMS: [&str; 22] = [
    "alias",
    "apt-get",
    "brew",
    "cargo",
    "cargo-binstall",
    "cd",
    "cmake",
    "curl",
    "dfu-util",
    "docker",
    "espflash",
    "git",
    "make",
    "pip",
    "probe-rs",
    "python",
    "python3",
    "ros2",
    "rust-objcopy",
    "rustup",
    "sudo",
    "taxel",
];

/// Returns whether the list has a command.
fn is_elsewhere(command: &str) -> bool {
    ELSEWHERE.iter().any(|(beginning, _)| begins(command, beginning))
}

fn begins(command: &str, beginning: &str) -> bool {
    let rest = command.strip_prefix(beginning);
    rest.is_some_and(|rest| {
        rest.is_empty() || rest.starts_with([' ', '"']) || beginning.ends_with('=')
    })
}

/// Lists the commands of a page's blocks that no shell runs.
fn unrun(page: &str) -> Vec<String> {
    let scripts = MANUALS.contains(&page) && !NOT_A_SCRIPT.contains(&page);
    let (text, mut commands, mut kind) = (text(page), Vec::new(), None);
    for line in text.lines().map(str::trim) {
        if let Some(named) = line.strip_prefix("```") {
            kind = if kind.is_none() { Some(named) } else { None };
            continue;
        }
        let Some(kind) = kind else { continue };
        let script = kind == "sh";
        if script && scripts || !script && !["", "text", "console"].contains(&kind) {
            continue;
        }
        commands.extend(
            line.split(" && ").filter(|part| script || is_command(part)).map(str::to_owned),
        );
    }
    commands.retain(|command| !command.is_empty());
    commands
}

/// Returns whether a line begins with a program, behind any settings of the environment.
fn is_command(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let setting = |word: &&str| {
        word.split_once('=')
            .is_some_and(|(name, _)| name.chars().all(|c| c.is_ascii_uppercase() || c == '_'))
    };
    let program = words.find(|word| !setting(word)).unwrap_or_default();
    program.starts_with("./") || PROGRAMS.contains(&program)
}

#[test]
fn commands_that_no_shell_runs_are_listed() {
    let pages = pages();
    let found: Vec<_> = pages
        .iter()
        .flat_map(|page| unrun(page).into_iter().map(move |line| (page, line)))
        .collect();
    assert!(found.len() > 50, "{found:?}");
    for (page, command) in found {
        assert!(
            is_elsewhere(&command),
            "{page}: no test runs `{command}`; make its block `sh`, or \
             list it with the test that does"
        );
    }
}

#[test]
fn commands_listed_stand_in_a_page() {
    let blocks: Vec<String> = pages().iter().map(|page| text(page)).collect();
    for (beginning, why) in ELSEWHERE {
        assert!(
            blocks.iter().any(|page| page.contains(beginning)),
            "`{beginning}` ({why}): nowhere"
        );
    }
    // A file named as a command's test is there.
    for (beginning, why) in ELSEWHERE {
        for file in why.split(' ').filter(|word| word.ends_with(".py")) {
            let file = root().join("host-tools/python/tests").join(file);
            assert!(file.exists(), "`{beginning}`: {}", file.display());
        }
    }
}

#[test]
fn unlisted_command_is_noticed() {
    for line in
        ["cargo xtask wash", "taxel fly", "./wash", "TAXEL_LONG=1 cargo wash", "git clone x"]
    {
        assert!(is_command(line) && !is_elsewhere(line), "{line}");
    }
    assert!(is_elsewhere("dfu-util --alt 0") && !is_elsewhere("dfu-utils"));
    assert!(!is_command("445 presses") && !is_command("light of the taxels"));
}
