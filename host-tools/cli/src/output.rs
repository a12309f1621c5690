//! Output of commands; standard output may be closed at any time.

use std::fmt::Display;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use indicatif::ProgressBar;
use taxel_files::recording::Existing;

/// Error of a closed standard output.
#[derive(Debug)]
pub struct Closed;

impl Display for Closed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("standard output is closed")
    }
}

impl std::error::Error for Closed {}

/// Prints a line. `println!` would panic if `taxel … | head` closes the pipe.
///
/// [`Closed`], or another error of standard output (such as a full disk behind a redirection).
pub fn line(text: impl Display) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(Closed.into()),
        Err(error) => Err(anyhow::Error::new(error).context("standard output")),
    }
}

/// Prints a line on standard error, which may be closed.
pub fn note(text: impl Display) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// Runs `work` of unknown length, such as writing Parquet, with a spinner on a terminal.
pub fn waiting<T>(what: String, work: impl FnOnce() -> T) -> T {
    let bar = ProgressBar::new_spinner().with_message(what);
    bar.tick();
    bar.enable_steady_tick(Duration::from_millis(100));
    let done = work();
    bar.finish_and_clear();
    done
}

/// Checks before the work that `out` can be written and is none of `inputs`.
///
/// `out` exists and is not to be overwritten, it is one of `inputs`, under any name, or its folder
/// is missing or write-protected.
pub fn keep<'p>(
    inputs: impl IntoIterator<Item = &'p Path>,
    out: &Path,
    overwrite: Overwrite,
) -> anyhow::Result<()> {
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder {
        anyhow::ensure!(
            folder.is_dir(),
            "{}: there is no folder {}; make it, or choose another",
            out.display(),
            folder.display()
        );
    }
    let Ok(target) = out.canonicalize() else {
        let folder = folder.unwrap_or(Path::new("."));
        let error = match tempfile::tempfile_in(folder) {
            Ok(_) => return Ok(()),
            Err(error) => error.kind(),
        };
        anyhow::bail!(
            "{}: nothing can be written in {} ({error}); choose another folder",
            out.display(),
            folder.display()
        );
    };
    anyhow::ensure!(!target.is_dir(), "{}: is a folder; name a file in it", out.display());
    let locked = target.metadata().is_ok_and(|file| file.permissions().readonly());
    anyhow::ensure!(
        !locked,
        "{}: is write-protected; choose another name, or take the protection off",
        out.display()
    );
    let same = inputs.into_iter().find(|input| input.canonicalize().is_ok_and(|i| i == target));
    if let Some(input) = same {
        anyhow::bail!(
            "{}: --out would overwrite what is read from ({}); choose another name",
            out.display(),
            input.display()
        );
    }
    // A device, such as /dev/null, is no file that could be lost.
    anyhow::ensure!(
        overwrite.force || !target.is_file(),
        "{}: the file exists already; choose another name, or add --force to overwrite it",
        out.display()
    );
    Ok(())
}

/// Checks that output files are different.
///
/// Two of `outs` are the same file, under any name.
pub fn apart(outs: &[PathBuf]) -> anyhow::Result<()> {
    // A file that does not exist yet is compared by its folder and name.
    let place = |out: &PathBuf| {
        let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new(".")).canonicalize();
        out.canonicalize().or(folder.map(|folder| folder.join(out.file_name().unwrap_or_default())))
    };
    let mut places = Vec::new();
    for out in outs {
        // A path without a folder is reported when it is opened.
        let Ok(place) = place(out) else { continue };
        if places.contains(&place) {
            anyhow::bail!("{}: --out names it twice; give each file once", out.display());
        }
        places.push(place);
    }
    Ok(())
}

/// Option to overwrite existing files.
#[derive(Clone, Copy, clap::Args)]
pub struct Overwrite {
    /// Overwrite existing files.
    #[arg(long)]
    force: bool,
}

impl Overwrite {
    pub fn existing(self) -> Existing {
        if self.force { Existing::Replace } else { Existing::Keep }
    }
}

/// Prints a result for scripts, as one line of JSON.
///
/// # Errors
/// As [`line`].
pub fn json(result: &impl serde::Serialize) -> anyhow::Result<()> {
    line(serde_json::to_string(result)?)
}
