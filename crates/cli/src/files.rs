//! Reads and writes whole files, with errors that name the file and the remedy; nothing is ever half-written.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use crate::exit::Failure;

/// Reads a whole file.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    fs::read(path).map_err(|e| {
        Failure::with_help(
            format!("{}: {e}", path.display()),
            "check the path, and that the file may be read",
        )
    })
}

/// Writes a file beside the old one, then takes its place; an interruption leaves the old one as it was.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let fault = |e: std::io::Error| {
        Failure::with_help(
            format!("{}: {e}", path.display()),
            "check that the folder exists, may be written, and has room",
        )
    };
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p.to_owned(),
        _ => PathBuf::from("."),
    };
    let mut file = as_others_read(&mut tempfile::Builder::new()).tempfile_in(&folder).map_err(fault)?;
    file.write_all(bytes).map_err(fault)?;
    file.as_file().sync_all().map_err(fault)?;
    file.persist(path).map_err(|e| fault(e.error))?;
    Ok(())
}

/// A profile or report is for others too: the usual permissions, less the umask, instead of a temporary file's.
#[cfg(unix)]
fn as_others_read<'a, 'b, 'c>(
    builder: &'a mut tempfile::Builder<'b, 'c>,
) -> &'a mut tempfile::Builder<'b, 'c> {
    use std::os::unix::fs::PermissionsExt as _;
    builder.permissions(fs::Permissions::from_mode(0o666))
}

#[cfg(not(unix))]
fn as_others_read<'a, 'b, 'c>(
    builder: &'a mut tempfile::Builder<'b, 'c>,
) -> &'a mut tempfile::Builder<'b, 'c> {
    builder
}

/// Makes a folder with all above it.
pub(crate) fn make_folder(path: &Path) -> Result<(), Failure> {
    fs::create_dir_all(path).map_err(|e| {
        Failure::with_help(format!("{}: {e}", path.display()), "choose a folder that may be written")
    })
}

/// A list of image names, one a line; empty lines and lines that begin with `#` do not count.
///
/// hloc's query lists carry the camera behind the name; it is cut. Names may hold spaces, as COLMAP's may.
pub(crate) fn read_list(path: &Path) -> Result<Vec<String>, Failure> {
    let text = String::from_utf8(read(path)?).map_err(|_| {
        Failure::with_help(
            format!("{}: is not text", path.display()),
            "give a text file with one image name a line",
        )
    })?;
    let names: Vec<String> = text
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map(|line| without_camera(line).to_owned())
        .collect();
    if names.is_empty() {
        return Err(Failure::with_help(
            format!("{}: names no image", path.display()),
            "write one image name a line, relative to the folder of the images",
        ));
    }
    let mut seen = BTreeSet::new();
    if let Some(twice) = names.iter().find(|name| !seen.insert(*name)) {
        return Err(Failure::with_help(
            format!("{}: {twice} is there twice", path.display()),
            "name every image once",
        ));
    }
    Ok(names)
}

/// `name PINHOLE 640 480 …` without the camera.
fn without_camera(line: &str) -> &str {
    let is_model = |word: &str| CAMERA_MODELS.contains(&word);
    line.split_whitespace()
        .skip(1)
        .find(|word| is_model(word))
        .and_then(|model| line.find(&format!(" {model} ")))
        .map_or(line, |at| line[..at].trim_end())
}

/// Models that hloc's lists name.
const CAMERA_MODELS: [&str; 5] = ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_write_that_fails_leaves_the_old_file() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("a");
        write(&path, b"old").expect("written");
        assert!(write(&folder.path().join("no/such/folder/a"), b"new").is_err());
        assert_eq!(fs::read(&path).expect("there"), b"old");
        write(&path, b"new").expect("written");
        assert_eq!(fs::read(&path).expect("there"), b"new");
        assert_eq!(fs::read_dir(folder.path()).expect("there").count(), 1, "nothing is left lying about");
    }

    #[test]
    fn lists_are_names() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("list");
        write(&path, b"# queries\na.jpg\n\n  b/c d.jpg PINHOLE 640 480 1 1 1 1\r\n").expect("written");
        assert_eq!(read_list(&path).expect("a list"), ["a.jpg", "b/c d.jpg"]);
        write(&path, b"\n# nothing\n").expect("written");
        assert!(read_list(&path).is_err());
        write(&path, b"a.jpg\nb.jpg\na.jpg\n").expect("written");
        assert!(read_list(&path).is_err(), "a name twice");
        write(&path, &[0xff, 0xfe]).expect("written");
        assert!(read_list(&path).is_err());
    }
}
