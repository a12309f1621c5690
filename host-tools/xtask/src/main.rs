//! Build and test tasks of this repository: `cargo xtask test`, `firmware BOARD`, `cycles`.
//!
//! `.ci/setup` installs the tools that a task needs and the machine lacks.

mod bill;
mod book;
mod changes;
mod costs;
mod cycles;
mod emulator;
mod firmware;
mod fuzz;
mod hardware;
mod image;
mod install;
mod marks;
mod memory;
mod pages;
mod panics;
mod protocol;
mod python;
mod registers;
mod release;
#[cfg(test)]
mod rings;
mod run;
mod stack;
mod steps;
mod test;
mod toolchain;
#[cfg(test)]
mod words;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::cycles::Cycles;
use crate::steps::Steps;
use crate::test::Test;

/// Build and test tasks of this repository
#[derive(Parser)]
#[command(name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Tests what changed since `main`, or with `--profile ci` everything that must hold
    Test(Test),
    /// Builds the firmware of a board; prints the file on stdout, its sizes on stderr
    ///
    /// With DEFMT_LOG=info in the environment, it is BOARD-log.elf, which logs over a probe.
    Firmware {
        /// Name of a board: stm32g431, stm32g473, stm32f411, starter or cycles
        board: String,
    },
    /// Makes the files of a release: images, packages, wheels, archive, SBOMs, licences, checksums
    Release(release::Release),
    /// Builds the emulator and the boards' images, for `taxel demo --emulated` and `replay --on`
    Emulator,
    /// Counts the instructions and modelled cycles of every core stage on a Cortex-M4F
    Cycles(Cycles),
    /// Writes the emulated chips' register table from crates of the manufacturer's SVD files
    Registers {
        /// Writes nothing; fails where the table differs
        #[arg(long)]
        check: bool,
    },
    /// Writes what a finger is built from: schematic, mould, mount, and tables of the front end
    Hardware {
        /// Writes nothing; fails where a file differs
        #[arg(long)]
        check: bool,
    },
    /// Writes the parts of documents that quote committed tables: spec sheet, choices, bench
    Pages(pages::Pages),
    /// Builds the documentation as one book by mdBook into target/book, and checks its links
    Book,
    /// Writes the parts of documents and clients that are generated from src/frame/schema.rs
    Protocol {
        /// Writes nothing; fails where a part differs
        #[arg(long)]
        check: bool,
    },
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let mut steps = Steps::default();
    let done = match arguments.task {
        Task::Test(test) => test::task(&test, &mut steps),
        Task::Firmware { board } => firmware::task(&board),
        Task::Release(release) => release::task(&release, &mut steps),
        Task::Emulator => emulator::task(),
        Task::Cycles(cycles) => cycles::task(&cycles),
        Task::Registers { check } => registers::task(check),
        Task::Hardware { check } => hardware::task(check),
        Task::Pages(pages) => pages::task(&pages),
        Task::Book => book::task(),
        Task::Protocol { check } => protocol::task(check),
    };
    match done.and_then(|()| steps.summary()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}
