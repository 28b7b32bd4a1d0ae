//! What sealed queries leak: attacks on every scheme, each beside the prior-only baseline.
//!
//! - [`evaluate_attacks`] runs attacks (the table [`ATTACKS`]) on keypoint files; [`AttackDocument`] holds the
//!   results.
//! - [`run_audit`] adds the strongest attack on each scheme, and the positions that a report draws.
//! - [`adversaries`]: the gain of each adversary from the queries of every scheme.
//! - [`sessions`]: leakage of several frames of one scene, by the reference frame of their anchors.
//! - [`inversion`]: images reconstructed from recovered keypoints.
//!
//! This module knows the ground truth and must not run on devices or servers.
#![forbid(unsafe_code)]

pub mod adversaries;
mod angle_gate;
mod attacks;
mod audit;
mod context;
mod document;
mod evaluate;
pub mod inversion;
mod multi_view;
mod neighbours;
mod observer;
mod options;
mod position_networks;
mod private_region;
mod rows;
mod server;
mod server_view;
pub mod sessions;
mod spread;
mod strongest;

pub use attacks::{ATTACKS, Attack, AttackRequirements, UnknownAttack};
pub use audit::{
    Audit, AuditDocument, AuditOptions, AuditPart, PROTECTION, RowErrors, ShownAttack, ShownImage,
    ShownImages, ShownScheme, run_audit,
};
pub use context::{AttackInput, RecoveredPositions};
pub use document::{AttackDocument, AttackSummary, ServerSummary, attacks_table};
pub use evaluate::{attack_groups, evaluate_attacks};
pub use multi_view::FrameChoice;
pub(crate) use neighbours::descriptors;
pub use neighbours::{NeighbourSource, Neighbours};
pub use observer::{AttackObserver, AttackProgress, AttackTrial, ImageGroup};
pub use options::{AttackEvaluation, MeasuredKeypoints, PrivateRegion, ServerKnowledge};
pub use position_networks::TrainedPositions;
pub use private_region::person;
pub use strongest::{StrongestAttacks, strongest_table};
