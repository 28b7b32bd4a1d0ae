//! Cache of a map build: features of images, matches of pairs.
//!
//! It serves interrupted builds, builds with more images, and distributed builds: several processes, on one machine or
//! on several with a shared folder, may use it at once ([`crate::build::prepare`]).
//!
//! Every entry is keyed by the hash of its inputs: the bytes of the image file, the options, the extractor's output on
//! a fixed pattern (the extractor's name does not identify its weights), the version of this program. An outdated entry
//! is therefore never used; a damaged or truncated entry is computed again.
//!
//! The folder contains keypoints and descriptors of the map's images, as the map does: protect it in the same way.
//!
//! ```no_run
//! use std::path::Path;
//! use veiloc_mapping::build_cache::FolderCache;
//! use veiloc_map::colmap::read_posed;
//! use veiloc_mapping::{BuildOptions, Input, build};
//!
//! let (posed, options) = (read_posed(Path::new("hall/sparse"))?, BuildOptions::default());
//! let cache = FolderCache::in_folder(Path::new("hall.work"), &options)?;
//! let (map, _) = build(&Input::new(&posed, Path::new("hall/images")).with_cache(&cache), &options, &())?;
//! cache.finish()?;
//! veiloc_map::write(&map, Path::new("hall.vmap"))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod features;
mod key;
mod matches;
mod pattern;

use std::fs;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use crate::{BuildCache, BuildOptions, ExtractedFeatures, FeatureRequest, MappingError};
use veiloc_descriptor::{DescriptorView, Match, MatchOptions};

use features::FeatureFolder;
pub use key::CacheKey;
use matches::MatchFiles;

/// Cache of map builds in a folder.
#[derive(Debug)]
pub struct FolderCache {
    features: FeatureFolder,
    matches: MatchFiles,
    /// The first write error.
    first_error: Mutex<Option<MappingError>>,
}

impl FolderCache {
    /// Opens or creates the cache folder for builds with these options.
    ///
    /// # Errors
    /// [`MappingError`]: the folder cannot be written, or the options name an extractor that is missing or cannot run.
    pub fn in_folder(folder: &Path, options: &BuildOptions) -> Result<Self, MappingError> {
        let features = folder.join("features");
        fs::create_dir_all(&features).map_err(MappingError::io(&features))?;
        let mut key = CacheKey::new("features");
        pattern::add_extractor_output(&mut key, options)?;
        Ok(Self {
            features: FeatureFolder::new(features, key),
            matches: MatchFiles::in_folder(folder)?,
            first_error: Mutex::new(None),
        })
    }

    /// Returns the first write error; call it after the build.
    ///
    /// # Errors
    /// [`MappingError`]: the first file that could not be written. The built map is valid in any case.
    pub fn finish(&self) -> Result<(), MappingError> {
        self.first_error.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err)
    }

    fn record_error(&self, outcome: Result<(), MappingError>) {
        if let Err(error) = outcome {
            self.first_error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        }
    }
}

impl BuildCache for FolderCache {
    fn features(&self, request: &FeatureRequest<'_>) -> Option<ExtractedFeatures> {
        self.features.get(request)
    }

    fn store_features(&self, request: &FeatureRequest<'_>, found: &ExtractedFeatures) {
        self.record_error(self.features.store(request, found));
    }

    fn key(&self, descriptors: DescriptorView<'_>) -> [u8; 32] {
        let mut key = CacheKey::new("descriptors");
        key.debug(&descriptors.kind());
        key.bytes(descriptors.as_bytes());
        key.digest()
    }

    fn matches(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions) -> Option<Vec<Match>> {
        self.matches.get(a, b, options)
    }

    fn store_matches(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions, matches: &[Match]) {
        self.record_error(self.matches.store(a, b, options, matches));
    }
}
