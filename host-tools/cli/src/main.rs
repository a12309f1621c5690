//! The `taxel` command; see [`taxel_cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    taxel_cli::main()
}
