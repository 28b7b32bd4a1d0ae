//! Masks of map images, looked at before a build.

use std::path::{Path, PathBuf};

use veiloc_features::{FeatureError, load_mask};

use crate::error::MappingError;
use crate::input::image_names::mask_file;

/// Masks that are read before a build.
const SAMPLED: usize = 25;
/// Share of an image that masks of people seldom hide.
const DOUBTED_SHARE: f64 = 0.6;

/// The masks of some images.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct MaskFacts {
    /// Images that have one.
    pub masks: usize,
    /// Share of an image that they hide, the median of some of them.
    pub median_share: f64,
}

impl MaskFacts {
    /// Counts the masks of images, and reads some of them.
    ///
    /// # Errors
    /// [`MappingError::NoMasks`]: no image has one. [`MappingError::Features`]: one cannot be read.
    pub fn of<'a>(folder: &Path, names: impl IntoIterator<Item = &'a str>) -> Result<Self, MappingError> {
        let all: Vec<PathBuf> = names.into_iter().map(|name| mask_file(folder, name)).collect();
        let files: Vec<&PathBuf> = all.iter().filter(|file| file.exists()).collect();
        if files.is_empty() {
            let expected = all.into_iter().next().unwrap_or_else(|| folder.to_owned());
            return Err(MappingError::NoMasks { folder: folder.to_owned(), expected });
        }
        let share = |file: &&PathBuf| match load_mask(file) {
            Ok(mask) => Ok(mask.share()),
            Err(FeatureError::HidesNothing { .. }) => Ok(0.0),
            Err(error) => Err(error),
        };
        let sampled = files.iter().step_by(files.len().div_ceil(SAMPLED).max(1));
        let mut shares: Vec<f64> = sampled.map(share).collect::<Result<_, _>>()?;
        shares.sort_by(f64::total_cmp);
        Ok(Self { masks: files.len(), median_share: shares[shares.len() / 2] })
    }

    /// What is odd about them: masks that hide nearly all.
    pub fn doubt(&self) -> Option<String> {
        (self.median_share > DOUBTED_SHARE).then(|| {
            format!(
                "the masks hide {:.0} % of an image in the median. Black hides; if white marks people in them, invert them",
                100.0 * self.median_share
            )
        })
    }
}
