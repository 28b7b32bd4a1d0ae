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
pub use extract::{keypoints_of_photograph, keypoints_of_photographs, photographs};
pub use keypoints::{KeypointPicture, encode_keypoints, read_keypoints, synthetic_picture};
pub use kind::{AttackKind, AttackKindError};
pub use neighbours::NeighbourSource;
pub use observer::{AttackObserver, AttackTrial, PictureGroup};
pub use run::{AttackEvaluation, attack_groups, evaluate_attacks};
pub use server::{Measured, ServerKnowledge};
