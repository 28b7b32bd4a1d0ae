//! The locked token file: read it, and replace it atomically by a file written next to it.
//!
//! A new file is readable by its owner only (0600); a replaced file keeps the permissions of its group
//! ([`Permissions::OwnerAndGroup`]).

use std::fs;
use std::io;
use std::path::Path;

use crate::error::ServerError;
use veiloc_map::atomic_file::{Permissions, TargetLock, replace_file};

/// A token file that no other process changes while this exists.
#[derive(Debug)]
pub struct TokenFile {
    lock: TargetLock,
    text: String,
}

impl TokenFile {
    /// Locks the file and reads it; a missing file counts as empty. A link is followed, and its target is edited.
    ///
    /// # Errors
    /// [`ServerError::Io`]: the folder cannot be written, or the file cannot be read as text.
    pub fn open(path: &Path) -> Result<Self, ServerError> {
        let wrong = |source| ServerError::Io { path: path.to_owned(), source };
        let path = match fs::canonicalize(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => path.to_owned(),
            found => found.map_err(wrong)?,
        };
        let lock = TargetLock::acquire(&path).map_err(wrong)?;
        let text = match fs::read_to_string(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            read => read.map_err(wrong)?,
        };
        Ok(Self { lock, text })
    }

    /// The content.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Replaces the content atomically: afterwards the file is completely old or completely new.
    ///
    /// # Errors
    /// [`ServerError::Io`]: the new file could not be written or given to the owner of the old one; then the old one
    /// stays.
    pub fn replace(&mut self, text: &str) -> Result<(), ServerError> {
        let wrong = |source| ServerError::Io { path: self.lock.target().to_owned(), source };
        replace_file(&self.lock, Permissions::OwnerAndGroup, |out| out.write_all(text.as_bytes()))
            .map_err(wrong)?;
        text.clone_into(&mut self.text);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn permissions_are_private_and_group_is_kept() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("tokens");
        let mode = || fs::metadata(&path).expect("a file").permissions().mode() & 0o777;
        TokenFile::open(&path).expect("none yet").replace("nobody\n").expect("written");
        assert_eq!(mode(), 0o600);
        for (before, after) in [(0o640, 0o640), (0o644, 0o640), (0o666, 0o660), (0o400, 0o600)] {
            fs::set_permissions(&path, fs::Permissions::from_mode(before)).expect("set");
            let mut file = TokenFile::open(&path).expect("a file");
            let text = file.text().to_owned() + "# more\n";
            file.replace(&text).expect("written");
            assert_eq!(mode(), after, "{before:o}");
        }
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&path, &link).expect("a link");
        TokenFile::open(&link).expect("a file").replace("# by the link\n").expect("written");
        assert_eq!(fs::read_to_string(&path).expect("a file"), "# by the link\n");
        assert!(fs::symlink_metadata(&link).expect("a link").is_symlink());
        let left: Vec<_> = fs::read_dir(folder.path()).expect("folder").collect();
        assert_eq!(left.len(), 2, "no temporary file is left: {left:?}");
    }

    /// Concurrent writers lose no change.
    #[test]
    fn concurrent_writers_are_serialized() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("tokens");
        std::thread::scope(|scope| {
            for writer in 0..8 {
                let path = &path;
                scope.spawn(move || {
                    for i in 0..20 {
                        let mut file = TokenFile::open(path).expect("a file");
                        let text = format!("{}# {writer} {i}\n", file.text());
                        file.replace(&text).expect("written");
                    }
                });
            }
        });
        assert_eq!(fs::read_to_string(&path).expect("a file").lines().count(), 160);
    }
}
