//! Sealed query and map to camera pose: the server's main job.
//!
//! Three stages, each in its file: [`retrieval`] picks the map images that look like the query, [`matching`] pairs
//! the query's descriptors with the map points those images see, and the robust estimator of `veiloc-robust` solves
//! for the pose from what the query tells about positions: lines, not points.
//!
//! **Invariant, tested by `cargo xtask tidy`:** this crate depends neither on `veiloc-features` nor on
//! `veiloc-obfuscation`. It cannot name a keypoint of a query, because the query does not hold any.
#![forbid(unsafe_code)]

mod correspondences;
mod error;
mod localizer;
pub mod matching;
pub mod retrieval;

pub use correspondences::{MatchedObservations, observe_matches};
pub use error::LocalizeError;
pub use localizer::{Localization, LocalizeOptions, StageTimes, localize};
