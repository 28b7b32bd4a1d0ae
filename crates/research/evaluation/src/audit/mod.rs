//! What sealed queries leak: attacks on every scheme, each beside the guess, and what they found, in words and figures.
//!
//! - [`evaluate_attacks`] runs attacks (the table [`ATTACKS`]) on files of keypoints; [`AttackDocument`] is what they found.
//! - [`run_audit`] does so for an audit: with everything a page draws, and conclusions in sentences.
//! - [`training`]: the networks of an outsider who learns.
//!
//! Nothing here is for devices or servers: it knows the truth, to judge attacks by.
#![forbid(unsafe_code)]

mod attacks;
mod attempt;
mod document;
mod findings;
mod gate;
mod neighbours;
mod observer;
mod options;
mod outsider;
mod private;
mod rows;
mod run;
mod server;
mod sightings;
pub mod training;
mod view;

pub use attacks::{ATTACKS, Attack, Needs, UnknownAttack};
pub use attempt::{Answers, Attempt};
pub use document::{AttackDocument, AttackSummary, ServerSummary, attacks_table};
pub use findings::{
    Audit, AuditDocument, AuditOptions, AuditPart, Gallery, Part, Sentence, Shown, ShownAttack, ShownScheme,
    Spread, base_share, capital, conclusion, count, findings, needs, percent, px, run_audit, scheme_words,
};
pub use neighbours::{NeighbourSource, Neighbours};
pub use observer::{AttackObserver, AttackTrial, ImageGroup, Stage};
pub use options::{AttackEvaluation, Measured, ServerKnowledge};
pub use outsider::TrainedPositions;
pub use private::person;
pub use run::{attack_groups, evaluate_attacks};
pub use sightings::FrameChoice;
