//! Internal: shared test helpers.
//!
//! A scene of random points ([`RandomScene`]), a map of rooms ([`rooms`]), a map with a
//! copy of a part of it ([`with_copy`]), hand-made EXIF
//! ([`exif`]), and fixtures on disk ([`fixture`]).
//!
//! Fixtures are expensive data: created once, stored on disk beside the builds, and shared by all processes.
//!
//! A fixture is a folder. It is created under a lock, in a temporary folder beside its final path, and renamed when
//! it is complete: of several processes that need it, one creates it and the others wait. Its key is a hash of its
//! inputs: the test program itself (a change of the code recreates it), and the given files.
#![forbid(unsafe_code)]

pub mod exif;
mod random_scene;
mod rooms;
mod twin;

use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

pub use random_scene::{RandomScene, pose_in_scene};
pub use rooms::rooms;
pub use twin::with_copy;

/// How long fixtures with an earlier key are kept: another test program may still use them.
const OLD_FIXTURE_LIFETIME: Duration = Duration::from_secs(24 * 3600);

/// The folder of a fixture; `make` fills it if it does not exist yet. It is shared: tests copy what they change.
///
/// `made_of` lists files and folders beside the test program itself: if the length or date of one of them changes,
/// the fixture is recreated.
///
/// # Panics
/// On disk errors, and when `make` panics; then nothing is stored.
pub fn fixture(name: &str, made_of: &[&Path], make: impl FnOnce(&Path)) -> PathBuf {
    let program = std::env::current_exe().expect("a test program has a path");
    let builds = program.ancestors().nth(3).expect("target/profile/deps/program");
    in_folder(&builds.join("test-fixtures"), name, &[&[program.as_path()], made_of].concat(), make)
        .unwrap_or_else(|error| panic!("fixture {name}: {error}"))
}

fn in_folder(folder: &Path, name: &str, made_of: &[&Path], make: impl FnOnce(&Path)) -> io::Result<PathBuf> {
    fs::create_dir_all(folder)?;
    let mut key = DefaultHasher::new();
    for path in made_of {
        add(path, &mut key)?;
    }
    let whole = folder.join(format!("{name}-{:016x}", key.finish()));
    let lock = File::create(folder.join(format!("{name}.lock")))?;
    lock.lock()?;
    if !whole.exists() {
        remove_old(folder, name);
        let begun = folder.join(format!("{name}.begun"));
        // Left over from a killed process.
        if begun.exists() {
            fs::remove_dir_all(&begun)?;
        }
        fs::create_dir(&begun)?;
        make(&begun);
        fs::rename(&begun, &whole)?;
    }
    Ok(whole)
}

/// Path, length and date of a file, or of all files of a folder.
fn add(path: &Path, key: &mut DefaultHasher) -> io::Result<()> {
    path.hash(key);
    let about = fs::metadata(path)?;
    if about.is_dir() {
        let mut entries = fs::read_dir(path)?.map(|e| e.map(|e| e.path())).collect::<io::Result<Vec<_>>>()?;
        entries.sort();
        return entries.iter().try_for_each(|entry| add(entry, key));
    }
    about.len().hash(key);
    about.modified()?.hash(key);
    Ok(())
}

fn remove_old(folder: &Path, name: &str) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let is_ours =
            path.file_name().and_then(|n| n.to_str()).is_some_and(|n| n.starts_with(&format!("{name}-")));
        let written = entry.metadata().and_then(|m| m.modified()).unwrap_or_else(|_| SystemTime::now());
        if is_ours && written.elapsed().is_ok_and(|age| age > OLD_FIXTURE_LIFETIME) {
            // An old fixture that cannot be removed does no harm.
            let _ = fs::remove_dir_all(path);
        }
    }
}

/// Copies a folder with all its content.
///
/// # Errors
/// Disk errors.
pub fn copy_folder(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy_folder(&entry.path(), &target)?;
        } else {
            fs::copy(entry.path(), target)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fixture_is_created_once_and_again_when_inputs_change() {
        let folder = tempfile::tempdir().expect("a folder");
        let source = folder.path().join("source");
        fs::write(&source, "a").expect("written");
        let made = std::sync::atomic::AtomicUsize::new(0);
        let make = |to: &Path| {
            made.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
            fs::copy(&source, to.join("copy")).expect("copied");
        };
        let get = || in_folder(&folder.path().join("fixtures"), "one", &[&source], make).expect("a fixture");
        std::thread::scope(|scope| (0..4).for_each(|_| drop(scope.spawn(get))));
        assert_eq!(made.load(std::sync::atomic::Ordering::SeqCst), 1);
        let first = get();
        fs::write(&source, "longer").expect("written");
        let second = get();
        assert_ne!(first, second);
        assert_eq!(fs::read_to_string(second.join("copy")).expect("read"), "longer");
        let copy = folder.path().join("its-copy");
        copy_folder(&first, &copy).expect("copied");
        assert_eq!(fs::read_to_string(copy.join("copy")).expect("read"), "a");
    }

    #[test]
    fn failed_fixture_leaves_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let failing = || in_folder(folder.path(), "bad", &[], |_| panic!("cannot be made"));
        assert!(std::panic::catch_unwind(failing).is_err());
        let path = in_folder(folder.path(), "bad", &[], |to| fs::write(to.join("x"), "").expect("written"));
        assert!(path.expect("made").join("x").exists());
    }
}
