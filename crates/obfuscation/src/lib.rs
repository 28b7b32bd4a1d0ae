//! The only door from keypoint to line: obfuscation schemes and sealing.
//!
//! Of all rooms only this one sees both a keypoint's position and the line that is sent instead. It runs on the
//! device. [`seal`] is the door; everything it may not let through is listed with its test in `docs/privacy.md`.
//!
//! ```no_run
//! # fn f(features: veiloc_features::Features, profile: veiloc_query::Profile) -> Result<(), Box<dyn std::error::Error>> {
//! let camera = "SIMPLE_RADIAL,640,480,525,320,240,-0.01".parse()?;
//! let sealed = veiloc_obfuscation::seal(features, &camera, &profile, &mut veiloc_obfuscation::device_rng()?)?;
//! let bytes = sealed.encode(); // send these; send the same bytes again when the network fails
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

pub mod audit;
mod decoy;
mod error;
mod extract;
mod lift;
mod rng;
mod seal;

#[doc(inline)]
pub use audit::{SealTruth, obfuscate_points, seal_with_truth};
pub use error::SealError;
pub use extract::{ExtractError, extract};
pub use rng::device_rng;
pub use seal::{seal, seal_at_most};
