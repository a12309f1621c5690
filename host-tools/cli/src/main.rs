//! The `taxel` command.
//!
//! Each command is a file in [`commands`] with its `Args` and its `run`. Results go to standard output,
//! everything else to standard error; an error is one line there. Exit codes: 0 done, 1 the thing
//! failed, 2 bad usage.

mod browser;
mod commands;
mod failure;
mod finger;
mod interrupt;
mod output;
mod stream;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

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
    Calibrate(commands::calibrate::Args),
    Chart(commands::chart::Args),
    View(commands::view::Args),
    Record(commands::record::Args),
    Export(commands::export::Args),
    Bridge(commands::bridge::Args),
    Serve(commands::serve::Args),
    Info(commands::info::Args),
    Bias(commands::bias::Args),
    Set(commands::set::Args),
    SelfTest(commands::self_test::Args),
    Dfu(commands::dfu::Args),
    Ports(commands::ports::Args),
    Udev(commands::udev::Args),
    Completions(commands::completions::Args),
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return failure::usage(&error),
    };
    let done = match cli.command {
        Command::Demo(args) => commands::demo::run(args),
        Command::Simulate(args) => commands::simulate::run(args),
        Command::Replay(args) => commands::replay::run(args),
        Command::Calibrate(args) => commands::calibrate::run(args),
        Command::Chart(args) => commands::chart::run(args),
        Command::View(args) => commands::view::run(args),
        Command::Record(args) => commands::record::run(args),
        Command::Export(args) => commands::export::run(args),
        Command::Bridge(args) => commands::bridge::run(args),
        Command::Serve(args) => commands::serve::run(args),
        Command::Info(args) => commands::info::run(args),
        Command::Bias(args) => commands::bias::run(args),
        Command::Set(args) => commands::set::run(args),
        Command::SelfTest(args) => commands::self_test::run(args),
        Command::Dfu(args) => commands::dfu::run(args),
        Command::Ports(args) => commands::ports::run(args),
        Command::Udev(args) => commands::udev::run(args),
        Command::Completions(args) => commands::completions::run(args),
    };
    failure::exit_code(done)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;
    use taxel_sim::scene::BUILT_IN;

    use super::*;

    /// Every command without subcommands, and its examples.
    fn examples(command: &clap::Command, found: &mut Vec<(String, Vec<String>)>) {
        if command.has_subcommands() {
            command.get_subcommands().for_each(|command| examples(command, found));
            return;
        }
        let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let lines = help.lines().filter_map(|line| line.find("taxel ").map(|at| &line[at..]));
        found.push((command.get_name().to_owned(), lines.map(str::to_owned).collect()));
    }

    #[test]
    fn every_command_has_examples_that_it_understands() {
        let mut found = Vec::new();
        examples(&Cli::command(), &mut found);
        assert!(found.len() > 20);
        for (name, lines) in found {
            assert!(!lines.is_empty(), "{name} has no example");
            for line in lines {
                // Up to where the shell has its say.
                let words = line.split([';', '|', '>', '&']).next().unwrap().split_whitespace();
                let words: Vec<_> = words.collect();
                assert!(Cli::try_parse_from(&words).is_ok(), "{line}");
                let scenes =
                    words.windows(2).filter(|pair| pair[0] == "--scene").map(|pair| pair[1]);
                let ports = words.iter().filter_map(|word| word.strip_prefix("sim:"));
                for scene in scenes.chain(ports) {
                    assert!(BUILT_IN.iter().any(|(name, _)| *name == scene), "{line}");
                }
            }
        }
    }
}
