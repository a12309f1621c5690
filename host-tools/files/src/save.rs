//! Files written whole or not at all.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use tempfile::Builder;

use crate::error::FileError;

/// Replaces `path` atomically by a file that is already on the disk.
///
/// The former contents stay if power, disk or program fail.
///
/// # Errors
/// The file cannot be written, or the former one is read-only.
pub fn save(path: impl AsRef<Path>, contents: impl AsRef<[u8]>) -> Result<(), FileError> {
    let (path, contents) = (path.as_ref(), contents.as_ref());
    // A symbolic link stays in place; its target is replaced.
    let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let saved = match target.metadata() {
        // A device or a pipe cannot be replaced.
        Ok(former) if !former.is_file() => pour(&target, contents),
        former => replace(&target, former.ok(), contents),
    };
    saved.map_err(|error| FileError::io(path, &error))
}

fn pour(target: &Path, contents: &[u8]) -> io::Result<()> {
    OpenOptions::new().write(true).open(target)?.write_all(contents)
}

fn replace(target: &Path, former: Option<Metadata>, contents: &[u8]) -> io::Result<()> {
    if former.as_ref().is_some_and(|former| former.permissions().readonly()) {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    let folder = match target.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut builder = Builder::new();
    builder.prefix(".").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Rights of any new file, before the user's mask.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    // The error's own path is a temporary name, which the user does not know.
    let opened = builder.tempfile_in(folder);
    let mut beside = opened.map_err(|error| io::Error::from(error.kind()))?;
    beside.as_file_mut().write_all(contents)?;
    if let Some(former) = former {
        beside.as_file().set_permissions(former.permissions())?;
    }
    beside.as_file().sync_all()?;
    beside.persist(target).map_err(|error| error.error)?;
    // On Unix the folder holds the name and needs its own sync.
    if cfg!(unix) {
        File::open(folder)?.sync_all()?;
    }
    Ok(())
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
