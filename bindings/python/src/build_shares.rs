//! Shares of a map's build and self-test for several processes; `veiloc.ray` distributes them.

use std::path::PathBuf;

use pyo3::prelude::*;
use veiloc_mapping::build_cache::FolderCache;
use veiloc_mapping::calibration::SelfTestTrial;
use veiloc_mapping::{BuildOptions, BuildStage, Input, StageShare, prepare as prepare_share};
use veiloc_pose::likelihood::{BestCamera, CameraEvidence};

use crate::blocking::ProgressCallback;
use crate::errors::{BindingError, Result};
use crate::posed::{on_bad, posed_of};

/// Computes one share of the intermediate results of `Map.build`, and caches it in the folder `work`.
///
/// `Map.build` with the same arguments and `work` then reads the cache, and computes what is missing. The stages
/// `"features"`, `"first-pairs"` and `"pairs"` run in this order; each needs all shares of the stage before it.
///
/// Args:
///     posed, images, names, features, skip_bad, progress: as for `Map.build`.
///     work: folder of the cache; several processes may write to it at once. It holds keypoints and descriptors of the
///         images.
///     stage: `"features"`, `"first-pairs"` or `"pairs"`.
///     share: `(i, n)`: share `i` of `n`, counted from 0.
///
/// Returns:
///     The number of images or pairs in this share, and in all shares.
///
/// Raises:
///     MapError, ImageError: as for `Map.build`.
///     InputError: `stage` or `share` is invalid.
#[pyfunction]
#[pyo3(signature = (posed, images, work, stage, share, *, names=None, features="compact", skip_bad=false, progress=None))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub(crate) fn prepare(
    py: Python<'_>,
    posed: &Bound<'_, PyAny>,
    images: PathBuf,
    work: PathBuf,
    stage: &str,
    share: (usize, usize),
    names: Option<Vec<String>>,
    features: &str,
    skip_bad: bool,
    progress: Option<Py<PyAny>>,
) -> Result<(usize, usize)> {
    let posed = posed_of(posed, &images)?.images;
    let stage = match stage {
        "features" => BuildStage::Features,
        "first-pairs" => BuildStage::FirstPairs,
        "pairs" => BuildStage::Pairs,
        other => {
            return Err(BindingError::input(format_args!(
                "stage: unknown stage {other:?}; the stages are features, first-pairs, pairs"
            )));
        }
    };
    let (part, of) = share;
    let share = StageShare::new(part, of).ok_or_else(|| {
        BindingError::input(format_args!("share: ({part}, {of}) is not a share; give (i, n) with 0 <= i < n"))
    })?;
    let mut options = BuildOptions::default();
    features.clone_into(&mut options.features);
    ProgressCallback::new(py, progress)?.run(py, |progress| {
        let mut input = Input::new(&posed, &images).on_bad_image(on_bad(skip_bad));
        if let Some(names) = &names {
            input = input.with_names(names);
        }
        let cache = FolderCache::in_folder(&work, &options).map_err(BindingError::map)?;
        let done = prepare_share(&input, &cache, &options, stage, share, progress)?;
        cache.finish().map_err(BindingError::map)?;
        Ok((done.done, done.of_all))
    })?
}

/// Pose of a map image in the self-test: step to the true pose, rows of the covariance and of its part from the camera
/// model, whether it was trusted, noise in pixels, evidence about the camera,
/// an image of a place that looks alike. Private to `self_test_share` and `with_self_test`.
pub(crate) type TrialParts =
    ([f64; 6], [[f64; 6]; 6], [[f64; 6]; 6], bool, f64, Option<CameraParts>, Option<usize>);

/// The numbers of a [`CameraEvidence`] and of its best camera, in the order of their fields.
type CameraParts = ([[f64; 6]; 6], [f64; 6], f64, Option<(f64, f64)>, f64);

/// One image: its index in the map, and a pose or None for each scheme.
pub(crate) type ImageParts = (usize, Vec<Option<TrialParts>>);

pub(crate) fn parts_of(image: usize, trials: Vec<Option<SelfTestTrial>>) -> ImageParts {
    let parts = |trial: SelfTestTrial| {
        let camera = trial.camera_evidence.map(|camera| {
            let best = camera.best.map(|best| (best.gain, best.shared_variance));
            (camera.information, camera.gradient, camera.shared_variance, best, camera.focal_gain)
        });
        (
            trial.step,
            trial.covariance,
            trial.camera_covariance,
            trial.trusted,
            trial.noise_px,
            camera,
            trial.looks_like,
        )
    };
    (image, trials.into_iter().map(|trial| trial.map(parts)).collect())
}

pub(crate) fn trials_of(parts: Vec<Option<TrialParts>>) -> Vec<Option<SelfTestTrial>> {
    let camera_evidence =
        |(information, gradient, shared_variance, best, focal_gain): CameraParts| CameraEvidence {
            information,
            gradient,
            shared_variance,
            best: best.map(|(gain, shared_variance)| BestCamera { gain, shared_variance }),
            focal_gain,
        };
    let trial = |(step, covariance, camera_covariance, trusted, noise_px, camera, looks_like): TrialParts| {
        SelfTestTrial {
            step,
            covariance,
            camera_covariance,
            trusted,
            noise_px,
            camera_evidence: camera.map(camera_evidence),
            looks_like,
        }
    };
    parts.into_iter().map(|parts| parts.map(trial)).collect()
}
