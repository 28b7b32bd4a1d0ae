//! Atomic replacement of a file: after a crash it is completely old or completely new.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use crate::atomic_file::TargetLock;

/// Permissions of a written file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Permissions {
    /// Those of the replaced file; the default for a new file.
    Preserve,
    /// A new file is readable by its owner only. A replaced file keeps its owner, group and group permissions: a
    /// service often reads a secret through its group, and an edit by root must not lock it out.
    OwnerAndGroup,
}

/// Writes a new file next to the locked `path`, flushes it to the disk, renames it over `path`, and flushes the
/// folder.
///
/// When `content` fails, the new file is removed and `path` is unchanged. When the process dies, a file
/// `.NAME.<process>-<count>.partial` remains, which nothing reads; the next call for the same path removes it. Only
/// the holder of the lock writes such files, so all existing ones belong to dead processes.
///
/// # Errors
/// The errors of the system and of `content`; then the old file stays.
pub fn replace_file(
    lock: &TargetLock,
    permissions: Permissions,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let path = lock.target();
    let name = path.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "no file name"))?;
    let dir = match path.parent() {
        Some(dir) if !dir.as_os_str().is_empty() => dir,
        _ => Path::new("."),
    };
    let mut prefix = OsString::from(".");
    prefix.push(name);
    prefix.push(".");
    remove_stale(dir, &prefix)?;

    static COUNT: AtomicU32 = AtomicU32::new(0);
    let mut partial = prefix;
    partial.push(format!("{}-{}{SUFFIX}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed)));
    let partial = dir.join(partial);
    let written = write_and_rename(&partial, path, permissions, content);
    if written.is_err() {
        // The first error is returned; a failure to clean up adds nothing.
        let _ = fs::remove_file(&partial);
    }
    written?;
    sync_dir(dir)
}

/// Replaces a file by these bytes, as [`replace_file`] does, if the old content need not be read first.
///
/// # Errors
/// The error of the system; then the old file stays.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let lock = TargetLock::acquire(path)?;
    replace_file(&lock, Permissions::Preserve, |out| out.write_all(bytes))
}

fn write_and_rename(
    partial: &Path,
    path: &Path,
    permissions: Permissions,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    if permissions == Permissions::OwnerAndGroup {
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    }
    let file = options.open(partial)?;
    if let Ok(old) = fs::metadata(path) {
        match permissions {
            // A file keeps its permissions when its content is replaced.
            Permissions::Preserve => file.set_permissions(old.permissions())?,
            Permissions::OwnerAndGroup => copy_ownership(&file, &old)?,
        }
    }
    let mut out = BufWriter::with_capacity(1 << 20, file);
    content(&mut out)?;
    let file = out.into_inner().map_err(io::IntoInnerError::into_error)?;
    file.sync_all()?;
    fs::rename(partial, path)
}

#[cfg(unix)]
fn copy_ownership(file: &File, old: &fs::Metadata) -> io::Result<()> {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, fchown};
    let own = file.metadata()?;
    if (own.uid(), own.gid()) != (old.uid(), old.gid()) {
        fchown(file, Some(old.uid()), Some(old.gid()))?;
    }
    file.set_permissions(fs::Permissions::from_mode(old.mode() & 0o060 | 0o600))
}

#[cfg(not(unix))]
fn copy_ownership(_: &File, _: &fs::Metadata) -> io::Result<()> {
    Ok(())
}

/// Removes partial files of dead writers of the same file.
fn remove_stale(dir: &Path, prefix: &OsString) -> io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let path: PathBuf = entry?.path();
        let Some(name) = path.file_name() else { continue };
        let (name, prefix) = (name.as_encoded_bytes(), prefix.as_encoded_bytes());
        let middle = name.strip_prefix(prefix).and_then(|rest| rest.strip_suffix(SUFFIX.as_bytes()));
        let ours =
            middle.is_some_and(|m| !m.is_empty() && m.iter().all(|b| b.is_ascii_digit() || *b == b'-'));
        if ours {
            // The file may belong to another user; leaving it is no failure.
            let _ = fs::remove_file(&path);
        }
    }
    Ok(())
}

#[cfg(unix)]
fn sync_dir(dir: &Path) -> io::Result<()> {
    File::open(dir)?.sync_all()
}

/// Other systems cannot open a folder as a file; renaming must suffice.
#[cfg(not(unix))]
fn sync_dir(_dir: &Path) -> io::Result<()> {
    Ok(())
}

const SUFFIX: &str = ".partial";

#[cfg(test)]
mod tests {
    use super::*;

    fn names(dir: &Path) -> Vec<String> {
        let mut all: Vec<_> =
            fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        all.sort();
        all
    }

    fn replace(path: &Path, content: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
        replace_file(&TargetLock::acquire(path)?, Permissions::Preserve, content)
    }

    /// Each thread increments a number in a file many times: a lock that two threads can hold would lose updates.
    #[test]
    fn concurrent_updates_are_serialized() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("count");
        fs::write(&path, "0").unwrap();
        let (threads, rounds) = (8, 40);
        std::thread::scope(|scope| {
            for _ in 0..threads {
                scope.spawn(|| {
                    for _ in 0..rounds {
                        let lock = TargetLock::acquire(&path).unwrap();
                        let count: usize = fs::read_to_string(&path).unwrap().parse().unwrap();
                        replace_file(&lock, Permissions::Preserve, |out| write!(out, "{}", count + 1))
                            .unwrap();
                    }
                });
            }
        });
        assert_eq!(fs::read_to_string(&path).unwrap(), (threads * rounds).to_string());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary file is left");
    }

    #[test]
    fn failed_write_leaves_the_old_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("place.vmap");
        replace(&path, |out| out.write_all(b"old")).unwrap();
        let error = replace(&path, |out| {
            out.write_all(&vec![0; 3 << 20])?;
            Err(io::Error::other("the disk is full"))
        });
        assert_eq!(error.unwrap_err().to_string(), "the disk is full");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(dir.path()), ["place.vmap"]);
    }

    /// Concurrent writers of one file all succeed, although each removes stale files.
    #[test]
    fn concurrent_writers_do_not_remove_each_others_files() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("place.vmap");
        std::thread::scope(|scope| {
            for thread in 0..8_u8 {
                let path = &path;
                scope.spawn(move || {
                    for _ in 0..40 {
                        replace(path, |out| out.write_all(&[thread; 1000])).unwrap();
                    }
                });
            }
        });
        let last = fs::read(&path).unwrap();
        assert!(last.len() == 1000 && last.iter().all(|b| *b == last[0]), "the complete file of one writer");
        assert_eq!(names(dir.path()), ["place.vmap"]);
    }

    #[test]
    fn stale_partial_files_are_removed_and_others_are_not() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("place.vmap");
        for name in [".place.vmap.4711-0.partial", ".place.vmap.mine.partial", ".other.vmap.4711-0.partial"] {
            fs::write(dir.path().join(name), b"half a map").unwrap();
        }
        replace(&path, |out| out.write_all(b"new")).unwrap();
        assert_eq!(
            names(dir.path()),
            [".other.vmap.4711-0.partial", ".place.vmap.mine.partial", "place.vmap"]
        );
        assert_eq!(fs::read(&path).unwrap(), b"new");
    }

    #[test]
    fn panicking_writer_leaves_the_old_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("place.vmap");
        replace(&path, |out| out.write_all(b"old")).unwrap();
        let died = std::panic::catch_unwind(|| {
            replace(&path, |out| {
                out.write_all(&vec![0; 3 << 20])?;
                panic!("killed");
            })
        });
        assert!(died.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(dir.path()).len(), 2, "a killed writer leaves its file behind");
        replace(&path, |out| out.write_all(b"new")).unwrap();
        assert_eq!(names(dir.path()), ["place.vmap"]);
    }

    #[cfg(unix)]
    #[test]
    fn target_of_a_link_is_replaced_and_the_link_stays() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name);
        fs::create_dir(path("maps")).unwrap();
        fs::write(path("maps/1.vmap"), "old").unwrap();
        symlink("maps/1.vmap", path("first")).unwrap();
        symlink(path("first"), path("second")).unwrap();
        symlink("maps/2.vmap", path("dangling")).unwrap();
        symlink("loop", path("loop")).unwrap();
        write_atomic(&path("second"), b"new").unwrap();
        write_atomic(&path("dangling"), b"new").unwrap();
        assert!(write_atomic(&path("loop"), b"new").is_err());
        for name in ["1.vmap", "2.vmap"] {
            assert_eq!(fs::read(path("maps").join(name)).unwrap(), b"new", "{name}");
        }
        assert_eq!(names(&path("maps")), ["1.vmap", "2.vmap"]);
        for link in ["first", "second", "dangling", "loop"] {
            assert!(fs::symlink_metadata(path(link)).unwrap().is_symlink(), "{link}");
        }
    }

    #[test]
    fn invalid_paths_are_errors() {
        let dir = tempfile::tempdir().unwrap();
        assert!(replace(&dir.path().join("none/place.vmap"), |_| Ok(())).is_err());
        assert!(replace(Path::new("/"), |_| Ok(())).is_err());
        assert!(replace(dir.path(), |_| Ok(())).is_err(), "a folder is not replaced by a file");
    }
}
