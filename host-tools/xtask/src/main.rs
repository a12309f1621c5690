//! Build and test tasks of this repository: `cargo xtask test`, `cargo xtask firmware BOARD`,
//! `cargo xtask cycles`.
//!
//! The boards build with whatever can build for a Cortex-M here ([`toolchain`]), so that the committed
//! cargo configuration names none of it and a clean clone needs one command.

mod costs;
mod cycles;
mod emulator;
mod firmware;
mod image;
mod judge;
mod memory;
mod packages;
mod panics;
mod peers;
mod python;
mod run;
mod stack;
mod steps;
mod test;
mod toolchain;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::cycles::Cycles;
use crate::judge::Judge;
use crate::steps::Steps;
use crate::toolchain::Choice;

/// Build and test tasks of this repository
#[derive(Parser)]
#[command(name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
    /// What builds for the boards: the first that works, rustup's target, or Debian's rustc-web
    #[arg(long, value_enum, default_value_t = Choice::Auto, global = true)]
    toolchain: Choice,
}

#[derive(Subcommand)]
enum Task {
    /// Everything that must hold before a change goes in
    Test {
        /// Where
        #[arg(value_enum, default_value_t = test::Part::All)]
        part: test::Part,
    },
    /// Builds the firmware of a board; prints the file on stdout, its sizes on stderr
    Firmware {
        /// A folder of `boards/`
        board: String,
    },
    /// Builds the emulator and the boards' images for `taxel demo --emulated` and `taxel replay --on`
    Emulator,
    /// What every stage of the core costs on a Cortex-M4F: exact instructions, modelled cycles
    Cycles(Cycles),
    /// Whether calibration reaches what is asked of it on recordings that are not in the repository
    Judge(Judge),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let mut steps = Steps::default();
    let done = match arguments.task {
        Task::Test { part } => test::all(part, arguments.toolchain, &mut steps),
        Task::Firmware { board } => firmware::task(&board, arguments.toolchain),
        Task::Emulator => emulator::task(arguments.toolchain),
        Task::Cycles(cycles) => cycles::task(&cycles, arguments.toolchain),
        Task::Judge(judge) => judge::task(&judge),
    };
    match done {
        Ok(()) => {
            steps.summary();
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}
