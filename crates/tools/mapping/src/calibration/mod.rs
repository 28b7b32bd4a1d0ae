//! Self-test of a map on its own images, and calibration of its pose covariances.
//!
//! ```text
//! each of up to 50 images ── left out of the map with its neighbours ── sealed from the stored features ── localized ── its error
//!                                                                        │
//!           recall, medians, coverage, noise, calibration  ◀────────────┘  over all images, per scheme
//! ```
//!
//! [`self_test`] takes a map and returns a [`SelfTest`] that belongs in
//! [`MapModel::self_test`](veiloc_map::MapModel::self_test); the server side reads it there and does not depend on this
//! crate, which uses both the device side and the server side.
//!
//! # What is left out
//! The image and the two images that share most points with it are not retrieved or matched, and the points they
//! observe are triangulated again without them, or dropped ([`crate::HoldOutMap`]). Their share in the words of the
//! vocabulary and in the merging of other images' keypoints remains.
//!
//! # The query
//! The keypoints and descriptors that the map stores of the image, sealed as on a device: canonical camera, dither,
//! quantization, as many as the profile requests. It is matched once for all schemes, whose rows have the same
//! descriptors. The features were extracted with the map's settings, so no image is read again.
//!
//! # Limits
//! The reference poses are those the map was built with. An error that they share (a wrong scale, a wrong common focal
//! length) affects neither the measured errors nor the coverage.
#![forbid(unsafe_code)]
#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "comparisons are written so that NaN fails")]

mod compressed;
mod fit;
#[cfg(test)]
mod fit_tests;
mod minimum;
pub(crate) mod query;
mod radii;
pub(crate) mod run;
mod summary;
mod trial;

pub use compressed::{self_test_compressed, smallest_within};
pub use fit::fit;
pub use run::{SelfTestOptions, chosen, is_testable, self_test, summarize_trials, trials};
pub use trial::SelfTestTrial;
pub use veiloc_map::{CovarianceCalibration, SelfTest};
