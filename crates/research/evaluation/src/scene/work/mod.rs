//! The work folder of an evaluation. An interruption loses no finished query, and nothing is computed twice: the
//! folder stores the map, the features of its images and the matches of their pairs (`veiloc_mapping::build_cache`),
//! and the results of queries.
//!
//! Every entry is found by a hash of its inputs: the bytes of the images, cameras and poses, the options, the
//! behaviour of the extractor on an image, the version of this program. So several evaluations can share a folder,
//! and outdated entries are never used. The features of queries are not stored: their extraction time is one of the
//! figures.

mod key;
mod map;
mod queries;

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_map::atomic_file::TargetLock;
use veiloc_mapping::BuildOptions;
use veiloc_mapping::build_cache::FolderCache;

use crate::error::EvalError;

/// Results of queries, one line each.
const QUERIES: &str = "queries.jsonl";

/// The work folder.
pub(super) struct Work {
    folder: PathBuf,
    /// A lock: two runs would mix their lines.
    _lock: TargetLock,
}

impl Work {
    /// Creates the folder if it does not exist.
    pub(super) fn in_folder(folder: &Path) -> Result<Self, EvalError> {
        fs::create_dir_all(folder).map_err(io(folder))?;
        let path = folder.join(QUERIES);
        let lock = TargetLock::try_acquire(&path).map_err(io(&path))?.ok_or_else(|| {
            EvalError::Options(format!(
                "{}: another run works in this folder; wait for it, or name another folder",
                folder.display()
            ))
        })?;
        Ok(Self { folder: folder.to_owned(), _lock: lock })
    }

    /// Cache of features and matches of map images.
    pub(super) fn cache(&self, build: &BuildOptions) -> Result<FolderCache, EvalError> {
        Ok(FolderCache::in_folder(&self.folder, build)?)
    }
}

fn io(path: &Path) -> impl Fn(std::io::Error) -> EvalError {
    move |source| EvalError::Io { path: path.to_owned(), source }
}
