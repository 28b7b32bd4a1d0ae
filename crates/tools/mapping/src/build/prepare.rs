//! Distributed builds: a worker computes one share, stores it in the cache, and the build reads it there.
//!
//! ```text
//! Stage::Features ── all shares ──▶ Stage::FirstPairs ── all shares ──▶ Stage::Pairs ── all shares ──▶ build
//! ```
//!
//! A missing or lost share costs only time: the next step computes it. A distributed build therefore gives the same map
//! as a single process, to the bit.

use veiloc_descriptor::DescriptorView;

use crate::build::extract::{ExtractionResult, ExtractorPair, extract_all, extract_each};
use crate::build::{add_seeds, cache_keys, first_pairs, further_pairs, seeds_of};
use crate::error::MappingError;
use crate::input::Input;
use crate::input::cache::BuildCache;
use crate::input::options::{BuildOptions, for_images};
use crate::progress::Progress;
use crate::triangulation::matching::{Edges, match_pairs};
use crate::triangulation::scene::Scene;

/// Stages that can be distributed; each stage needs the results of the one before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BuildStage {
    /// Features of the images.
    Features,
    /// Matches of the pairs that are selected by their poses.
    FirstPairs,
    /// Matches of the pairs that overlap according to the first matches.
    Pairs,
}

/// One worker's share of a stage: every `of`-th image or pair, from the `part`-th on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StageShare {
    /// Less than `of`.
    part: usize,
    of: usize,
}

impl StageShare {
    /// Returns the `part`-th of `of` shares, from 0; `None` if there is no such share.
    pub const fn new(part: usize, of: usize) -> Option<Self> {
        if part < of { Some(Self { part, of }) } else { None }
    }

    fn of<T>(self, all: Vec<T>) -> Vec<T> {
        all.into_iter().skip(self.part).step_by(self.of).collect()
    }
}

/// Result of a share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShareSummary {
    /// Number of images or pairs in the share.
    pub done: usize,
    /// Number of images or pairs in all shares.
    pub of_all: usize,
}

/// Computes a share of the entries that [`build`](crate::build) will look up in `cache`, with the same input and
/// options. Equal input gives equal shares on every machine.
///
/// # Errors
/// [`MappingError`] as for [`build`](crate::build): for the images of this share, or for all images in the matching
/// stages, which need them all.
pub fn prepare(
    input: &Input<'_>,
    cache: &dyn BuildCache,
    options: &BuildOptions,
    stage: BuildStage,
    share: StageShare,
    progress: &dyn Progress,
) -> Result<ShareSummary, MappingError> {
    options.settings.check()?;
    let input = &input.with_cache(cache);
    let extractors = input.extractors().unwrap_or(&options.extractors);
    let extractor_pair =
        ExtractorPair { extractor: extractors.named(&options.features)?, global: options.global.as_ref() };
    let limits = options.settings.extraction;
    let mut checked = input.check(|_| false)?;
    if stage == BuildStage::Features {
        let of_all = checked.images.len();
        checked.images = share.of(checked.images);
        let done = checked.images.len();
        if done > 0 {
            extract_each(checked, extractor_pair, limits, progress, |_, _| ())?;
        }
        return Ok(ShareSummary { done, of_all });
    }
    let ExtractionResult { images, features, .. } = extract_all(checked, extractor_pair, limits, progress)?;
    let settings = &for_images(&options.settings, images.len());
    let scene = Scene::of_features(&images, &features, settings);
    let focus: Vec<u32> = (0..images.len() as u32).collect();
    let keys = cache_keys(&scene, Some(cache));
    let cache = keys.as_deref().map(|keys| (cache, keys));
    let descriptors: &[DescriptorView<'_>] = &scene.descriptors;
    let matched = |pairs: &[(u32, u32)]| -> Edges {
        progress.start("Matching pairs", pairs.len());
        match_pairs(pairs, &scene.views, descriptors, settings.max_ratio, cache, progress)
    };
    let pairs = match (input.pairs_of(&images)?, stage) {
        // Given pairs are matched in one stage, the last.
        (Some(pairs), BuildStage::Pairs) => pairs,
        (Some(_), _) => Vec::new(),
        (None, _) => {
            let mut seeds = seeds_of(input.posed(), &images);
            let first = first_pairs(&scene, &seeds, &focus);
            if stage == BuildStage::Pairs {
                add_seeds(&scene, &matched(&first).verified, &mut seeds);
                further_pairs(&scene, &seeds, &focus, settings, &first)
            } else {
                first
            }
        }
    };
    let of_all = pairs.len();
    let own = share.of(pairs);
    matched(&own);
    progress.finish();
    Ok(ShareSummary { done: own.len(), of_all })
}
