//! The end of every command that makes or changes a map: its self-test, the warnings that follow from it, and the refusal
//! of a map in which nothing can be localized.

use veiloc_map::{MapModel, SelfTest};

use crate::build::diagnose::diagnose;
use crate::build::report::MapWarning;
use crate::calibration::{SelfTestOptions, SelfTestTrial, chosen, is_testable, summarize_trials, trials};
use crate::error::MappingError;
use crate::progress::Progress;

/// How a map is finished.
#[derive(Debug, Clone, Copy)]
pub struct FinishOptions {
    /// Localize images of the map, each left out of it: this calibrates the covariances of its answers. Without it they
    /// are those of other maps.
    pub self_test: bool,
    /// Accept a map in which nothing can be localized.
    pub keep_broken: bool,
}

impl Default for FinishOptions {
    fn default() -> Self {
        Self { self_test: true, keep_broken: false }
    }
}

/// Finishes a map that was made or changed, before it is written: tests it, stores the result in it, and adds the warnings
/// that follow from it.
///
/// # Errors
/// [`MappingError::Broken`] when nothing can be localized in the map; others as for
/// [`self_test`](crate::calibration::self_test).
pub fn finish(
    model: &mut MapModel,
    warnings: &mut Vec<MapWarning>,
    options: &FinishOptions,
    progress: &dyn Progress,
) -> Result<(), MappingError> {
    model.self_test = None;
    if options.self_test && is_testable(model) {
        let of_test = SelfTestOptions::default();
        let trials = trials(model, &chosen(model, &of_test), &of_test, progress)?;
        return finish_tested(model, warnings, &of_test, &trials, options.keep_broken);
    }
    if options.keep_broken { Ok(()) } else { refuse_broken(model, warnings) }
}

/// [`finish`] with the trials of all [`chosen`] images, in their order, as several processes computed them.
///
/// # Errors
/// [`MappingError::Broken`].
pub fn finish_tested(
    model: &mut MapModel,
    warnings: &mut Vec<MapWarning>,
    options: &SelfTestOptions,
    trials: &[Vec<Option<SelfTestTrial>>],
    keep_broken: bool,
) -> Result<(), MappingError> {
    let test = summarize_trials(model, trials, options);
    let alike = MapWarning::of_trials(model, &chosen(model, options), trials);
    // Images that were localized in the other one of two such places have poses without a mistake.
    let explains = alike.is_some();
    warnings.extend(alike);
    if let Some(warning) = MapWarning::of_self_test(&test).filter(|_| !explains) {
        warnings.push(warning);
        if !warnings.iter().any(|d| matches!(d, MapWarning::LikelyCause { .. })) {
            warnings.extend(diagnose(model));
        }
    }
    if let Some(warning) = MapWarning::of_precision(&test).filter(|_| !explains) {
        warnings.push(warning.with_worst(model, &chosen(model, options), trials, test.scale));
    }
    model.self_test = Some(test);
    if keep_broken { Ok(()) } else { refuse_broken(model, warnings) }
}

/// Refuses a compressed map, tested in its own way, in which nothing can be localized. `whole` is the map that it was made
/// of.
///
/// # Errors
/// [`MappingError::Broken`].
pub fn refuse_broken_compressed(whole: &MapModel, compressed: &MapModel) -> Result<(), MappingError> {
    let mut warnings: Vec<MapWarning> =
        compressed.self_test.as_ref().and_then(MapWarning::of_self_test).into_iter().collect();
    if !warnings.is_empty() {
        warnings.extend(diagnose(whole));
    }
    refuse_broken(compressed, &warnings)
}

/// Refuses a map in which nothing can be localized, so that it does not replace a usable one.
fn refuse_broken(model: &MapModel, warnings: &[MapWarning]) -> Result<(), MappingError> {
    if !is_broken(model, warnings) {
        return Ok(());
    }
    let warnings = warnings.iter().map(ToString::to_string).collect();
    Err(MappingError::Broken { points: model.points.len(), warnings })
}

/// Detects a map with almost no points, one that localizes few of its own images for a known reason, and one that
/// localizes none of them although its points are seen in enough images. A low share alone proves nothing: if images
/// are sparse, each left-out image may take all points with it.
fn is_broken(model: &MapModel, warnings: &[MapWarning]) -> bool {
    let has = |which: fn(&MapWarning) -> bool| warnings.iter().any(which);
    let explained = has(|d| matches!(d, MapWarning::LikelyCause { .. }));
    let empty = has(|d| matches!(d, MapWarning::FewPoints { .. }));
    let test = model.self_test.as_ref();
    let failed = test.is_some_and(SelfTest::failed);
    let localizes_none = test.is_some_and(|test| {
        let best = test.schemes.iter().map(|scheme| scheme.localized).max().unwrap_or(0);
        localizes_none(best, test.images, model.mean_track_length())
    });
    model.points.len() < MIN_POINTS
        || (explained && has(|d| matches!(d, MapWarning::SelfTest { .. })))
        || (empty && failed)
        || localizes_none
}

/// Whether none of enough images was localized, although their points are seen in enough images.
fn localizes_none(localized: u32, images: u32, mean_track_length: f64) -> bool {
    localized == 0 && images >= MIN_IMAGES && mean_track_length >= MIN_TRACK_LENGTH
}

/// Minimum number of points for localization: a pose needs ten inliers.
const MIN_POINTS: usize = 10;

/// Number of images, and mean number of images that see a point, from which on enough points remain without an image
/// and its two nearest neighbours, which the self-test leaves out.
const MIN_IMAGES: u32 = 8;
const MIN_TRACK_LENGTH: f64 = 4.0;

#[cfg(test)]
mod tests {
    use super::*;

    /// A lens whose distortion folds the image (8 images, 4.4 images a point, none localized) is refused. A map of few
    /// images, or of points that few images see, loses its points when images are left out, and may be good.
    #[test]
    fn maps_that_localize_none_of_enough_images_are_broken() {
        assert!(localizes_none(0, 8, 4.4));
        assert!(!localizes_none(1, 8, 4.4));
        assert!(!localizes_none(0, 4, 4.0));
        assert!(!localizes_none(0, 50, 2.6));
    }
}
