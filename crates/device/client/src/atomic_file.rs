//! Atomic replacement of a file.

use std::io::{self, Write as _};
use std::path::Path;

/// Writes a temporary file beside the old one, syncs it, and renames it: concurrent programs or an interruption leave a
/// complete file. Only the owner can read the new file. A symbolic link stays, and its target is replaced.
pub(crate) fn write_atomic(file: &Path, bytes: &[u8]) -> io::Result<()> {
    let target = file.canonicalize();
    let file = target.as_deref().unwrap_or(file);
    let folder = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut new = tempfile::NamedTempFile::new_in(folder)?;
    new.write_all(bytes)?;
    new.as_file().sync_all()?;
    new.persist(file)?;
    Ok(())
}
