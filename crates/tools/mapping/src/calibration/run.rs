//! Runs a self-test: chooses the images, leaves each out, seals and localizes it under each scheme.

use crate::{HoldOutMap, MappingError, Progress};
use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use rayon::prelude::*;
use veiloc_localization::{LocalizeOptions, MatchResult, localize_matched, match_in};
use veiloc_map::{HeldOut, MapFile, MapModel, MapView, PointId, SelfTest};
use veiloc_obfuscation::Sealer;
use veiloc_protocol::{Scheme, SealedQuery};

use crate::calibration::query::{sealed, sealer_for, stored_features, transfer_matches};
use crate::calibration::summary::{median, summarize};
use crate::calibration::trial::SelfTestTrial;

/// Options of a self-test.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SelfTestOptions {
    /// Maximum number of localized images, evenly spaced over the map. Default 50: they determine the factor of the
    /// standard deviations to about 5 %, and more images add little.
    pub images: usize,
    /// The schemes. Default: all.
    pub schemes: Vec<Scheme>,
    /// Localization options, as for later queries of the map.
    pub localize: LocalizeOptions,
    /// Seed for sealing.
    pub seed: u64,
}

impl Default for SelfTestOptions {
    fn default() -> Self {
        Self { images: 50, schemes: Scheme::ALL.into(), localize: LocalizeOptions::default(), seed: 0 }
    }
}

/// Returns whether the map has images to test with, and a vocabulary of its own for retrieval.
pub fn is_testable(model: &MapModel) -> bool {
    !model.images.is_empty() && model.profile.vocabulary().is_some()
}

/// Localizes images of the map, each left out of it, and summarizes the errors.
///
/// The map does not change; the result belongs in its `self_test`. An image without keypoints counts as not localized.
/// Equal maps and options give equal results for any number of threads. Memory: the size of the map's file in addition
/// to the map.
///
/// # Errors
/// [`MappingError`]: the map is inconsistent, or no device can seal for its profile.
pub fn self_test(
    model: &MapModel,
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<SelfTest, MappingError> {
    let file = MapFile::of_model(model)?;
    let hold_out = HoldOutMap::of(model);
    test_in(model, &file, &|image| hold_out.without(&hold_out.with_neighbors(image)), options, progress)
}

/// Localizes images of a map, each left out, in a file that may be another map with the same images.
pub(crate) fn test_in(
    model: &MapModel,
    file: &MapFile,
    without: &(dyn Fn(usize) -> HeldOut + Sync),
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<SelfTest, MappingError> {
    let chosen = chosen(model, options);
    let trials = run_trials(model, file, without, &chosen, options, progress)?;
    Ok(summarize_trials(model, &trials, options))
}

/// Returns the indices of the images that a self-test localizes: up to [`SelfTestOptions::images`], evenly spaced.
pub fn chosen(model: &MapModel, options: &SelfTestOptions) -> Vec<usize> {
    evenly_spaced(model.images.len(), options.images)
}

/// Localizes these images of the map, each left out, under each scheme: one part of a distributed [`self_test`]. `None`
/// if no pose was found.
///
/// # Errors
/// [`MappingError`] as for [`self_test`].
pub fn trials(
    model: &MapModel,
    images: &[usize],
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<Vec<Vec<Option<SelfTestTrial>>>, MappingError> {
    let file = MapFile::of_model(model)?;
    let hold_out = HoldOutMap::of(model);
    run_trials(
        model,
        &file,
        &|image| hold_out.without(&hold_out.with_neighbors(image)),
        images,
        options,
        progress,
    )
}

/// Summarizes the trials of all [`chosen`] images, in their order: the result of a distributed [`self_test`].
pub fn summarize_trials(
    model: &MapModel,
    trials: &[Vec<Option<SelfTestTrial>>],
    options: &SelfTestOptions,
) -> SelfTest {
    let scale = scale(model);
    let alike = trials.iter().filter(|of| of.iter().flatten().any(|t| t.looks_like.is_some())).count();
    let of_scheme = |(index, scheme): (usize, &Scheme)| {
        let of_images: Vec<Option<SelfTestTrial>> =
            trials.iter().map(|of_image| of_image.get(index).cloned().flatten()).collect();
        summarize(*scheme, &of_images, scale, alike >= MIN_ALIKE)
    };
    SelfTest {
        images: trials.len() as u32,
        scale,
        assumed_noise_px: options.localize.pose.noise_px,
        schemes: options.schemes.iter().enumerate().map(of_scheme).collect(),
    }
}

fn run_trials(
    model: &MapModel,
    file: &MapFile,
    without: &(dyn Fn(usize) -> HeldOut + Sync),
    images: &[usize],
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<Vec<Vec<Option<SelfTestTrial>>>, MappingError> {
    let sealers = options.schemes.iter().map(|scheme| sealer_for(*scheme, &model.profile));
    let sealers = sealers.collect::<Result<Vec<_>, _>>()?;
    progress.start("Testing the map", images.len());
    let of_image = |&image: &usize| {
        let trials = trials_of(model, file, &without(image), image, &sealers, options);
        progress.advance(1);
        trials
    };
    let trials = images.par_iter().map(of_image).collect();
    progress.finish();
    Ok(trials)
}

/// One entry per scheme; `None` if no pose was found.
fn trials_of(
    model: &MapModel,
    file: &MapFile,
    without: &HeldOut,
    image: usize,
    sealers: &[Sealer],
    options: &SelfTestOptions,
) -> Vec<Option<SelfTestTrial>> {
    let view = MapView::without(file, without);
    let mut localize = options.localize.clone();
    localize.pose.camera_evidence = true;
    let truth = &model.images[image].cam_from_world;
    let mut first: Option<(SealedQuery, MatchResult)> = None;
    let mut trial = |(scheme, sealer): (&Scheme, &Sealer)| {
        let extracted = stored_features(model, &model.images[image], sealer);
        let mut rng = ChaCha20Rng::seed_from_u64(options.seed);
        // Depends on the scheme only, so that the other tested schemes do not change its random numbers.
        let stream = Scheme::ALL.iter().position(|s| s.name() == scheme.name()).unwrap_or(0);
        rng.set_stream((image as u64) << 8 | stream as u64);
        let query = sealed(sealer, extracted, &mut rng).ok()?;
        let known = first.as_ref().and_then(|(other, matched)| transfer_matches(matched, other, &query));
        let matched = match known {
            Some(matched) => matched,
            None => match_in(&query, view, &localize).ok()?,
        };
        let found = localize_matched(&query, view, matched.clone(), &localize);
        first.get_or_insert((query, matched));
        Some(SelfTestTrial::of(model, &found.ok()?, truth))
    };
    options.schemes.iter().zip(sealers).map(&mut trial).collect()
}

/// Number of test images that fit a second place, from which on parts of the map look alike: a single one may be chance.
pub(crate) const MIN_ALIKE: usize = 2;

/// Returns up to `limit` of the image indices, evenly spaced.
pub(crate) fn evenly_spaced(images: usize, limit: usize) -> Vec<usize> {
    let count = images.min(limit);
    (0..count).map(|i| (2 * i + 1) * images / (2 * count)).collect()
}

/// Median over the images of the median distance to their points, map units; 0 if no image has points.
pub(crate) fn scale(model: &MapModel) -> f64 {
    let of_image = |image: &veiloc_map::MapImage| {
        let center = image.cam_from_world.center();
        let seen = image.point_of_keypoint.iter().flatten();
        let distances: Vec<f64> =
            seen.map(|PointId(id)| model.points[*id as usize].position.distance(&center)).collect();
        (!distances.is_empty()).then(|| median(distances))
    };
    let scale = median(model.images.iter().filter_map(of_image).collect());
    if scale.is_finite() { scale } else { 0.0 }
}
