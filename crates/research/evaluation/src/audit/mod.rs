//! What sealed queries leak: attacks on every scheme, each beside the prior-only baseline.
//!
//! - [`evaluate_attacks`] runs attacks (the table [`ATTACKS`]) on keypoint files; [`AttackDocument`] holds the
//!   results.
//! - [`run_audit`] adds the strongest attack on each scheme, and the positions that a report draws.
//!
//! This module knows the ground truth and must not run on devices or servers.
#![forbid(unsafe_code)]

mod angle_gate;
mod attacks;
mod attempt;
mod document;
mod gallery;
mod image_audit;
mod learned_attacks;
mod multi_view;
mod neighbours;
mod observer;
mod options;
mod private_region;
mod protection;
mod rows;
mod run;
mod server;
mod server_view;
mod strongest;

pub use attacks::{ATTACKS, Attack, AttackRequirements, UnknownAttack};
pub use attempt::{AttackInput, RecoveredPositions};
pub use document::{AttackDocument, AttackSummary, ServerSummary, attacks_table};
pub use gallery::{RowErrors, ShownAttack, ShownImage, ShownImages, ShownScheme};
pub use image_audit::{Audit, AuditDocument, AuditOptions, AuditPart, run_audit};
pub use learned_attacks::TrainedPositions;
pub use multi_view::FrameChoice;
pub(crate) use neighbours::descriptors;
pub use neighbours::{NeighbourSource, Neighbours};
pub use observer::{AttackObserver, AttackProgress, AttackTrial, ImageGroup};
pub use options::{AttackEvaluation, MeasuredKeypoints, PrivateRegion, ServerKnowledge};
pub use private_region::person;
pub use protection::PROTECTION;
pub use run::{attack_groups, evaluate_attacks};
pub use strongest::{StrongestAttacks, strongest_table};
