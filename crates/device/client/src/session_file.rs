//! A session stored in a file on the device, which only its owner can read.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use veiloc_obfuscation::{Extracted, Sealer, Session, SessionOptions, device_rng};
use veiloc_protocol::SealedQuery;

use crate::ClientError;
use crate::atomic_file::write_atomic;

/// Maximum size of a session file, bytes: the maximum number of landmarks with the longest descriptors.
const MAX_BYTES: u64 = 8 << 20;

/// A session and its file.
///
/// The file is replaced **before** a query is returned, written beside the old one and synced: a query that was sent is
/// always recorded, even if the program is stopped. Only its owner may read it (mode 0600 where the file system has
/// modes). It contains directions of keypoints and belongs in no backup and no report. A lock on the file `.NAME.lock`
/// beside it prevents a second program from opening it.
///
/// Delete the file to end the session; a change of scene does not require it.
#[derive(Debug)]
pub struct SessionFile {
    path: PathBuf,
    session: Session,
    /// Held, not read: closing the file releases the lock.
    _lock: File,
}

impl SessionFile {
    /// Opens a session, or begins one if the file does not exist. `options`: those of a new session; an existing
    /// session must have the same options. `None` accepts any, and begins a new session with
    /// [`SessionOptions::default`].
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn open(path: &Path, options: Option<SessionOptions>) -> Result<Self, ClientError> {
        let path = path.to_owned();
        let io = |source| ClientError::SessionIo { path: path.clone(), source };
        let lock = lock(&path).map_err(io)?;
        let Some(lock) = lock else { return Err(ClientError::SessionBusy { path }) };
        let session = match read(&path) {
            Ok(bytes) => {
                let session = Session::from_bytes(&bytes)
                    .map_err(|source| ClientError::SessionBytes { path: path.clone(), source })?;
                if options.is_some_and(|options| options != *session.options()) {
                    return Err(ClientError::SessionOptions { path });
                }
                session
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                let mut rng = device_rng().map_err(|e| io(io::Error::other(e.to_string())))?;
                Session::new(options.unwrap_or_default(), &mut rng)
            }
            Err(error) => return Err(io(error)),
        };
        Ok(Self { path, session, _lock: lock })
    }

    /// The session.
    pub const fn session(&self) -> &Session {
        &self.session
    }

    /// Seals the next image and stores the session: as [`SessionSealer::seal`](crate::SessionSealer::seal), with random
    /// numbers of the operating system.
    ///
    /// # Errors
    /// [`ClientError::Seal`], [`ClientError::SessionIo`]; then the session and its file do not change.
    pub fn seal(&mut self, sealer: &Sealer, extracted: Extracted) -> Result<SealedQuery, ClientError> {
        let mut next = self.session.clone();
        let query = sealer.in_session(&mut next).seal(extracted, &mut device_rng()?)?;
        write_atomic(&self.path, &next.to_bytes())
            .map_err(|source| ClientError::SessionIo { path: self.path.clone(), source })?;
        self.session = next;
        Ok(query)
    }
}

fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "longer than any session"));
    }
    Ok(bytes)
}

/// The lock file is never removed: otherwise two programs could lock two different files of the same name.
fn lock(path: &Path) -> io::Result<Option<File>> {
    let name = path.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "no file name"))?;
    let mut lock = std::ffi::OsString::from(".");
    lock.push(name);
    lock.push(".lock");
    let file = OpenOptions::new().create(true).truncate(false).write(true).open(path.with_file_name(lock))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(std::fs::TryLockError::WouldBlock) => Ok(None),
        Err(std::fs::TryLockError::Error(error)) => Err(error),
    }
}
