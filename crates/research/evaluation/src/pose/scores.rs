//! Default scores of an evaluation.

use veiloc_pose::ScoreKind;

/// The estimator's default score.
pub(crate) const DEFAULT_SCORE: ScoreKind = ScoreKind::Likelihood;

/// The given scores, or the default.
pub fn scores_or_default(scores: &[ScoreKind]) -> Vec<ScoreKind> {
    if scores.is_empty() { vec![DEFAULT_SCORE] } else { scores.to_vec() }
}
