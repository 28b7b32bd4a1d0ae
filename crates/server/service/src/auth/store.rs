//! The file of tokens under its lock: read, and replaced whole by a file that was written beside it.
//!
//! A new file can be read by its owner alone (0600); one that is replaced keeps its readers ([`Readers::OwnerAndGroup`]).

use std::fs;
use std::io;
use std::path::Path;

use crate::error::ServerError;
use veiloc_map::atomic_file::{Readers, TargetLock, replace_file};

/// A file of tokens that nobody else changes meanwhile.
#[derive(Debug)]
pub struct TokenFile {
    lock: TargetLock,
    text: String,
}

impl TokenFile {
    /// Locks the file and reads it; one that is not there counts as empty. A link is followed: the file behind it is meant.
    ///
    /// # Errors
    /// [`ServerError::Io`]: the folder cannot be written, or the file not be read as text.
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

    /// What it holds.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Puts another text in its place. Whatever happens, the old or the new one is there, whole.
    ///
    /// # Errors
    /// [`ServerError::Io`]: it could not be written, or not be given to the owner of the old one; then the old one stays.
    pub fn replace(&mut self, text: &str) -> Result<(), ServerError> {
        let wrong = |source| ServerError::Io { path: self.lock.target().to_owned(), source };
        replace_file(&self.lock, Readers::OwnerAndGroup, |out| out.write_all(text.as_bytes()))
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
    fn a_new_file_is_its_owners_and_an_old_one_keeps_its_readers() {
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
        assert_eq!(left.len(), 2, "nothing lies about: {left:?}");
    }

    /// Writers at the same time lose nothing of each other's.
    #[test]
    fn one_writer_at_a_time() {
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
