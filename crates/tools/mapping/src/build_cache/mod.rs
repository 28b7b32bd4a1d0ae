//! What building a map computes, kept in a folder: features of images, matches of pairs.
//!
//! For builds that were interrupted, that are done again with some more images, or that many hands share: several processes, on
//! one machine or on several that see the folder, may keep in it at once ([`crate::prepare`]).
//!
//! Everything is found by a hash of what it was computed from: the bytes of the image's file, the options, what the extractor
//! makes of an image that is always the same (its name does not say which weights it was read with), the version of this
//! program. What no longer fits is never taken for what does; what is damaged or cut short is computed again.
//!
//! The folder holds keypoints and descriptors of the map's images, as the map does, and is to be kept from others like it.
//!
//! ```no_run
//! use std::path::Path;
//! use veiloc_mapping::build_cache::Keeping;
//! use veiloc_map::colmap::read_posed;
//! use veiloc_mapping::{BuildOptions, Input, build};
//!
//! let (posed, options) = (read_posed(Path::new("hall/sparse"))?, BuildOptions::default());
//! let keeping = Keeping::in_folder(Path::new("hall.work"), &options)?;
//! let (map, _) = build(&Input::new(&posed, Path::new("hall/images")).with_kept(&keeping), &options, &())?;
//! keeping.finish()?;
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

use crate::{BuildOptions, Extracted, Kept, MappingError, Wanted};
use veiloc_descriptor::{DescriptorView, Match, MatchOptions};

use features::FeatureFolder;
pub use key::Key;
use matches::MatchFiles;

/// A folder in which builds keep what they compute.
#[derive(Debug)]
pub struct Keeping {
    features: FeatureFolder,
    matches: MatchFiles,
    /// The first thing that could not be kept.
    fault: Mutex<Option<MappingError>>,
}

impl Keeping {
    /// A folder, made if it is not there, for builds with these options.
    ///
    /// # Errors
    /// [`MappingError`]: the folder cannot be written, or the options name an extractor that is not there or cannot run.
    pub fn in_folder(folder: &Path, options: &BuildOptions) -> Result<Self, MappingError> {
        let features = folder.join("features");
        fs::create_dir_all(&features).map_err(MappingError::io(&features))?;
        let mut key = Key::new("features");
        pattern::behaviour(&mut key, options)?;
        Ok(Self {
            features: FeatureFolder::new(features, key),
            matches: MatchFiles::in_folder(folder)?,
            fault: Mutex::new(None),
        })
    }

    /// To be asked when a build has ended: whether all could be kept.
    ///
    /// # Errors
    /// [`MappingError`]: the first file that could not be written. What was built is right all the same.
    pub fn finish(&self) -> Result<(), MappingError> {
        let fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner).take();
        fault.map_or(Ok(()), Err)
    }

    fn remember(&self, outcome: Result<(), MappingError>) {
        if let Err(fault) = outcome {
            self.fault.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(fault);
        }
    }
}

impl Kept for Keeping {
    fn features(&self, wanted: &Wanted<'_>) -> Option<Extracted> {
        self.features.get(wanted)
    }

    fn keep_features(&self, wanted: &Wanted<'_>, found: &Extracted) {
        self.remember(self.features.keep(wanted, found));
    }

    fn name(&self, descriptors: DescriptorView<'_>) -> [u8; 32] {
        let mut key = Key::new("descriptors");
        key.debug(&descriptors.kind());
        key.bytes(descriptors.as_bytes());
        key.digest()
    }

    fn matches(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions) -> Option<Vec<Match>> {
        self.matches.get(a, b, options)
    }

    fn keep_matches(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions, matches: &[Match]) {
        self.remember(self.matches.keep(a, b, options, matches));
    }
}
