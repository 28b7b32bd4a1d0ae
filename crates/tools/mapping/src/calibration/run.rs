//! Running a self-test: which images, each left out, sealed and localized under each scheme.

use crate::{LeaveOut, MappingError, Progress};
use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use rayon::prelude::*;
use veiloc_localization::{LocalizeOptions, Matched, localize_matched, match_in};
use veiloc_map::{MapFile, MapModel, MapView, PointId, SelfTest, Without};
use veiloc_protocol::{Scheme, SealedQuery};

use crate::calibration::query::{options_for, sealed, stored_features, transferred};
use crate::calibration::summary::{median, summarize};
use crate::calibration::trial::Trial;

/// How to test a map.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SelfTestOptions {
    /// Most images that are localized, spread evenly over the map. Default 50: more say little more about a factor of the
    /// standard deviations, which 50 tell to a twentieth.
    pub images: usize,
    /// Under which schemes. Default: all.
    pub schemes: Vec<Scheme>,
    /// How queries of the map will be localized.
    pub localize: LocalizeOptions,
    /// Seed of the seals' draws.
    pub seed: u64,
}

impl Default for SelfTestOptions {
    fn default() -> Self {
        Self { images: 50, schemes: Scheme::ALL.into(), localize: LocalizeOptions::default(), seed: 0 }
    }
}

/// Whether the map has images to test with, and words of its own to find them by.
pub fn is_testable(model: &MapModel) -> bool {
    !model.images.is_empty() && model.profile.vocabulary().is_some()
}

/// Localizes images of the map, each left out of it, and says how well that went.
///
/// The map stays as it is; the result belongs into its `self_test`. An image of which no query can be made, because it has
/// no keypoints, counts as one that was not localized. Equal maps and options give equal results, whatever the number of
/// threads. Takes the memory of the map's file beside the map.
///
/// # Errors
/// [`MappingError`]: the map does not hold together, or no device can seal for its profile.
pub fn self_test(
    model: &MapModel,
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<SelfTest, MappingError> {
    let file = MapFile::of_model(model)?;
    let leave_out = LeaveOut::of(model);
    test_in(model, &file, &|image| leave_out.without(image), options, progress)
}

/// Localizes images of a map, each left out, in a file that may be another one with the same images.
pub(crate) fn test_in(
    model: &MapModel,
    file: &MapFile,
    without: &(dyn Fn(usize) -> Without + Sync),
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<SelfTest, MappingError> {
    let chosen = chosen(model, options);
    let trials = tried(model, file, without, &chosen, options, progress)?;
    Ok(test_of(model, &trials, options))
}

/// The images that a self-test localizes, by their places in the map: up to [`SelfTestOptions::images`], spread evenly.
pub fn chosen(model: &MapModel, options: &SelfTestOptions) -> Vec<usize> {
    spread(model.images.len(), options.images)
}

/// Localizes these images of the map, each left out, under each scheme: a part of a [`self_test`], for many hands. `None` where
/// there is no pose.
///
/// # Errors
/// [`MappingError`] as for [`self_test`].
pub fn trials(
    model: &MapModel,
    images: &[usize],
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<Vec<Vec<Option<Trial>>>, MappingError> {
    let file = MapFile::of_model(model)?;
    let leave_out = LeaveOut::of(model);
    tried(model, &file, &|image| leave_out.without(image), images, options, progress)
}

/// What the trials of all [`chosen`] images, in their order, come to: [`self_test`] of parts.
pub fn test_of(model: &MapModel, trials: &[Vec<Option<Trial>>], options: &SelfTestOptions) -> SelfTest {
    let scale = scale(model);
    let of_scheme = |(index, scheme): (usize, &Scheme)| {
        let of_images: Vec<Option<Trial>> =
            trials.iter().map(|of_image| of_image.get(index).cloned().flatten()).collect();
        summarize(*scheme, &of_images, scale)
    };
    SelfTest {
        images: trials.len() as u32,
        scale,
        assumed_noise_px: options.localize.pose.noise_px,
        schemes: options.schemes.iter().enumerate().map(of_scheme).collect(),
    }
}

fn tried(
    model: &MapModel,
    file: &MapFile,
    without: &(dyn Fn(usize) -> Without + Sync),
    images: &[usize],
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<Vec<Vec<Option<Trial>>>, MappingError> {
    for scheme in &options.schemes {
        options_for(*scheme, &model.profile).bounded(&model.profile)?;
    }
    progress.start("Testing the map", images.len());
    let of_image = |&image: &usize| {
        let trials = trials_of(model, file, &without(image), image, options);
        progress.advance(1);
        trials
    };
    let trials = images.par_iter().map(of_image).collect();
    progress.finish();
    Ok(trials)
}

/// One entry a scheme; `None` where there is no pose.
fn trials_of(
    model: &MapModel,
    file: &MapFile,
    without: &Without,
    image: usize,
    options: &SelfTestOptions,
) -> Vec<Option<Trial>> {
    let view = MapView::without(file, without);
    let truth = &model.images[image].cam_from_world;
    let mut first: Option<(SealedQuery, Matched)> = None;
    let mut trial = |scheme: &Scheme| {
        let seal_options = options_for(*scheme, &model.profile);
        let (features, camera) = stored_features(model, &model.images[image], &seal_options).ok()?;
        let mut rng = ChaCha20Rng::seed_from_u64(options.seed);
        // Of the scheme itself, so that it draws the same whichever others are tested.
        let stream = Scheme::ALL.iter().position(|s| s.name() == scheme.name()).unwrap_or(0);
        rng.set_stream((image as u64) << 8 | stream as u64);
        let query = sealed(features, &camera, &model.profile, &seal_options, &mut rng).ok()?;
        let known = first.as_ref().and_then(|(other, matched)| transferred(matched, other, &query));
        let matched = match known {
            Some(matched) => matched,
            None => match_in(&query, view, &options.localize).ok()?,
        };
        let found = localize_matched(&query, view, matched.clone(), &options.localize);
        first.get_or_insert((query, matched));
        Some(Trial::of(&found.ok()?, truth))
    };
    options.schemes.iter().map(&mut trial).collect()
}

/// Up to `most` of so many images, spread evenly.
fn spread(images: usize, most: usize) -> Vec<usize> {
    let count = images.min(most);
    (0..count).map(|i| (2 * i + 1) * images / (2 * count)).collect()
}

/// Median over the images of the median distance of the points they see, map units; 0 when none sees any.
fn scale(model: &MapModel) -> f64 {
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
