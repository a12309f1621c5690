//! Zenoh, or a server for Foxglove, behind a pipe: `taxel bridge` starts this program and writes [`Order`]s to
//! its standard input, until it closes it. Nothing in here knows what a finger is, and nothing in `taxel` what
//! Zenoh or a WebSocket is.
//!
//! [`Order`]: order::Order

mod foxglove_server;
mod order;
mod zenoh_peer;

use std::error::Error;
use std::io::{BufReader, StdinLock, Write};
use std::process::ExitCode;

/// Whatever went wrong, in the words of whom it happened to.
type Failure = Box<dyn Error + Send + Sync>;

fn main() -> ExitCode {
    let words: Vec<_> = std::env::args().skip(1).collect();
    let ran = match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["zenoh", config] => zenoh_peer::run(config),
        ["foxglove", address] => foxglove_server::run(address),
        _ => Err(
            "taxel-bridge zenoh CONFIG | foxglove HOST:PORT: it is `taxel bridge` that calls it"
                .into(),
        ),
    };
    match ran {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // `taxel bridge` makes one line of its own out of it.
            let _ = writeln!(std::io::stderr(), "{error}");
            ExitCode::FAILURE
        }
    }
}

/// Says that orders can come.
fn ready(said: &str) -> std::io::Result<BufReader<StdinLock<'static>>> {
    writeln!(std::io::stdout(), "ready {said}")?;
    Ok(BufReader::with_capacity(1 << 16, std::io::stdin().lock()))
}
