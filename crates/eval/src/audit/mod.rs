//! `veiloc attack`: every attack on every scheme, each beside the guess that uses no neighbours.

mod answer;
mod document;
mod extract;
mod keypoints;
mod kind;
mod neighbours;
mod observer;
mod private;
mod rows;
mod run;
mod server;
mod sightings;
#[cfg(feature = "network")]
pub mod training;

pub use document::{AttackDocument, AttackSummary, ServerSummary, attacks_table};
pub use extract::{images_in, keypoints_of_image, keypoints_of_images};
pub use keypoints::{KeypointImage, encode_keypoints, read_keypoints, synthetic_image};
pub use kind::{AttackKind, AttackKindError};
pub use neighbours::NeighbourSource;
pub use observer::{AttackObserver, AttackTrial, ImageGroup};
pub use run::{AttackEvaluation, attack_groups, evaluate_attacks};
pub use server::{Measured, ServerKnowledge};
