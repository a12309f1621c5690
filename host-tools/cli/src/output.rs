//! Standard output, which may be closed at any time.

use std::fmt::Display;
use std::io::{self, Write};

/// Nobody reads standard output any more.
#[derive(Debug)]
pub struct Closed;

impl Display for Closed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("standard output is closed")
    }
}

impl std::error::Error for Closed {}

/// Prints a line. `println!` would panic where `taxel … | head` closes the pipe.
///
/// # Errors
/// [`Closed`], or what else standard output said (a full disk, behind a redirection).
pub fn line(text: impl Display) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(Closed.into()),
        Err(error) => Err(anyhow::Error::new(error).context("standard output")),
    }
}

/// Prints a result for scripts, as one line of JSON.
///
/// # Errors
/// As [`line`].
pub fn json(result: &impl serde::Serialize) -> anyhow::Result<()> {
    line(serde_json::to_string(result)?)
}
