//! Exit codes, and errors in one line.

use std::process::ExitCode;

use clap::error::ErrorKind;

use crate::output::{self, Closed};

/// Exit code of a command that failed.
const FAILED: u8 = 1;
/// Exit code of an invalid command line.
const USAGE: u8 = 2;

/// Converts a command's result to an exit code, and prints its error on one line.
pub fn exit_code(done: anyhow::Result<()>) -> ExitCode {
    match done {
        Ok(()) => ExitCode::SUCCESS,
        // A closed output, as in `taxel … | head`, is no failure.
        Err(error) if error.is::<Closed>() => ExitCode::SUCCESS,
        Err(error) => {
            output::note(format_args!("taxel: {}", one_line(&format!("{error:#}"))));
            ExitCode::from(FAILED)
        }
    }
}

/// Prints a parser's error, or the help, and returns the exit code.
pub fn usage(error: &clap::Error) -> ExitCode {
    if !error.use_stderr() {
        // Help or version: a closed standard output is no failure.
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        // Without a subcommand the whole help is printed.
        let _ = error.print();
        return ExitCode::from(USAGE);
    }
    output::note(format_args!("taxel: {}", usage_line(&error.to_string())));
    ExitCode::from(USAGE)
}

/// Shortens a parser's message to one line, without usage and hints, which `--help` shows.
fn usage_line(message: &str) -> String {
    let message = message.split("\n\nUsage:").next().unwrap_or(message);
    let message = message.split("\n\nFor more information").next().unwrap_or(message);
    let line = one_line(&message.trim_start_matches("error:").replace("\n\n  tip:", ";"));
    if line.contains("--help") { line } else { format!("{line}; see --help") }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parser_error_is_shortened_to_one_line() {
        let message = "error: the following required arguments were not provided:\n  --out <FILE>\n\n\
                       Usage: taxel export --out <FILE>\n\nFor more information, try '--help'.\n";
        assert_eq!(
            usage_line(message),
            "the following required arguments were not provided: --out <FILE>; see --help"
        );
    }
}
