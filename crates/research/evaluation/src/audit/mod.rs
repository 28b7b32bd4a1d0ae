//! What sealed queries leak: attacks on every scheme, each beside the prior-only baseline.
//!
//! - [`evaluate_attacks`] runs attacks (the table [`ATTACKS`]) on keypoint files; [`AttackDocument`] holds the
//!   results.
//! - [`run_audit`] adds the strongest attack on each scheme, and the positions that a report draws.
//!
//! This module knows the ground truth and must not run on devices or servers.
#![forbid(unsafe_code)]

mod attacks;
mod attempt;
mod document;
mod gallery;
mod gate;
mod image_audit;
mod neighbours;
mod observer;
mod options;
mod outsider;
mod private;
mod rows;
mod run;
mod server;
mod sightings;
mod strongest;
mod view;

pub use attacks::{ATTACKS, Attack, Needs, UnknownAttack};
pub use attempt::{Answers, Attempt};
pub use document::{AttackDocument, AttackSummary, ServerSummary, attacks_table};
pub use gallery::{Gallery, RowErrors, ShownAttack, ShownImage, ShownScheme};
pub use image_audit::{Audit, AuditDocument, AuditOptions, AuditPart, run_audit};
pub(crate) use neighbours::descriptors;
pub use neighbours::{NeighbourSource, Neighbours};
pub use observer::{AttackObserver, AttackTrial, ImageGroup, Stage};
pub use options::{AttackEvaluation, Measured, ServerKnowledge};
pub use outsider::TrainedPositions;
pub use private::person;
pub use run::{attack_groups, evaluate_attacks};
pub use sightings::FrameChoice;
pub use strongest::{StrongestAttacks, strongest_table};
