//! Profiles kept on disk: one file a map of a service. The hash of its bytes is its version, as the service names it.

use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use crate::replace::replace;
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
    let folder = file.parent().unwrap_or(Path::new("."));
    if let Err(reason) = std::fs::create_dir_all(folder).and_then(|()| replace(file, bytes)) {
        options.tell(&Notice::NotKept { file: file.to_owned(), reason: reason.to_string() });
    }
}

/// SHA-256 in hexadecimal.
pub(crate) fn hash(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}
