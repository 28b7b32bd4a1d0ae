//! Attacks on the user's own images: what an attacker recovers from a sealed query. Not for devices: it knows the
//! ground truth.
//!
//! [`keypoints_of_image`] extracts the keypoints of a query, [`evaluate_attacks`] runs [`ATTACKS`] (and the caller's
//! own attacks, which are values of [`Attack`]) on every scheme, each beside the prior-only baseline, and
//! [`attacks_table`] prints the results.

pub use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_image, keypoints_of_images};
pub use veiloc_evaluation::EvalError;
pub use veiloc_evaluation::attack_evaluation::{
    ATTACKS, Attack, AttackContext, AttackDocument, AttackEvaluation, AttackSummary, AttackTrial, ImageGroup,
    Knowledge, NeighbourSource, RecoveredPositions, attacks_table, evaluate_attacks,
};
