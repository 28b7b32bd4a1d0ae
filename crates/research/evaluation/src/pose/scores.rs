//! Which scores an evaluation runs when it is told none.

use veiloc_pose::ScoreKind;

/// The score an estimator compares by that is told none.
pub(crate) const DEFAULT_SCORE: ScoreKind = ScoreKind::Likelihood;

/// The scores a scheme is run with: those asked for, or the default.
pub fn scores_or_default(asked: &[ScoreKind]) -> Vec<ScoreKind> {
    if asked.is_empty() { vec![DEFAULT_SCORE] } else { asked.to_vec() }
}
