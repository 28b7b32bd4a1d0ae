//! One writer of a file at a time.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// An exclusive lock on the file `.NAME.lock` beside a file that is to be replaced.
///
/// The holder removes the lock file before it lets go. Whoever gets the lock therefore looks whether it has locked the
/// file that bears the name, and tries again when that is another one or none.
#[derive(Debug)]
pub struct TargetLock {
    target: PathBuf,
    lock_path: PathBuf,
    /// Held, not read: closing it ends the lock.
    _file: File,
}

impl TargetLock {
    /// Waits until it is free.
    ///
    /// # Errors
    /// The system's: no such folder, or none that may be written to.
    pub fn acquire(target: &Path) -> io::Result<Self> {
        let lock_path = lock_path(target)?;
        loop {
            let file = open(&lock_path)?;
            file.lock()?;
            if is_at(&file, &lock_path)? {
                return Ok(Self { target: target.to_owned(), lock_path, _file: file });
            }
        }
    }

    /// `None` while another holds it.
    ///
    /// # Errors
    /// As [`Self::acquire`].
    pub fn try_acquire(target: &Path) -> io::Result<Option<Self>> {
        let lock_path = lock_path(target)?;
        loop {
            let file = open(&lock_path)?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(error)) => return Err(error),
            }
            if is_at(&file, &lock_path)? {
                return Ok(Some(Self { target: target.to_owned(), lock_path, _file: file }));
            }
        }
    }

    /// The file that its holder may replace.
    pub fn target(&self) -> &Path {
        &self.target
    }
}

impl Drop for TargetLock {
    fn drop(&mut self) {
        // Only where `is_at` can tell a removed file from another one of its name. A file that stays does no harm.
        if cfg!(unix) {
            let _ = fs::remove_file(&self.lock_path);
        }
    }
}

fn lock_path(target: &Path) -> io::Result<PathBuf> {
    let name =
        target.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "no file name"))?;
    let mut lock = OsString::from(".");
    lock.push(name);
    lock.push(".lock");
    Ok(target.with_file_name(lock))
}

fn open(path: &Path) -> io::Result<File> {
    OpenOptions::new().create(true).truncate(false).write(true).open(path)
}

/// Whether this open file is the one that bears the name.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::MetadataExt as _;
    let own = file.metadata()?;
    match fs::metadata(path) {
        Ok(there) => Ok((own.dev(), own.ino()) == (there.dev(), there.ino())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

/// Elsewhere nobody removes the lock file.
#[cfg(not(unix))]
fn is_at(_file: &File, _path: &Path) -> io::Result<bool> {
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_does_not_wait_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("place.vmap");
        let held = TargetLock::acquire(&path).unwrap();
        assert!(TargetLock::try_acquire(&path).unwrap().is_none());
        assert!(TargetLock::try_acquire(&dir.path().join("other.vmap")).unwrap().is_some(), "another map");
        drop(held);
        assert!(TargetLock::try_acquire(&path).unwrap().is_some());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0, "nothing is left lying about");
        assert!(TargetLock::acquire(&dir.path().join("none/place.vmap")).is_err());
        assert!(TargetLock::acquire(Path::new("/")).is_err());
    }

    #[test]
    fn a_lock_file_of_the_dead_holds_nobody_up() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("place.vmap");
        fs::write(dir.path().join(".place.vmap.lock"), "").unwrap();
        drop(TargetLock::try_acquire(&path).unwrap().expect("nobody holds it"));
    }
}
