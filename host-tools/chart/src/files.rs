//! Files that are there whole or not at all.

use std::path::Path;

use anyhow::Context;

/// Writes `text` beside `path` first, so that nothing is left half written.
pub(crate) fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    let beside = path.with_extension("part");
    std::fs::write(&beside, text)
        .and_then(|()| std::fs::rename(&beside, path))
        .with_context(|| format!("{}: cannot be written", path.display()))
}
