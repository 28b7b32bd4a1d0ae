//! What an evaluation keeps in a folder, so that an interruption loses no finished query and nothing is computed twice:
//! the map, the features of its images, the matches of their pairs, the results of queries.
//!
//! Everything is found by a hash of what it was computed from: the bytes of the images, cameras and poses, the options, what
//! the extractor makes of an image, the version of this program. So a folder may serve several evaluations, and what no
//! longer fits is never taken for what does. The features of queries are not kept: the time they take is one of the figures.

mod features;
mod key;
mod map;
mod matches;
mod queries;

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_replacing::TargetLock;

use crate::error::EvalError;
use matches::MatchFile;

/// Results of queries, one line each.
const QUERIES: &str = "queries.jsonl";

/// The folder.
pub(super) struct Work {
    folder: PathBuf,
    /// Matches of pairs of map images.
    matches: MatchFile,
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
        let matches = MatchFile::open(&folder.join("matches.bin"))?;
        Ok(Self { folder: folder.to_owned(), matches, _lock: lock })
    }

    /// Matches of pairs of map images, found earlier or now.
    pub(super) const fn matches(&self) -> &MatchFile {
        &self.matches
    }
}

fn io(path: &Path) -> impl Fn(std::io::Error) -> EvalError {
    move |source| EvalError::Io { path: path.to_owned(), source }
}
