//! A lock that allows one writer of a file at a time.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// An exclusive lock on the file `.NAME.lock` next to the file that is to be replaced.
///
/// If the path is a symbolic link, that file is the target of the link: the link stays.
///
/// The holder removes the lock file before it unlocks. So a new holder must check that it has locked the file that
/// currently has this name, and try again otherwise.
#[derive(Debug)]
pub struct TargetLock {
    target: PathBuf,
    lock_path: PathBuf,
    /// Held open: closing it releases the lock.
    _file: File,
}

impl TargetLock {
    /// Waits for the lock.
    ///
    /// # Errors
    /// The error of the system: the folder is missing or not writable.
    pub fn acquire(target: &Path) -> io::Result<Self> {
        let target = followed(target)?;
        let lock_path = lock_path(&target)?;
        loop {
            let file = open(&lock_path)?;
            file.lock()?;
            if is_at(&file, &lock_path)? {
                return Ok(Self { target, lock_path, _file: file });
            }
        }
    }

    /// Tries to lock; `None` if another process holds the lock.
    ///
    /// # Errors
    /// As [`Self::acquire`].
    pub fn try_acquire(target: &Path) -> io::Result<Option<Self>> {
        let target = followed(target)?;
        let lock_path = lock_path(&target)?;
        loop {
            let file = open(&lock_path)?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(error)) => return Err(error),
            }
            if is_at(&file, &lock_path)? {
                return Ok(Some(Self { target, lock_path, _file: file }));
            }
        }
    }

    /// The file that the holder may replace.
    pub fn target(&self) -> &Path {
        &self.target
    }
}

impl Drop for TargetLock {
    fn drop(&mut self) {
        // Only where `is_at` can distinguish a removed file from a new one. A remaining file does no harm.
        if cfg!(unix) {
            let _ = fs::remove_file(&self.lock_path);
        }
    }
}

/// Returns the file that a path names when its symbolic links are followed; the file need not exist.
///
/// # Errors
/// A link cannot be read, or the links form a loop.
pub fn followed(path: &Path) -> io::Result<PathBuf> {
    /// As many as Linux follows.
    const MOST: usize = 40;
    let mut path = path.to_owned();
    for _ in 0..MOST {
        if !fs::symlink_metadata(&path).is_ok_and(|m| m.is_symlink()) {
            return Ok(path);
        }
        // An absolute target replaces the whole path.
        path = path.parent().unwrap_or(Path::new("")).join(fs::read_link(&path)?);
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, "its symbolic links form a loop"))
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

/// Whether this open file is the one that currently has this path.
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

/// On other systems the lock file is never removed.
#[cfg(not(unix))]
fn is_at(_file: &File, _path: &Path) -> io::Result<bool> {
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn try_acquire_does_not_wait() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("place.vmap");
        let held = TargetLock::acquire(&path).unwrap();
        assert!(TargetLock::try_acquire(&path).unwrap().is_none());
        assert!(TargetLock::try_acquire(&dir.path().join("other.vmap")).unwrap().is_some(), "another map");
        drop(held);
        assert!(TargetLock::try_acquire(&path).unwrap().is_some());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0, "no lock file is left");
        assert!(TargetLock::acquire(&dir.path().join("none/place.vmap")).is_err());
        assert!(TargetLock::acquire(Path::new("/")).is_err());
    }

    #[test]
    fn stale_lock_file_does_not_block() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("place.vmap");
        fs::write(dir.path().join(".place.vmap.lock"), "").unwrap();
        drop(TargetLock::try_acquire(&path).unwrap().expect("not held"));
    }
}
