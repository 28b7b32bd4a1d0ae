//! Profiles and packs cached on disk: one file each per map of a service. The hash of its bytes is its version, as in the
//! service's ETag.

use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use crate::atomic_file::write_atomic;
use crate::{ClientOptions, Notice};

/// The cache folder; `None` disables the cache.
pub(crate) struct Cache {
    folder: Option<PathBuf>,
}

impl Cache {
    pub(crate) fn new(folder: Option<&Path>) -> Self {
        Self { folder: folder.map(Path::to_owned) }
    }

    /// The file of a map's `what`. Names of services and maps may contain any character, so the file name is a hash.
    pub(crate) fn file(&self, what: &str, server: &str, map: &str) -> Option<PathBuf> {
        let digits = hash(format!("{server}\n{map}").as_bytes());
        self.folder.as_ref().map(|folder| folder.join(format!("{what}s/{}.v{what}", &digits[..32])))
    }
}

/// Stores a profile or pack. A failure is only reported: it is fetched again next time.
pub(crate) fn store(file: &Path, bytes: &[u8], options: &ClientOptions) {
    let folder = file.parent().unwrap_or(Path::new("."));
    if let Err(reason) = std::fs::create_dir_all(folder).and_then(|()| write_atomic(file, bytes)) {
        options.notify(&Notice::CacheWriteFailed { file: file.to_owned(), reason: reason.to_string() });
    }
}

/// SHA-256 in hexadecimal.
pub(crate) fn hash(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}
