//! Packages of the host's workspace that changed since `main`.

use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde::Deserialize;

use crate::run::{cargo, lines, program, root};

/// Parts of the workspace that changed.
#[derive(Debug, PartialEq, Eq)]
pub enum Changes {
    /// All packages: no file changed (which runs every test), or a file that no package owns did.
    Everything,
    /// Names of packages.
    Packages(BTreeSet<String>),
}

impl Changes {
    /// Compares the working tree with the commit where the branch left `main`.
    pub fn since_main() -> Result<Self> {
        let git = |arguments: &[&str]| lines(program("git", &root()).args(arguments));
        let base =
            ["main", "origin/main"].iter().find_map(|main| git(&["merge-base", "HEAD", main]));
        let Some([base]) = base.as_deref() else { return Ok(Self::Everything) };
        let changed = git(&["diff", "--name-only", "--no-renames", base]);
        let new = git(&["ls-files", "--others", "--exclude-standard"]);
        let (Some(changed), Some(new)) = (changed, new) else { return Ok(Self::Everything) };
        let packages = packages(cargo().args(["metadata", "--no-deps"]))?.into_iter();
        let root = root();
        let within = |folder: PathBuf| Some(folder.strip_prefix(&root).ok()?.to_owned());
        let packages = packages.filter_map(|(name, folder)| Some((name, within(folder)?)));
        Ok(Self::of(&[changed, new].concat(), &packages.collect::<Vec<_>>()))
    }

    fn of(files: &[String], packages: &[(String, PathBuf)]) -> Self {
        let owners: Option<BTreeSet<String>> =
            files.iter().map(|file| owner(Path::new(file), packages)).collect();
        match owners {
            Some(owners) if !owners.is_empty() => Self::Packages(owners),
            _ => Self::Everything,
        }
    }

    /// Returns the nextest filter for the changed packages and all that depend on them.
    pub fn filter(&self) -> String {
        match self {
            Self::Everything => "all()".to_owned(),
            Self::Packages(names) => {
                names.iter().map(|name| format!("rdeps(={name})")).collect::<Vec<_>>().join(" + ")
            }
        }
    }
}

impl fmt::Display for Changes {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Everything => write!(f, "every package"),
            Self::Packages(names) => {
                let names = names.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
                write!(f, "{names} and what depends on it")
            }
        }
    }
}

/// Returns the package whose folder holds a file.
///
/// In the root folder the core owns only its sources and tests, because a manual, a lock file or a
/// table may matter to any package.
fn owner(file: &Path, packages: &[(String, PathBuf)]) -> Option<String> {
    let core = file.starts_with("src") || file.starts_with("tests/core");
    let holds = |folder: &Path| {
        let root = folder == Path::new("");
        if core { root } else { !root && file.starts_with(folder) }
    };
    let mut owners: Vec<_> = packages.iter().filter(|(_, folder)| holds(folder)).collect();
    owners.sort_by_key(|(_, folder)| folder.components().count());
    owners.pop().map(|(name, _)| name.clone())
}

/// Lists the packages that a `cargo metadata` command names, with their folders.
pub fn packages(metadata: &mut Command) -> Result<Vec<(String, PathBuf)>> {
    #[derive(Deserialize)]
    struct Metadata {
        packages: Vec<Package>,
    }
    #[derive(Deserialize)]
    struct Package {
        name: String,
        manifest_path: PathBuf,
    }
    let output = metadata.args(["--format-version", "1"]).output()?;
    let metadata: Metadata =
        serde_json::from_slice(&output.stdout).context("`cargo metadata` lists no packages")?;
    let packages = metadata.packages.into_iter();
    Ok(packages
        .filter_map(|package| Some((package.name, package.manifest_path.parent()?.to_owned())))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(files: &[&str]) -> Changes {
        let packages =
            [("taxel", ""), ("xtask", "host-tools/xtask"), ("taxel-sim", "host-tools/sim")];
        let packages = packages.map(|(name, folder)| (name.to_owned(), folder.into()));
        Changes::of(&files.iter().map(|file| (*file).to_owned()).collect::<Vec<_>>(), &packages)
    }

    #[test]
    fn file_belongs_to_innermost_package() {
        let changes =
            of(&["src/lib.rs", "host-tools/sim/src/scene.rs", "host-tools/xtask/src/run.rs"]);
        assert_eq!(changes.filter(), "rdeps(=taxel) + rdeps(=taxel-sim) + rdeps(=xtask)");
        assert_eq!(of(&["tests/core/store.rs"]).filter(), "rdeps(=taxel)");
    }

    #[test]
    fn unowned_file_or_no_file_selects_every_test() {
        for files in [
            &["src/lib.rs", "docs/accuracy.md"][..],
            &["tests/system/faults.rs"],
            &["Cargo.lock"],
            &[],
        ] {
            assert_eq!(of(files), Changes::Everything, "{files:?}");
        }
    }
}
