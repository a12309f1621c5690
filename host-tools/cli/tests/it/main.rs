//! Tests of the `taxel` command and of its library's shared parts: one program, linked once.

mod bench_forms;
mod broken_links;
#[cfg(target_os = "linux")]
mod broken_off;
mod browser;
mod calibrations;
mod cli;
mod common;
#[cfg(target_os = "linux")]
mod ctrl_c;
mod emulated_board;
mod endurance;
mod fingers;
#[cfg(target_os = "linux")]
mod fit_on_terminal;
mod hostile;
mod manuals;
mod models;
#[cfg(target_os = "linux")]
mod open_page;
mod output_files;
#[cfg(target_os = "linux")]
mod page_attacks;
mod page_server;
mod pipeline;
mod recordings;
mod refusals;
mod steady;
mod virtual_finger;
