//! Sealed query and map to camera pose: the server's main job.
//!
//! Three stages, each in its file: [`retrieval`] picks the map images that look like the query, [`matching`] pairs
//! the query's descriptors with the map points those images see, and the robust estimator of `veiloc-pose` solves
//! for the pose from what the query tells about positions: lines, not points.
//!
//! **Invariant, tested by `cargo xtask tidy`:** this crate depends neither on `veiloc-features` nor on
//! `veiloc-obfuscation`. It cannot name a keypoint of a query, because the query does not hold any.
//!
//! [`localize`] is the door: an opened map (`veiloc_map::MapFile`), a decoded query and [`LocalizeOptions`] in, a
//! [`Localization`] out, which counts rows of the query and says whether to trust it. `tests/synthetic.rs` walks the
//! whole road, map included. [`match_query`] is its first half, up to what the estimator is
//! given. [`localize_rig`] takes the queries of a session with their relative poses. Who has matches of their own begins at [`observe_matches`] and goes on to `veiloc-pose`.
//!
//! # Example
//! Rows keep their identity on the way to the estimator, also where one is sent as two lines or has two map points:
//! ```
//! use veiloc_geometry::{Pixel, PixelLine};
//! use veiloc_localization::observe_matches;
//! use veiloc_protocol::Observations;
//!
//! // Coordinate permutation: of each row's lines, the level one or the upright one runs through the keypoint.
//! let either = |u, v| [0.0, std::f64::consts::FRAC_PI_2].map(|angle| PixelLine::through(Pixel::new(u, v), angle));
//! let query = Observations::EitherLine(vec![either(100.0, 40.0), either(300.0, 200.0)]);
//!
//! // The first row has a match, the second has two.
//! let observed = observe_matches(&query, &[0, 1, 1]);
//! assert_eq!(observed.correspondences.len(), 6);
//! assert_eq!(observed.match_of, [0, 0, 1, 1, 2, 2]);
//! assert_eq!(observed.keypoints, [0, 0, 1, 1, 1, 1]);
//! ```
#![forbid(unsafe_code)]

mod correspondences;
mod error;
mod localizer;
pub mod matching;
pub mod retrieval;
mod rig;
mod verdict;

pub use correspondences::{MatchedObservations, observe_matches};
pub use error::LocalizeError;
pub use localizer::{
    GravityUse, Localization, LocalizeOptions, Matched, MatchedPair, MatchedQuery, StageTimes, localize,
    localize_matched, match_in, match_query,
};
pub use rig::{FrameLocalization, RigLocalization, localize_rig};
