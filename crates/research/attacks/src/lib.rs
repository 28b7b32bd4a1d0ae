//! Internal: attacks on obfuscated queries: keypoint recovery and its prior-only baselines.
//!
//! An attacker holds what a device sent ([`Observation`], one per keypoint) and tries to recover the keypoints:
//! - [`closed_form`]: the paper's geometry-recovery attack (Eq. 3, Proposition 1). It uses the observations of each
//!   keypoint's neighbours, which come from an oracle ([`NeighbourLists::nearest`]) or are predicted from
//!   descriptors;
//! - [`graph`](graph()): the layout of the whole neighbour graph with each keypoint on its line. It is far stronger:
//!   with true neighbours its errors on half-lines are one or two pixels where those of [`closed_form`] are hundreds;
//! - [`prior_only`] and [`prior_median`]: the best answers from the single line alone, for bits and for median errors;
//!   [`Density::expected_positions`]: with a density of keypoints learned from other images;
//! - [`NeighbourPredictor`]: neighbours predicted from descriptors alone, without an oracle (networks that predict
//!   neighbours, positions and images are in [`learned`], cargo feature `networks`);
//! - [`transfer`](transfer()): positions and neighbours transferred from map images with similar descriptors;
//! - [`server_side()`], [`iterative`], [`occlusion()`], [`guided_transfer`]: attacks by a server that has found the pose, and so knows
//!   the keypoints that matched its map.
//!
//! Attacks on several queries of one scene are in [`multi_view`].
//!
//! A large recovery error alone does not show privacy: an attack with an error of 300 px is a bad attack if the
//! prior-only baseline has an error of 90 px. So every attack is reported beside the baseline ([`bits_over_prior`]).
//!
//! ```
//! use rand::SeedableRng;
//! use veiloc_attacks::{ClosedFormOptions, ErrorSummary, NeighbourLists, closed_form, errors_px, lift, prior_only};
//! # let keypoints: Vec<_> = (0..400).map(|i| {
//! #     veiloc_geometry::Pixel::new(f64::from(i % 20) * 32.0 + 9.3, f64::from(i / 20) * 24.0 + 7.1)
//! # }).collect();
//! let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
//! let sent = lift::random_lines(&keypoints, &mut rng);
//! let neighbours = NeighbourLists::nearest(&keypoints, 20);
//! let recovered = closed_form(&sent, &neighbours, 640, 480, &ClosedFormOptions::default())?;
//! let prior = prior_only(&sent, 640, 480);
//! let attack = ErrorSummary::of(&errors_px(recovered.iter().map(|r| r.pixel), &keypoints));
//! let baseline = ErrorSummary::of(&errors_px(prior, &keypoints));
//! assert!(attack.median_px < 0.5 * baseline.median_px);
//! # Ok::<(), veiloc_attacks::AttackError>(())
//! ```
#![forbid(unsafe_code)]

mod density;
mod error;
mod features;
mod geometry_recovery;
mod graph;
#[cfg(feature = "networks")]
pub mod image_metrics;
#[cfg(feature = "networks")]
pub mod learned;
pub mod lift;
mod metrics;
pub mod multi_view;
mod neighbours;
mod observation;
mod predictor;
mod prior;
mod ranking;
mod server_side;
mod tracks;
mod transfer;

pub use density::{Density, KeypointHistogram};
pub use error::AttackError;
pub use features::{DecodedDescriptors, KnownImage};
pub use geometry_recovery::{
    AnswerRegion, ClosedFormOptions, NeighbourExtent, RecoveredKeypoint, closed_form,
};
pub use graph::{GraphAnswer, GraphOptions, graph};
pub use metrics::{ErrorSummary, bits_over_prior, errors_px};
pub use neighbours::NeighbourLists;
pub use observation::{Observation, PencilRow};
pub use predictor::NeighbourPredictor;
pub use prior::{KnownSegment, expected_positions, prior_median, prior_only};
pub use ranking::likeliest_pairs;
pub use server_side::{
    GuidedEstimate, GuidedOptions, LineNeighbours, MapVisibility, OcclusionEstimate, guided_transfer,
    iterative, occlusion, server_side,
};
pub use tracks::mutual_matches;
pub use transfer::{TransferredPositions, transfer};
