//! `veiloc eval adversaries`: the gain of each adversary from the queries of every scheme, with its best attack.
//!
//! Adversaries differ in their knowledge beside a query ([`Adversary`]), not in their algorithm: each runs all
//! attacks of `veiloc attack` that this knowledge allows.

mod adversary;
mod attackers;
mod document;
mod keypoints;
mod options;
mod table;

use crate::EvalError;
pub(crate) use attackers::Attackers;
pub(crate) use keypoints::AttackedKeypoints;
use veiloc_features::Progress;

pub use adversary::{Adversary, UnknownAdversary};
pub use attackers::AttackGain;
pub use document::{AdversariesDocument, AdversaryRow};
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
    for file in &evaluation.files {
        sets.push(AttackedKeypoints::of_file(file, evaluation.attacked)?);
    }
    let mut document = AdversariesDocument::new(evaluation);
    for keypoints in &sets {
        let attackers = Attackers {
            keypoints,
            schemes: &evaluation.schemes,
            train: &evaluation.train,
            network: evaluation.network.as_deref(),
            positions: &evaluation.positions,
            slow_attacks: evaluation.slow_attacks,
            k: evaluation.k,
            seed: evaluation.seed,
        };
        for &adversary in &evaluation.adversaries {
            document.add(&keypoints.data, adversary, attackers.gains(adversary, progress)?, evaluation);
        }
    }
    progress.finish();
    document.list_missing(evaluation);
    Ok(document)
}
