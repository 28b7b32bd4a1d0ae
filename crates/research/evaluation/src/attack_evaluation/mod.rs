//! What sealed queries leak: attacks on every scheme, each beside the prior-only baseline.
//!
//! - [`evaluate_attacks`] runs attacks (the table [`ATTACKS`]) on images, scheme by scheme; each takes what it needs
//!   from an [`AttackContext`]. [`AttackDocument`] holds the results.
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
mod inliers;
pub mod inversion;
mod multi_view;
mod names;
mod neighbours;
mod options;
mod position_networks;
mod private_region;
mod rows;
mod scene;
mod server;
pub mod sessions;
mod spread;
mod strongest;
mod with_pack;

pub use attacks::{ATTACKS, Attack, Knowledge};
pub use audit::{
    Audit, AuditDocument, AuditOptions, AuditPart, PROTECTION, ShownAttack, ShownImage, ShownImages,
    ShownScheme, run_audit,
};
pub use context::{AttackContext, RecoveredPositions};
pub use document::{AttackDocument, AttackSummary, ServerSummary, WithPack, attacks_table};
pub use evaluate::{AttackTrial, evaluate_attacks};
pub use multi_view::FrameChoice;
pub use names::UnknownName;
pub use neighbours::{NeighbourSource, Neighbours};
pub use options::{AttackEvaluation, ImageGroup, MeasuredKeypoints, PrivateRegion, ServerKnowledge};
pub use strongest::{StrongestAttacks, strongest_table};
