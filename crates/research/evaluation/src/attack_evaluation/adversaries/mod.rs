//! `veiloc eval adversaries`: the gain of each adversary from the queries of every scheme, with its best attack.
//!
//! Adversaries differ in their knowledge beside a query ([`Adversary`]), not in their algorithm: each runs all
//! attacks of `veiloc attack` that this knowledge allows.

mod adversary;
mod document;
mod gains;
mod keypoints;
mod options;
mod table;

use veiloc_features::Progress;

use crate::EvalError;
use keypoints::AttackedKeypoints;

pub use adversary::Adversary;
pub use document::{AdversariesDocument, AdversaryRow, AttackGain};
pub use options::AdversariesEvaluation;
pub use table::adversaries_table;

/// Attacks queries of a scene, or images of files without a map, as every adversary whose resources are available.
///
/// # Errors
/// [`EvalError`] when data is missing, a map cannot be built, or the options select nothing.
pub fn evaluate_adversaries(
    evaluation: &AdversariesEvaluation,
    progress: &dyn Progress,
) -> Result<AdversariesDocument, EvalError> {
    evaluation.check()?;
    let mut sets = Vec::new();
    if let Some(scene) = &evaluation.scene {
        sets.push(AttackedKeypoints::of_scene(scene, evaluation.attacked, progress)?);
    }
    for file in &evaluation.attack.files {
        sets.push(AttackedKeypoints::of_file(file, evaluation.attacked)?);
    }
    let mut rows: Vec<AdversaryRow> = Vec::new();
    for keypoints in &sets {
        for &adversary in &evaluation.adversaries {
            rows.extend(gains::gains(evaluation, keypoints, adversary, progress)?);
        }
    }
    progress.finish();
    let has_row = |a: &&Adversary| rows.iter().any(|row| row.adversary == a.name());
    let missing = evaluation.adversaries.iter().filter(|a| !has_row(a)).copied().collect();
    let (k, seed) = (evaluation.attack.k, evaluation.attack.seed);
    Ok(AdversariesDocument { version: 1, command: "eval adversaries", k, seed, missing, rows })
}
