//! Attacks on one's own images: what somebody who reads a sealed query gets out of it. Never for devices: it knows the truth.
//!
//! [`keypoints_of_image`] extracts what would be sent, [`evaluate_attacks`] runs [`ATTACKS`] (and attacks of one's own, which
//! are values of [`Attack`]) on every scheme, each beside the guess, and [`attacks_table`] prints them.

pub use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_image, keypoints_of_images};
pub use veiloc_evaluation::EvalError;
pub use veiloc_evaluation::audit::{
    ATTACKS, Answers, Attack, AttackDocument, AttackEvaluation, AttackObserver, AttackSummary, Attempt,
    ImageGroup, Needs, NeighbourSource, attack_groups, attacks_table, evaluate_attacks,
};
