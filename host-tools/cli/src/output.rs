//! Standard output, which may be closed at any time.

use std::fmt::Display;
use std::io::{self, Write};
use std::path::Path;
use std::time::Duration;

use indicatif::ProgressBar;

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

/// Says something on standard error, which may be closed: then nobody wants to know.
pub fn note(text: impl Display) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// Shows on a terminal that something is at work whose end cannot be told, such as a recording that becomes Parquet.
pub fn waiting<T>(what: String, work: impl FnOnce() -> T) -> T {
    let bar = ProgressBar::new_spinner().with_message(what);
    bar.tick();
    bar.enable_steady_tick(Duration::from_millis(100));
    let done = work();
    bar.finish_and_clear();
    done
}

/// Refuses to write where something is read from.
///
/// # Errors
/// `out` is one of `inputs`, by whatever name.
pub fn keep<'p>(inputs: impl IntoIterator<Item = &'p Path>, out: &Path) -> anyhow::Result<()> {
    let Ok(target) = out.canonicalize() else { return Ok(()) };
    let same = inputs.into_iter().find(|input| input.canonicalize().is_ok_and(|i| i == target));
    match same {
        None => Ok(()),
        Some(input) => anyhow::bail!(
            "{}: --out would overwrite what is read from ({}); choose another name",
            out.display(),
            input.display()
        ),
    }
}

/// Prints a result for scripts, as one line of JSON.
///
/// # Errors
/// As [`line`].
pub fn json(result: &impl serde::Serialize) -> anyhow::Result<()> {
    line(serde_json::to_string(result)?)
}
