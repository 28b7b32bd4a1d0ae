//! Attacks on the caller's own images, to measure what their queries leak. Not for devices: attacks need the true
//! keypoints.

use std::path::PathBuf;

use pyo3::prelude::*;
use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_images};
use veiloc_evaluation::attack_evaluation::{
    ATTACKS, Attack, AttackEvaluation, AuditOptions, ImageGroup, evaluate_attacks, run_audit,
};
use veiloc_features::Extractors;
use veiloc_protocol::{ExtractionLimits, Scheme};

use crate::blocking::ProgressCallback;
use crate::errors::{BindingError, Result};

/// Names of all attacks, weakest first.
#[pyfunction]
pub(crate) fn attack_names() -> Vec<&'static str> {
    ATTACKS.map(|attack| attack.name).to_vec()
}

/// The attacks and schemes of one evaluation.
fn evaluation(
    attacks: Option<Vec<String>>,
    schemes: Option<Vec<String>>,
    seed: u64,
) -> Result<AttackEvaluation> {
    let mut evaluation = AttackEvaluation { seed, ..AttackEvaluation::default() };
    if let Some(names) = attacks {
        evaluation.attacks = names
            .iter()
            .map(|name| name.parse::<Attack>().map_err(BindingError::input))
            .collect::<Result<_>>()?;
    }
    if let Some(names) = schemes {
        evaluation.schemes = names.iter().map(|name| Ok(name.parse::<Scheme>()?)).collect::<Result<_>>()?;
    }
    Ok(evaluation)
}

fn keypoints(
    images: &[PathBuf],
    features: &str,
    max_keypoints: u32,
    max_image_side: u32,
    progress: &ProgressCallback,
) -> Result<Vec<KeypointImage>> {
    let extractors = Extractors::for_sealing();
    let limits = ExtractionLimits { max_keypoints, max_image_side };
    let found = keypoints_of_images(images, extractors.named(features)?, limits, progress)?;
    Ok(found)
}

/// A JSON document as Python dictionaries and lists.
pub(crate) fn json_to_python(py: Python<'_>, text: serde_json::Result<String>) -> Result<Bound<'_, PyAny>> {
    Ok(py.import("json")?.call_method1("loads", (text.map_err(BindingError::other)?,))?)
}

/// Attacks the queries of the given images under each scheme, and measures the distance to the true keypoints.
///
/// Args:
///     images: paths.
///     attacks: names from `attack_names()`. Default: the attacks of the paper.
///     schemes: obfuscation schemes. Default: all.
///     features, max_keypoints, max_image_side: as for `extract`.
///     seed: for the obfuscation and the attacks' starting points.
///     progress: a callable of (stage, done, total).
///
/// Returns:
///     The report of `veiloc attack --json`.
///
/// Raises:
///     ImageError: an image cannot be used.
///     InputError: an unknown attack or scheme.
///     Error: an attack needs more than images.
#[pyfunction]
#[pyo3(signature = (images, *, attacks=None, schemes=None, features="compact", max_keypoints=2048, max_image_side=1600, seed=0, progress=None))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub(crate) fn attack<'py>(
    py: Python<'py>,
    images: Vec<PathBuf>,
    attacks: Option<Vec<String>>,
    schemes: Option<Vec<String>>,
    features: &str,
    max_keypoints: u32,
    max_image_side: u32,
    seed: u64,
    progress: Option<Py<PyAny>>,
) -> Result<Bound<'py, PyAny>> {
    let mut evaluation = evaluation(attacks, schemes, seed)?;
    let text = ProgressCallback::new(py, progress)?.run(py, |progress| -> Result<_> {
        let images = keypoints(&images, features, max_keypoints, max_image_side, progress)?;
        evaluation.groups.push(ImageGroup { name: "images".to_owned(), images });
        let found =
            evaluate_attacks(&evaluation, "Attacking", progress, &mut |_| {}).map_err(BindingError::other)?;
        Ok(serde_json::to_string(&found))
    })??;
    json_to_python(py, text)
}

/// Attacks the queries of the given images, and finds the strongest attack on each scheme.
///
/// Args:
///     images, attacks, schemes, features, max_keypoints, max_image_side, seed, progress: as for `attack`.
///     synthetic: number of keypoints of the paper's synthetic scene, 0 for none.
///
/// Returns:
///     The report of `veiloc audit --json`; each part lists its strongest attacks under `strongest`.
///
/// Raises:
///     ImageError, InputError, Error: as for `attack`.
#[pyfunction]
#[pyo3(signature = (images, *, attacks=None, schemes=None, features="compact", max_keypoints=2048, max_image_side=1600, seed=0, synthetic=0, progress=None))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub(crate) fn audit<'py>(
    py: Python<'py>,
    images: Vec<PathBuf>,
    attacks: Option<Vec<String>>,
    schemes: Option<Vec<String>>,
    features: &str,
    max_keypoints: u32,
    max_image_side: u32,
    seed: u64,
    synthetic: usize,
    progress: Option<Py<PyAny>>,
) -> Result<Bound<'py, PyAny>> {
    let mut evaluation = AttackEvaluation { synthetic, ..evaluation(attacks, schemes, seed)? };
    let text = ProgressCallback::new(py, progress)?.run(py, |progress| -> Result<_> {
        if !images.is_empty() {
            let images = keypoints(&images, features, max_keypoints, max_image_side, progress)?;
            evaluation.groups.push(ImageGroup { name: "images".to_owned(), images });
        }
        let options = AuditOptions { evaluation, shown: 0, command: "veiloc.audit".to_owned() };
        let found = run_audit(&options, &|_, _| None, progress).map_err(BindingError::other)?;
        Ok(serde_json::to_string(&found.document))
    })??;
    json_to_python(py, text)
}
