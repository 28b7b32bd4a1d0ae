//! Shares of a map's building and self-test, for many hands: `veiloc.ray` hands them out.

use std::path::PathBuf;

use pyo3::prelude::*;
use veiloc_mapping::build_cache::Keeping;
use veiloc_mapping::calibration::Trial;
use veiloc_mapping::{BuildOptions, Input, Share, Stage, prepare as prepare_share};

use crate::errors::{Fault, Result};
use crate::posed::{on_bad, posed_of};
use crate::waiting::Told;

/// Computes a share of what `Map.build` with the same arguments will need, and keeps it in a folder that it will be found in.
///
/// A share that was not done, or was lost, costs time and nothing else: the build computes what is not there. Stages need what the
/// one before them found, of all shares: `"features"`, then `"first-pairs"`, then `"pairs"`.
///
/// Args:
///     posed, images, names, features, skip_bad, progress: as of `Map.build`.
///     work: the folder; several processes may keep in it at once. It holds keypoints and descriptors of the images.
///     stage: one of the three.
///     share: `(i, n)`: the i-th of n shares, the first being 0.
///
/// Returns:
///     How many images or pairs the share had, and how many all shares have.
///
/// Raises:
///     MapError, ImageError: as `Map.build`; InputError: no such stage or share.
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
    let posed = posed_of(posed)?;
    let stage = match stage {
        "features" => Stage::Features,
        "first-pairs" => Stage::FirstPairs,
        "pairs" => Stage::Pairs,
        other => {
            return Err(Fault::input(format_args!(
                "stage: {other:?} is none; there are features, first-pairs, pairs"
            )));
        }
    };
    let (part, of) = share;
    let share = Share::new(part, of).ok_or_else(|| {
        Fault::input(format_args!("share: ({part}, {of}) is none; the first of n is (0, n)"))
    })?;
    let mut options = BuildOptions::default();
    features.clone_into(&mut options.features);
    Told::new(py, progress)?.run(py, |told| {
        let mut input = Input::new(&posed, &images).on_bad_image(on_bad(skip_bad));
        if let Some(names) = &names {
            input = input.with_names(names);
        }
        let keeping = Keeping::in_folder(&work, &options).map_err(Fault::map)?;
        let done = prepare_share(&input, &keeping, &options, stage, share, told)?;
        keeping.finish().map_err(Fault::map)?;
        Ok((done.done, done.of_all))
    })?
}

/// A pose that an image of the map got in the self-test: step to the true one, rows of the covariance, whether it was trusted,
/// noise in pixels. What one hand says and another one reads; nobody else is to.
pub(crate) type TrialParts = ([f64; 6], [[f64; 6]; 6], bool, f64);

/// One image's: its place in the map, and a pose or none for each scheme.
pub(crate) type ImageParts = (usize, Vec<Option<TrialParts>>);

pub(crate) fn parts_of(image: usize, trials: Vec<Option<Trial>>) -> ImageParts {
    let parts = |trial: Trial| (trial.step, trial.covariance, trial.trusted, trial.noise_px);
    (image, trials.into_iter().map(|trial| trial.map(parts)).collect())
}

pub(crate) fn trials_of(parts: Vec<Option<TrialParts>>) -> Vec<Option<Trial>> {
    let trial = |(step, covariance, trusted, noise_px)| Trial { step, covariance, trusted, noise_px };
    parts.into_iter().map(|parts| parts.map(trial)).collect()
}
