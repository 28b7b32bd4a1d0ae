//! Attacks on obfuscated queries: keypoint recovery and the guesses it must beat.
//!
//! An attacker holds what a device sent ([`Observation`], one per keypoint) and tries to say where the keypoints
//! were. The answers that live here:
//! - [`closed_form`]: the paper's geometry-recovery attack (Eq. 3, Proposition 1). It uses the observations of
//!   each keypoint's neighbours, told by an oracle ([`NeighbourLists::nearest`]) or predicted from descriptors;
//! - [`graph`](graph()): the layout of the whole graph of neighbours with each keypoint on its line. Far stronger:
//!   with true neighbours it recovers half-lines to a pixel or two where [`closed_form`] errs by hundreds;
//! - [`prior_only`]: the best guess that uses no neighbours at all, and [`Density::guess`], the same with a density
//!   of keypoints learned from other images;
//! - [`NeighbourPredictor`]: neighbours predicted from descriptors alone, in place of the oracle's (networks for these,
//!   and for positions and images, are in [`learned`], cargo feature `networks`);
//! - [`transfer`](transfer()): positions and neighbours taken over from map images with similar descriptors;
//! - [`server_side()`], [`iterative`], [`guided_transfer`]: what a server can do that has found the pose, and so
//!   knows the keypoints that matched its map.
//!
//! Several queries of one place put together are attacked in the crate `veiloc_attacks::multi_view`.
//!
//! A large recovery error alone is not privacy: an attack that errs by 300 px where guessing errs by 90 px has only
//! shown that it is a bad attack. So an attack is always reported beside the guess ([`bits_over_prior`]).
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
//! let guessed = prior_only(&sent, 640, 480);
//! let attack = ErrorSummary::of(&errors_px(recovered.iter().map(|r| r.pixel), &keypoints));
//! let guess = ErrorSummary::of(&errors_px(guessed, &keypoints));
//! assert!(attack.median_px < 0.5 * guess.median_px);
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

pub use density::{Density, PlaceCounts};
pub use error::AttackError;
pub use features::{Descriptors, KnownImage};
pub use geometry_recovery::{ClosedFormOptions, Extent, Reach, Recovered, closed_form};
pub use graph::{GraphAnswer, GraphOptions, graph};
pub use metrics::{ErrorSummary, bits_over_prior, errors_px};
pub use neighbours::NeighbourLists;
pub use observation::{Observation, PencilRow};
pub use predictor::NeighbourPredictor;
pub use prior::{KnownSegment, prior_only};
pub use ranking::likeliest_pairs;
pub use server_side::{Guided, GuidedOptions, LineNeighbours, guided_transfer, iterative, server_side};
pub use tracks::mutual_matches;
pub use transfer::{Transfer, transfer};
