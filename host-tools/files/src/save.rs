//! Files written whole or not at all.

use std::ffi::OsStr;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::{Builder, TempPath};

use crate::error::FileError;

/// Replaces `path` atomically by a file that is already on the disk.
///
/// The former contents stay if power, disk or program fail.
///
/// # Errors
/// The file cannot be written, or the former one is read-only.
pub fn save(path: impl AsRef<Path>, contents: impl AsRef<[u8]>) -> Result<(), FileError> {
    let pending = Pending::new(path.as_ref())?;
    let written = pour(pending.path(), contents.as_ref());
    written.map_err(|error| FileError::io(path.as_ref(), &error))?;
    pending.commit()
}

/// Temporary files of this process.
static TEMPORARY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn temporary() -> MutexGuard<'static, Vec<PathBuf>> {
    TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes the temporary files of every [`Pending`], before a program ends without dropping them.
pub fn discard_pending() {
    for path in temporary().drain(..) {
        // One that was given its name meanwhile is gone from here.
        let _ = std::fs::remove_file(path);
    }
}

/// File that gets its name only when it is whole and on the disk.
///
/// Until then it is a temporary file in the same folder, which is removed if it is dropped.
#[derive(Debug)]
pub struct Pending {
    path: PathBuf,
    target: PathBuf,
    former: Option<Metadata>,
    /// `None` for a device or a pipe, which cannot be replaced.
    temporary: Option<TempPath>,
}

impl Pending {
    /// Makes the temporary file.
    ///
    /// # Errors
    /// Nothing can be written in the folder, or the former file is read-only.
    pub fn new(path: impl Into<PathBuf>) -> Result<Self, FileError> {
        let path = path.into();
        // A symbolic link stays in place; its target is replaced.
        let target = path.canonicalize().unwrap_or_else(|_| path.clone());
        let former = target.metadata().ok();
        let temporary = match &former {
            Some(former) if former.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
            Some(former) if !former.is_file() => Ok(None),
            Some(former) if former.permissions().readonly() => {
                Err(io::ErrorKind::PermissionDenied.into())
            }
            _ => beside(&target).map(Some),
        };
        let temporary = temporary.map_err(|error: io::Error| FileError::io(&path, &error))?;
        self::temporary().extend(temporary.as_ref().map(|file| file.to_path_buf()));
        Ok(Self { path, target, former, temporary })
    }

    /// Place to write the contents to.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.temporary.as_deref().unwrap_or(&self.target)
    }

    /// Gives an error of the temporary file the name that the user knows.
    #[must_use]
    pub fn named(&self, error: FileError) -> FileError {
        error.at(&self.path)
    }

    /// Syncs the contents and gives them their name.
    ///
    /// # Errors
    /// The disk is full or the folder is gone; the former file stays.
    pub fn commit(mut self) -> Result<(), FileError> {
        let Some(temporary) = self.temporary.take() else { return Ok(()) };
        let Self { path, target, former, .. } = &self;
        let replaced = rename(&temporary, target, former.as_ref());
        forget(&temporary);
        replaced.map_err(|error| FileError::io(path, &error))
    }
}

/// Syncs a file beside `target`, and gives it that name and the rights of the former file.
pub(crate) fn rename(file: &Path, target: &Path, former: Option<&Metadata>) -> io::Result<()> {
    let synced = File::open(file)?;
    if let Some(former) = former {
        synced.set_permissions(former.permissions())?;
    }
    synced.sync_all()?;
    std::fs::rename(file, target)?;
    // On Unix the folder holds the name and needs its own sync.
    if cfg!(unix) { File::open(folder(target))?.sync_all() } else { Ok(()) }
}

impl Drop for Pending {
    fn drop(&mut self) {
        self.temporary.iter().for_each(|file| forget(file));
    }
}

/// Takes a temporary file off the list; it has its name, or is removed by its own drop.
fn forget(file: &Path) {
    temporary().retain(|path| path != file);
}

fn pour(target: &Path, contents: &[u8]) -> io::Result<()> {
    OpenOptions::new().write(true).open(target)?.write_all(contents)
}

fn folder(target: &Path) -> &Path {
    match target.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Makes a temporary file in the target's folder with the target's extension.
fn beside(target: &Path) -> io::Result<TempPath> {
    let extension = target.extension().and_then(OsStr::to_str);
    let suffix = extension.map_or(".part".into(), |extension| format!(".part.{extension}"));
    let mut builder = Builder::new();
    builder.prefix(".").suffix(&suffix);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Rights of any new file, before the user's mask.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    // The error's own path is a temporary name, which the user does not know.
    let made = builder.tempfile_in(folder(target));
    Ok(made.map_err(|error| io::Error::from(error.kind()))?.into_temp_path())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<_> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn saved_file_replaces_the_former_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        save(&path, "one").unwrap();
        // A reader of the former file still sees it whole, because nothing wrote into it.
        let mut former = File::open(&path).unwrap();
        save(&path, "two and more").unwrap();
        assert_eq!(io::read_to_string(&mut former).unwrap(), "one");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "two and more");
        assert_eq!(names(folder.path()), ["a.toml"]);
    }

    #[test]
    fn failed_save_keeps_the_former_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        save(&path, "one").unwrap();
        let mut kept = path.metadata().unwrap().permissions();
        kept.set_readonly(true);
        std::fs::set_permissions(&path, kept).unwrap();
        let error = save(&path, "two").unwrap_err().to_string();
        assert!(error.ends_with("permission denied; check who may read or write it"), "{error}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "one");
        let nowhere = folder.path().join("no/a.toml");
        let error = save(&nowhere, "two").unwrap_err().to_string();
        assert_eq!(error, format!("{}: entity not found; check the path", nowhere.display()));
        assert!(save(folder.path(), "two").unwrap_err().to_string().contains("give a file"));
        assert_eq!(names(folder.path()), ["a.toml"]);
    }

    #[test]
    fn dropped_pending_file_leaves_the_former_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        save(&path, "one").unwrap();
        let pending = Pending::new(&path).unwrap();
        assert!(pending.path().to_str().unwrap().ends_with(".part.csv"));
        std::fs::write(pending.path(), "tw").unwrap();
        let full = FileError::io(pending.path(), &io::ErrorKind::StorageFull.into());
        assert!(pending.named(full).to_string().starts_with(path.to_str().unwrap()));
        drop(pending);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "one");
        assert_eq!(names(folder.path()), ["a.csv"]);
    }

    #[cfg(unix)]
    #[test]
    fn save_keeps_links_and_rights() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a.toml"), folder.path().join("latest.toml"));
        save(&path, "one").unwrap();
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o600, 0o600);
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o640)).unwrap();
        std::os::unix::fs::symlink("a.toml", &link).unwrap();
        save(&link, "two").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "two");
        assert!(link.symlink_metadata().unwrap().is_symlink());
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o640);
    }

    #[cfg(unix)]
    #[test]
    fn device_is_written_and_not_replaced() {
        save("/dev/null", "one").unwrap();
        assert!(!Path::new("/dev/null").metadata().unwrap().is_file());
    }
}
