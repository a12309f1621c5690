//! Exit codes, and errors in one line.

use std::process::ExitCode;

use clap::error::ErrorKind;

use crate::output::{self, Closed};

/// The thing failed.
const FAILED: u8 = 1;
/// The command line is not valid.
const USAGE: u8 = 2;

/// The end of a command that ran.
pub fn exit_code(done: anyhow::Result<()>) -> ExitCode {
    match done {
        Ok(()) => ExitCode::SUCCESS,
        // Whoever read the output has enough, as in `taxel … | head`: nothing failed.
        Err(error) if error.is::<Closed>() => ExitCode::SUCCESS,
        Err(error) => {
            output::note(format_args!("taxel: {}", one_line(&format!("{error:#}"))));
            ExitCode::from(FAILED)
        }
    }
}

/// The end of a command line that was not understood, or that asked for help.
pub fn usage(error: &clap::Error) -> ExitCode {
    if !error.use_stderr() {
        // Help and version: standard output may be closed, which is no failure.
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        // Whoever has not said yet what to do wants to know what there is.
        let _ = error.print();
        return ExitCode::from(USAGE);
    }
    output::note(format_args!("taxel: {}", usage_line(&error.to_string())));
    ExitCode::from(USAGE)
}

/// The parser's message without its usage and hints: those are what `--help` is for.
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
    fn what_the_parser_says_on_many_lines_is_said_on_one() {
        let message = "error: the following required arguments were not provided:\n  --out <FILE>\n\n\
                       Usage: taxel export --out <FILE>\n\nFor more information, try '--help'.\n";
        assert_eq!(
            usage_line(message),
            "the following required arguments were not provided: --out <FILE>; see --help"
        );
    }
}
