//! A file as one slice, mapped or copied into memory that no other program can change.

use std::{
    fs::File,
    io::{self, Read as _},
    ops::Deref,
    path::Path,
};

use memmap2::{Mmap, MmapMut};

/// Opens a regular file for reading. Opening a FIFO would wait for a writer for ever, and a device may have no end.
///
/// # Errors
/// Errors of the operating system; [`io::ErrorKind::IsADirectory`]; [`io::ErrorKind::InvalidInput`]: neither a file nor
/// a folder.
pub fn open_regular_file(path: &Path) -> io::Result<File> {
    // Before it is opened: opening is what waits.
    let metadata = std::fs::metadata(path)?;
    if metadata.is_dir() {
        return Err(io::Error::from(io::ErrorKind::IsADirectory));
    }
    if !metadata.is_file() {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "not a regular file, but a pipe, a socket or a device",
        ));
    }
    File::open(path)
}

/// The bytes of a file, mapped read-only into memory; the operating system loads pages when they are first read.
///
/// # The hazard
/// The slice is the file. If another program writes into the file or truncates it while it is mapped, the bytes change
/// although Rust assumes that they are constant, or the read ends the process with a bus error. No check during opening
/// can rule this out.
///
/// This project avoids it by never writing into a file in place: a new version is written beside the old one, flushed,
/// and renamed over it. Existing mappings keep the old version, unchanged. All other writers of files used with this
/// type must do the same; do not map files that others can write.
#[derive(Debug)]
pub struct MappedFile {
    // An empty file cannot be mapped on some systems.
    map: Option<Mmap>,
}

impl MappedFile {
    /// Maps the file at `path`; an empty file gives an empty slice.
    ///
    /// # Errors
    /// As [`open_regular_file`], and errors of the operating system when the file cannot be mapped; `path` is not part
    /// of the message.
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = open_regular_file(path)?;
        if file.metadata()?.len() == 0 {
            return Ok(Self { map: None });
        }
        // SAFETY: the mapping is read-only and private to this value, which owns it until it is dropped. No other
        // writer of the file is this project's rule for mapped files (see the type's documentation).
        let map = unsafe { Mmap::map(&file)? };
        Ok(Self { map: Some(map) })
    }

    /// The same bytes in memory of this process; later changes of the file have no effect.
    ///
    /// It needs memory for the whole file and the time to read it. If the file is written meanwhile, the bytes are a
    /// mixture, which readers must detect by a checksum.
    ///
    /// # Errors
    /// As [`Self::open`]; [`io::ErrorKind::UnexpectedEof`] when the file became shorter while it was read.
    pub fn copied(path: &Path) -> io::Result<Self> {
        let mut file = open_regular_file(path)?;
        let length = usize::try_from(file.metadata()?.len()).map_err(|_| io::ErrorKind::OutOfMemory)?;
        Self::in_memory(length, |bytes| file.read_exact(bytes))
    }

    /// The same without a file: `length` bytes of memory, page-aligned like a file, zero except for what `fill` writes.
    ///
    /// # Errors
    /// Errors of the operating system, when there is no memory, and those of `fill`.
    pub fn in_memory(length: usize, fill: impl FnOnce(&mut [u8]) -> io::Result<()>) -> io::Result<Self> {
        if length == 0 {
            fill(&mut [])?;
            return Ok(Self { map: None });
        }
        let mut map = MmapMut::map_anon(length)?;
        fill(&mut map)?;
        Ok(Self { map: Some(map.make_read_only()?) })
    }
}

impl Deref for MappedFile {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.map.as_deref().unwrap_or(&[])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_was_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("some.bin");
        let bytes: Vec<u8> = (0..10_000_u32).map(|i| i as u8).collect();
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(&*MappedFile::open(&path).unwrap(), bytes);
    }

    /// Nothing writes into this pipe, so opening it would wait for ever.
    #[cfg(unix)]
    #[test]
    fn pipes_and_folders_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("some.vmap");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for open in [MappedFile::open, MappedFile::copied] {
            assert_eq!(open(&pipe).unwrap_err().kind(), io::ErrorKind::InvalidInput);
            assert_eq!(open(dir.path()).unwrap_err().kind(), io::ErrorKind::IsADirectory);
            assert_eq!(open(Path::new("/dev/null")).unwrap_err().kind(), io::ErrorKind::InvalidInput);
        }
    }

    #[test]
    fn memory_holds_what_was_filled_in() {
        let bytes: Vec<u8> = (0..10_000_u32).map(|i| i as u8).collect();
        let fill = |to: &mut [u8]| {
            to.copy_from_slice(&bytes);
            Ok(())
        };
        let map = MappedFile::in_memory(bytes.len(), fill).unwrap();
        assert_eq!(&*map, bytes);
        assert!(map.as_ptr().addr().is_multiple_of(64), "as a file's bytes are");
        let nothing = |to: &mut [u8]| if to.is_empty() { Ok(()) } else { Err(io::Error::other("not empty")) };
        assert!(MappedFile::in_memory(0, nothing).unwrap().is_empty());
        assert!(MappedFile::in_memory(5, |_| Err(io::Error::other("no"))).is_err());
    }

    #[test]
    fn copy_is_independent_of_its_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("some.bin");
        let bytes: Vec<u8> = (0..10_000_u32).map(|i| i as u8).collect();
        std::fs::write(&path, &bytes).unwrap();
        let copy = MappedFile::copied(&path).unwrap();
        std::fs::write(&path, [7; 10_000]).unwrap();
        assert_eq!(&*copy, bytes);
        File::options().write(true).open(&path).unwrap().set_len(10).unwrap();
        assert_eq!(&*copy, bytes);
        assert_eq!(&*MappedFile::copied(&path).unwrap(), [7; 10]);
        assert!(copy.as_ptr().addr().is_multiple_of(64));
        std::fs::write(&path, []).unwrap();
        assert!(MappedFile::copied(&path).unwrap().is_empty());
        assert!(MappedFile::copied(dir.path()).is_err());
    }

    #[test]
    fn an_empty_file_is_an_empty_slice() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("empty.bin");
        std::fs::write(&path, []).unwrap();
        assert!(MappedFile::open(&path).unwrap().is_empty());
    }

    #[test]
    fn a_missing_file_and_a_directory_are_errors() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(MappedFile::open(&dir.path().join("none")).unwrap_err().kind(), io::ErrorKind::NotFound);
        assert!(MappedFile::open(dir.path()).is_err());
    }

    #[test]
    #[cfg(unix)]
    fn replacing_by_rename_leaves_the_old_version_readable() {
        let dir = tempfile::tempdir().unwrap();
        let (path, beside) = (dir.path().join("map"), dir.path().join("map.new"));
        std::fs::write(&path, [1; 8192]).unwrap();
        let old = MappedFile::open(&path).unwrap();
        std::fs::write(&beside, [2; 10]).unwrap();
        std::fs::rename(&beside, &path).unwrap();
        assert!(old.iter().all(|&b| b == 1));
        assert_eq!(&*MappedFile::open(&path).unwrap(), &[2; 10]);
    }
}
