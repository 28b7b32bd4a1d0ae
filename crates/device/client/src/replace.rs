//! A file replaced as a whole.

use std::io::{self, Write as _};
use std::path::Path;

/// Writes beside the old file, synced, then takes its place: two programs at once, or an interruption, leave a whole one.
/// Temporary files are readable by their owner alone, and stay so.
pub(crate) fn replace(file: &Path, bytes: &[u8]) -> io::Result<()> {
    let folder = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut new = tempfile::NamedTempFile::new_in(folder)?;
    new.write_all(bytes)?;
    new.as_file().sync_all()?;
    new.persist(file)?;
    Ok(())
}
