//! Profiles kept on disk: one file a map of a service. The hash of its bytes is its version, as the service names it.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use crate::{ClientOptions, Notice};

/// The folder, if there is one.
pub(crate) struct ProfileCache {
    folder: Option<PathBuf>,
}

impl ProfileCache {
    pub(crate) fn new(folder: Option<&Path>) -> Self {
        Self { folder: folder.map(|folder| folder.join("profiles")) }
    }

    /// Where the profile of a map is kept. Names of services and maps may hold anything, the name of a file may not.
    pub(crate) fn file(&self, server: &str, map: &str) -> Option<PathBuf> {
        let digits = hash(format!("{server}\n{map}").as_bytes());
        self.folder.as_ref().map(|folder| folder.join(format!("{}.vprofile", &digits[..32])))
    }
}

/// A profile that cannot be kept is fetched again next time: no reason to give up.
pub(crate) fn keep(file: &Path, bytes: &[u8], options: &ClientOptions) {
    if let Err(reason) = replace(file, bytes) {
        options.tell(&Notice::NotKept { file: file.to_owned(), reason: reason.to_string() });
    }
}

/// Writes beside the old file, then takes its place: two clients at once, or an interruption, leave a whole one.
fn replace(file: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let folder = file.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)?;
    let mut new = tempfile::NamedTempFile::new_in(folder)?;
    new.write_all(bytes)?;
    new.persist(file)?;
    Ok(())
}

/// SHA-256 in hexadecimal.
pub(crate) fn hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}
