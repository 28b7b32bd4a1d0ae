//! Reads options of the pose estimation from dictionaries: PoseLib's names where the meaning is the same, and our own.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use veiloc_pose::{PoseOptions, ScoreKind};

use crate::errors::{BindingError, Result};

/// Names of the options, for messages.
const RANSAC: &str = "max_iterations, min_iterations, success_prob, seed; score (\"likelihood\" or \"msac\"), \
                      max_reproj_error (with \"msac\"), noise_px (with \"likelihood\"), anchored_solver, \
                      expected_inlier_ratio, fixed_iterations, min_inliers";
const BUNDLE: &str = "estimate_noise";

/// Options of PoseLib that do not exist here, with their replacement.
const OTHERS: [(&str, &str); 9] = [
    ("dyn_num_trials_mult", "success_prob alone ends the sampling"),
    ("progressive_sampling", "the prior of each correspondence guides the sampling: give prior="),
    ("max_prosac_iterations", "the prior of each correspondence guides the sampling: give prior="),
    ("max_epipolar_error", "only absolute poses are estimated"),
    ("real_focal_check", "only absolute poses are estimated"),
    ("loss_type", "the loss is the likelihood's own; score=\"msac\" truncates"),
    ("loss_scale", "the scale is the noise: give noise_px"),
    ("max_errors", "give max_reproj_error with score=\"msac\", or noise_px"),
    ("verbose", "nothing is printed"),
];

/// Options of the estimation, and the seed of its random generator.
pub(crate) fn pose_options(
    ransac: Option<&Bound<'_, PyDict>>,
    bundle: Option<&Bound<'_, PyDict>>,
) -> Result<(PoseOptions, u64)> {
    let (mut options, mut seed) = (PoseOptions::default(), 0);
    let (mut threshold, mut noise) = (false, false);
    for (name, value) in entries(ransac)? {
        let o = &mut options;
        match name.as_str() {
            "max_iterations" => o.max_hypotheses = read(&name, &value)?,
            "min_iterations" => o.min_hypotheses = read(&name, &value)?,
            "fixed_iterations" => o.fixed_hypotheses = read(&name, &value)?,
            "success_prob" => o.confidence = read(&name, &value)?,
            "seed" => seed = read(&name, &value)?,
            "score" => o.score = Some(text(&value)?),
            "anchored_solver" => o.anchored_solver = Some(text(&value)?),
            "expected_inlier_ratio" => o.expected_inlier_ratio = read(&name, &value)?,
            "min_inliers" => o.min_inliers = read(&name, &value)?,
            "max_reproj_error" => (threshold, o.max_error_px) = (true, read(&name, &value)?),
            "noise_px" => (noise, o.noise_px) = (true, read(&name, &value)?),
            _ => return Err(unknown("ransac_opt", &name, RANSAC)),
        }
    }
    for (name, value) in entries(bundle)? {
        match name.as_str() {
            "estimate_noise" => options.estimate_noise = read(&name, &value)?,
            _ => return Err(unknown("bundle_opt", &name, BUNDLE)),
        }
    }
    let score = options.score.unwrap_or_default();
    if threshold && score != ScoreKind::Msac {
        return Err(BindingError::input(
            "max_reproj_error is the threshold of score=\"msac\", but the score is \"likelihood\", which has a scale instead: give \
             noise_px, the standard deviation of a keypoint (default 2)",
        ));
    }
    if noise && score == ScoreKind::Msac {
        return Err(BindingError::input(
            "noise_px is the scale of score=\"likelihood\"; score=\"msac\" has a threshold instead: give max_reproj_error",
        ));
    }
    Ok((options, seed))
}

fn entries<'py>(options: Option<&Bound<'py, PyDict>>) -> Result<Vec<(String, Bound<'py, PyAny>)>> {
    let entry =
        |(name, value): (Bound<'py, PyAny>, Bound<'py, PyAny>)| Ok((name.extract::<String>()?, value));
    options.map_or(Ok(Vec::new()), |options| options.iter().map(entry).collect())
}

fn read<T: for<'a, 'py> FromPyObject<'a, 'py>>(name: &str, value: &Bound<'_, PyAny>) -> Result<T> {
    value
        .extract::<T>()
        .map_err(|_| BindingError::input(format_args!("{name}: {value} is not a valid value")))
}

fn text<T: std::str::FromStr<Err: std::fmt::Display>>(value: &Bound<'_, PyAny>) -> Result<T> {
    let text = value
        .extract::<String>()
        .map_err(|_| BindingError::input(format_args!("{value} is not a string")))?;
    text.parse().map_err(BindingError::input)
}

fn unknown(of: &str, name: &str, known: &str) -> BindingError {
    let why = OTHERS.iter().find(|(other, _)| *other == name);
    let why = why.map_or_else(String::new, |(_, why)| format!(" ({why})"));
    BindingError::input(format_args!("{of}: unknown option {name:?}{why}; the options are {known}"))
}
