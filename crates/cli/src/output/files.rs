//! Reads and writes whole files, with errors that name the file and the remedy; a file is never half-written.

use std::fs;
use std::io::Write as _;
use std::path::Path;

use veiloc_map::atomic_file::write_atomic;

use crate::output::exit::Failure;
use crate::output::ui::Ui;

/// Path that means stdin or stdout.
const STANDARD: &str = "-";

/// Returns whether a path means stdin or stdout.
pub(crate) fn is_standard(path: &Path) -> bool {
    path.as_os_str() == STANDARD
}

/// Reads a whole file.
///
/// # Errors
/// The file cannot be read; the error names it.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    fs::read(path).map_err(|e| {
        Failure::with_help(
            format!("{}: {e}", path.display()),
            "check the path, and that the file is readable",
        )
    })
}

/// Reads all of stdin.
///
/// # Errors
/// The error of the operating system.
pub(crate) fn stdin() -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    std::io::Read::read_to_end(&mut std::io::stdin().lock(), &mut bytes)?;
    Ok(bytes)
}

/// Like [`write()`], but to stdout if the path is `-`.
///
/// # Errors
/// As [`write()`].
pub(crate) fn write_or_print(path: &Path, bytes: &[u8], ui: &Ui) -> Result<(), Failure> {
    if is_standard(path) {
        ui.print_bytes(bytes);
        return Ok(());
    }
    write(path, bytes)
}

/// Writes a temporary file and renames it over the old one; an interruption leaves the old file unchanged.
///
/// A device or pipe is written directly.
///
/// # Errors
/// The file cannot be written; the error names it.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let fault = |e: std::io::Error| Failure::output(path.display(), &e);
    refuse_standard(path)?;
    if fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        return match fs::OpenOptions::new().write(true).open(path).and_then(|mut f| f.write_all(bytes)) {
            // The reader closed the pipe: it needs no more.
            Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(fault(e)),
            _ => Ok(()),
        };
    }
    write_atomic(path, bytes).map_err(fault)
}

/// Refuses stdout as a destination.
///
/// # Errors
/// The path is `-`.
pub(crate) fn refuse_standard(path: &Path) -> Result<(), Failure> {
    if is_standard(path) {
        return Err(Failure::with_help(
            "-: stdout is used for other results of this command",
            "give a file name; ./- is a file named -",
        ));
    }
    Ok(())
}

/// Creates a folder with its parents.
///
/// # Errors
/// The folder cannot be created; the error names it.
pub(crate) fn make_folder(path: &Path) -> Result<(), Failure> {
    fs::create_dir_all(path)
        .map_err(|e| Failure::with_help(format!("{}: {e}", path.display()), "choose a writable folder"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_write_keeps_old_file() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("a");
        write(&path, b"old").expect("written");
        assert!(write(&folder.path().join("no/such/folder/a"), b"new").is_err());
        assert_eq!(fs::read(&path).expect("there"), b"old");
        write(&path, b"new").expect("written");
        assert_eq!(fs::read(&path).expect("there"), b"new");
        assert_eq!(fs::read_dir(folder.path()).expect("there").count(), 1, "no temporary file remains");
    }
}
