//! Internal: localization, from a sealed query and a map to a camera pose: the main task of the server.
//!
//! Three stages: [`retrieval`] selects map images that look like the query, [`matching`] matches the query's
//! descriptors with the map points of those images, and the robust estimator of `veiloc-pose` estimates the pose from
//! lines instead of points.
//!
//! **Invariant, tested by `cargo xtask tidy`:** this crate depends neither on `veiloc-features` nor on
//! `veiloc-obfuscation`. It cannot name a keypoint of a query, because a query contains none.
//!
//! [`localize`] is the entry point: from an opened map (`veiloc_map::MapFile`), a decoded query and
//! [`LocalizeOptions`] to a [`Localization`], with counts and a confidence. `tests/it/synthetic.rs` tests the whole
//! pipeline. [`match_query`] is its first half, up to the input of the estimator. [`localize_rig`] localizes the
//! queries of a session with their relative poses. Callers with their own matches use [`observe_matches`] and
//! `veiloc-pose`.
//!
//! # Example
//! Correspondences keep their row, also if a row gives two lines or has two map points:
//! ```
//! use veiloc_geometry::{Pixel, PixelLine};
//! use veiloc_localization::observe_matches;
//! use veiloc_protocol::Observations;
//!
//! // Coordinate permutation: one of the two lines of each row, horizontal or vertical, goes through the keypoint.
//! let either = |u, v| [0.0, std::f64::consts::FRAC_PI_2].map(|angle| PixelLine::through(Pixel::new(u, v), angle));
//! let query = Observations::EitherLine(vec![either(100.0, 40.0), either(300.0, 200.0)]);
//!
//! // The first row has one match, the second two.
//! let observed = observe_matches(&query, &[0, 1, 1]);
//! assert_eq!(observed.correspondences.len(), 6);
//! assert_eq!(observed.match_of, [0, 0, 1, 1, 2, 2]);
//! assert_eq!(observed.keypoints, [0, 0, 1, 1, 1, 1]);
//! ```
#![forbid(unsafe_code)]

mod answer;
mod calibrated;
mod correspondences;
mod error;
mod localizer;
pub mod matching;
pub mod retrieval;
mod rig;

pub use answer::answer_doubts;
pub use correspondences::{MatchedObservations, observe_matches};
pub use error::LocalizeError;
pub use localizer::{
    Localization, LocalizeOptions, MatchResult, MatchedPair, MatchedQuery, StageTimes, localize,
    localize_matched, match_in, match_query,
};
pub use rig::{FrameLocalization, RigLocalization, localize_rig};
