//! Attacks on one's own images: what would leak. Never for devices: it knows the truth.

use std::path::PathBuf;

use pyo3::prelude::*;
use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_images};
use veiloc_evaluation::audit::{
    ATTACKS, Attack, AttackEvaluation, AttackObserver, AuditOptions, ImageGroup, Stage, attack_groups,
    run_audit,
};
use veiloc_features::{Extractors, Progress};
use veiloc_protocol::{ExtractionLimits, Scheme};

use crate::errors::{Fault, Result};
use crate::waiting::Told;

/// Names of all attacks, weakest first.
#[pyfunction]
pub(crate) fn attack_names() -> Vec<&'static str> {
    ATTACKS.map(|attack| attack.name).to_vec()
}

struct Watched<'a>(Stage<'a>);

impl AttackObserver for Watched<'_> {
    fn advance(&mut self, _done: usize, total: usize) {
        self.0.advance(total);
    }
}

/// What is attacked, and how.
fn evaluation(
    attacks: Option<Vec<String>>,
    schemes: Option<Vec<String>>,
    seed: u64,
) -> Result<AttackEvaluation> {
    let mut evaluation = AttackEvaluation { seed, ..AttackEvaluation::default() };
    if let Some(names) = attacks {
        evaluation.attacks =
            names.iter().map(|name| name.parse::<Attack>().map_err(Fault::input)).collect::<Result<_>>()?;
    }
    if let Some(names) = schemes {
        evaluation.schemes = names.iter().map(|name| Ok(name.parse::<Scheme>()?)).collect::<Result<_>>()?;
    }
    Ok(evaluation)
}

fn keypoints(
    images: &[PathBuf],
    features: &str,
    most: u32,
    side: u32,
    told: &Told,
) -> Result<Vec<KeypointImage>> {
    let extractors = Extractors::default();
    let limits = ExtractionLimits { max_keypoints: most, max_image_side: side };
    let found = keypoints_of_images(images, extractors.named(features)?, limits, told)?;
    Ok(found)
}

/// A document as Python's own dictionaries and lists.
fn document(py: Python<'_>, text: serde_json::Result<String>) -> Result<Bound<'_, PyAny>> {
    Ok(py.import("json")?.call_method1("loads", (text.map_err(Fault::other)?,))?)
}

/// Attacks what would be sent of images, scheme by scheme: how near each attack comes to the true keypoints.
///
/// Args:
///     images: paths.
///     attacks: names of `attack_names()`. Default: the paper's.
///     schemes: which. Default: all.
///     features, max_keypoints, max_image_side: as of `extract`.
///     seed: of obfuscation and starts.
///     progress: a callable of (stage, done, total).
///
/// Returns:
///     The document of `veiloc attack --json`.
///
/// Raises:
///     ImageError, InputError, Error: images, names, or attacks that need more than images.
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
    let evaluation = evaluation(attacks, schemes, seed)?;
    let text = Told::new(py, progress)?.run(py, |told| -> Result<_> {
        let images = keypoints(&images, features, max_keypoints, max_image_side, told)?;
        let group = ImageGroup { name: "images".to_owned(), images };
        let mut watched = Watched(Stage::new(told, "Attacking"));
        let found = attack_groups(&evaluation, vec![group], &mut watched).map_err(Fault::other)?;
        told.finish();
        Ok(serde_json::to_string(&found))
    })??;
    document(py, text)
}

/// Attacks what would be sent of images, and finds the strongest attack on each scheme.
///
/// Args:
///     images, attacks, schemes, features, max_keypoints, max_image_side, seed, progress: as of `attack`; the default attacks
///         are the paper's.
///     synthetic: keypoints of the paper's synthetic scene, 0 for none.
///
/// Returns:
///     The document of `veiloc audit --json`; `strongest` of a part has the strongest attacks.
///
/// Raises:
///     As `attack`.
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
    let evaluation = AttackEvaluation { synthetic, ..evaluation(attacks, schemes, seed)? };
    let text = Told::new(py, progress)?.run(py, |told| -> Result<_> {
        let mut groups = Vec::new();
        if !images.is_empty() {
            let images = keypoints(&images, features, max_keypoints, max_image_side, told)?;
            groups.push(ImageGroup { name: "images".to_owned(), images });
        }
        let options = AuditOptions { evaluation, groups, shown: 0, command: "veiloc.audit".to_owned() };
        let found = run_audit(&options, &|_, _| None, told).map_err(Fault::other)?;
        Ok(serde_json::to_string(&found.document))
    })??;
    document(py, text)
}
