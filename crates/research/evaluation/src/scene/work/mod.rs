//! What an evaluation keeps in a folder, so that an interruption loses no finished query and nothing is computed twice:
//! the map, the features of its images and the matches of their pairs (`veiloc_mapping::build_cache`), the results of queries.
//!
//! Everything is found by a hash of what it was computed from: the bytes of the images, cameras and poses, the options, what
//! the extractor makes of an image, the version of this program. So a folder may serve several evaluations, and what no
//! longer fits is never taken for what does. The features of queries are not kept: the time they take is one of the figures.

mod key;
mod map;
mod queries;

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_map::atomic_file::TargetLock;
use veiloc_mapping::BuildOptions;
use veiloc_mapping::build_cache::Keeping;

use crate::error::EvalError;

/// Results of queries, one line each.
const QUERIES: &str = "queries.jsonl";

/// The folder.
pub(super) struct Work {
    folder: PathBuf,
    /// Held: two runs would write into each other's lines.
    _lock: TargetLock,
}

impl Work {
    /// Made if it is not there.
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

    /// Features and matches of map images, found earlier or now.
    pub(super) fn keeping(&self, build: &BuildOptions) -> Result<Keeping, EvalError> {
        Ok(Keeping::in_folder(&self.folder, build)?)
    }
}

fn io(path: &Path) -> impl Fn(std::io::Error) -> EvalError {
    move |source| EvalError::Io { path: path.to_owned(), source }
}
