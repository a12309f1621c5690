//! The `taxel` command, with the parts that its tests share: virtual finger, page, recordings.
//!
//! Each command is a file in `commands` with its `Args` and its `run`. Results go to standard
//! output, everything else to standard error. An error is one line. Exit codes: 0 success, 1
//! failure, 2 bad usage.

mod browser;
mod commands;
mod emulated;
mod failure;
mod files;
pub mod finger;
mod interrupt;
mod output;
mod stream;
pub mod view;
pub mod virtual_finger;

pub use files::Files;
pub use virtual_finger::VirtualFinger;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{CommandFactory, Error, FromArgMatches, Parser, Subcommand};

/// Newtons and millimetres from an optical tactile fingertip.
#[derive(Parser)]
#[command(name = "taxel", version, after_help = AFTER_HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const AFTER_HELP: &str = "\
PORT is usb (the finger that is plugged in), usb:SERIAL, a serial device (/dev/ttyACM0, COM3),
tcp:HOST:PORT, file:PATH, a trace or recording
played back in real time, or sim:SCENE, a virtual finger. Without hardware, start with `taxel demo`.";

#[derive(Subcommand)]
enum Command {
    Demo(commands::demo::Args),
    Simulate(commands::simulate::Args),
    Replay(commands::replay::Args),
    #[cfg(feature = "full")]
    Calibrate(commands::calibrate::Args),
    #[cfg(feature = "full")]
    Chart(commands::chart::Args),
    #[cfg(feature = "full")]
    BenchReport(commands::bench_report::Args),
    View(commands::view::Args),
    Record(commands::record::Args),
    Export(commands::export::Args),
    #[cfg(feature = "full")]
    Bridge(commands::bridge::Args),
    Serve(commands::serve::Args),
    Info(commands::info::Args),
    Bias(commands::bias::Args),
    Set(commands::set::Args),
    SelfTest(commands::self_test::Args),
    Dfu(commands::dfu::Args),
    Ports(commands::ports::Args),
    Udev(commands::udev::Args),
    #[cfg(feature = "full")]
    Completions(commands::completions::Args),
    #[cfg(feature = "full")]
    Man(commands::man::Args),
    #[cfg(not(feature = "full"))]
    #[command(external_subcommand)]
    Other(Vec<String>),
}

/// Parses a command line.
fn parse(words: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> Result<Cli, Error> {
    let mut parser = with_negative_numbers(Cli::command());
    let mut matches = parser.try_get_matches_from_mut(words)?;
    Cli::from_arg_matches_mut(&mut matches).map_err(|error| error.format(&mut parser))
}

/// Lets options take negative numbers, so that their own range refuses `--rate -5`.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let takes = |argument: clap::Arg| {
        let value = argument.get_action().takes_values();
        argument.allow_negative_numbers(value)
    };
    command.mut_args(takes).mut_subcommands(with_negative_numbers)
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let cli = match parse(std::env::args_os()) {
        Ok(cli) => cli,
        Err(error) => return failure::usage(&error),
    };
    let done = match cli.command {
        Command::Demo(args) => commands::demo::run(args),
        Command::Simulate(args) => commands::simulate::run(args),
        Command::Replay(args) => commands::replay::run(args),
        #[cfg(feature = "full")]
        Command::Calibrate(args) => commands::calibrate::run(args),
        #[cfg(feature = "full")]
        Command::Chart(args) => commands::chart::run(args),
        #[cfg(feature = "full")]
        Command::BenchReport(args) => commands::bench_report::run(&args),
        Command::View(args) => commands::view::run(args),
        Command::Record(args) => commands::record::run(args),
        Command::Export(args) => commands::export::run(args),
        #[cfg(feature = "full")]
        Command::Bridge(args) => commands::bridge::run(args),
        Command::Serve(args) => commands::serve::run(args),
        Command::Info(args) => commands::info::run(args),
        Command::Bias(args) => commands::bias::run(args),
        Command::Set(args) => commands::set::run(args),
        Command::SelfTest(args) => commands::self_test::run(args),
        Command::Dfu(args) => commands::dfu::run(args),
        Command::Ports(args) => commands::ports::run(args),
        Command::Udev(args) => commands::udev::run(args),
        #[cfg(feature = "full")]
        Command::Completions(args) => commands::completions::run(args),
        #[cfg(feature = "full")]
        Command::Man(args) => commands::man::run(args),
        #[cfg(not(feature = "full"))]
        Command::Other(words) => Err(anyhow::anyhow!(
            "{}: not in the small build of `cargo demo`; in the repository run `cargo install --path host-tools/cli`",
            words.join(" ")
        )),
    };
    failure::exit_code(done)
}

#[cfg(test)]
mod tests {
    use taxel_sim::scene::built_in;

    use super::*;

    /// Collects every command with its examples.
    fn examples(command: &clap::Command, found: &mut Vec<(String, Vec<String>)>) {
        command.get_subcommands().for_each(|command| examples(command, found));
        let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let lines = help.lines().filter_map(|line| line.find("taxel ").map(|at| &line[at..]));
        found.push((command.get_name().to_owned(), lines.map(str::to_owned).collect()));
    }

    /// Collects a page's commands: whole lines of code blocks, and code spans in sentences.
    fn commands(page: &str) -> Vec<String> {
        let mut found = Vec::new();
        let mut prose = String::new();
        let mut inside = false;
        for line in page.lines() {
            match line.trim().starts_with("```") {
                true => inside = !inside,
                false if inside => found.push(line.to_owned()),
                false => prose += &format!("{line}\n"),
            }
        }
        found.extend(prose.split('`').skip(1).step_by(2).map(str::to_owned));
        found.retain(|command| command.starts_with("taxel ") && !command.ends_with('…'));
        found
    }

    /// Commands that pages name without their required arguments.
    const NAMED: [&str; 7] = [
        "taxel calibrate upload",
        "taxel simulate",
        "taxel record",
        "taxel replay",
        "taxel export",
        "taxel bridge",
        "taxel bridge --zenoh",
    ];

    #[test]
    fn commands_in_manuals_parse() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let text = |name: &str| std::fs::read_to_string(root.join(name)).unwrap();
        let mut pages = ["README.md", "host-tools/python/README.md"].map(text).to_vec();
        for folder in ["docs", "docs/boards"] {
            let files =
                std::fs::read_dir(root.join(folder)).unwrap().map(|file| file.unwrap().path());
            let manuals = files.filter(|file| file.extension().is_some_and(|kind| kind == "md"));
            pages.extend(manuals.map(|file| std::fs::read_to_string(file).unwrap()));
        }
        // The live page's advice stands without backticks.
        let advice = include_str!("../assets/page/flags.js");
        let advice =
            advice.match_indices(": taxel ").map(|(at, _)| advice[at + 2..].split(". ").next());
        let advice = advice.map(|words| words.unwrap().split(".\"").next().unwrap().to_owned());
        let mut given: Vec<_> =
            advice.chain(pages.iter().flat_map(|page| commands(page))).collect();
        given.retain(|command| !NAMED.contains(&command.as_str()));
        assert!(given.len() > 80, "{}", given.len());
        for command in given {
            // Up to the shell's own syntax or a second column.
            let words = command.split(['\\', ';', '|', '>', '&', '#']).next().unwrap();
            let words = words.split("   ").next().unwrap();
            let parsed = parse(words.split_whitespace());
            let understood = parsed.err().is_none_or(|error| !error.use_stderr());
            assert!(understood, "`{command}`");
        }
    }

    #[test]
    fn every_command_has_examples_that_parse() {
        let mut found = Vec::new();
        Cli::command().get_subcommands().for_each(|command| examples(command, &mut found));
        assert!(found.len() > 20);
        for (name, lines) in found {
            assert!(!lines.is_empty(), "{name} has no example");
            for line in lines {
                // Up to the shell's own syntax.
                let words =
                    line.split([';', '|', '>', '&', '#']).next().unwrap().split_whitespace();
                let words: Vec<_> = words.collect();
                assert!(parse(&words).is_ok(), "{line}");
                let scenes =
                    words.windows(2).filter(|pair| pair[0] == "--scene").map(|pair| pair[1]);
                let ports = words.iter().filter_map(|word| word.strip_prefix("sim:"));
                for scene in scenes.chain(ports) {
                    assert!(built_in().any(|(name, _)| name == scene), "{line}");
                }
            }
        }
    }

    #[test]
    fn negative_number_is_refused_by_its_range() {
        for (words, range) in [
            ("bias take --scans -3", "2..=65535"),
            ("self-test --scans -1", "2..=4096"),
            ("calibrate fit --data a.csv --out a.toml --hidden -2", "1..=32"),
        ] {
            let error = parse(["taxel"].into_iter().chain(words.split(' '))).err().unwrap();
            let line = error.to_string();
            assert!(line.contains(&format!("is not in {range}")), "{words}: {line}");
        }
    }
}
