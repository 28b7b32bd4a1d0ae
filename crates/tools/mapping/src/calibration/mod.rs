//! A map localizes its own images, and learns how far to believe itself.
//!
//! ```text
//! each of up to 50 images ── left out of the map ── sealed from what the map keeps of it ── localized ── its error
//!                                                                        │
//!                      recall, medians, coverage, noise, calibration ◀───┘  of all of them, a scheme
//! ```
//! For whoever builds maps: [`self_test`] takes a map and returns a [`SelfTest`] that belongs into
//! [`MapModel::self_test`](veiloc_map::MapModel::self_test); the server's side reads it there and needs nothing of this crate, which knows both
//! sides.
//!
//! # What is left out
//! The image is not retrieved or matched, and the points it sees are triangulated again without it, or dropped
//! ([`crate::LeaveOut`]). It keeps its share in the words of the vocabulary, and in which keypoints of the
//! others were joined.
//!
//! # What the query is
//! The keypoints and descriptors that the map keeps of the image, sealed as a device seals: canonical camera, dither,
//! quantized, as many as the profile asks for; it is matched once for all schemes, whose rows hold the same descriptors. They
//! were extracted from the image as the map's settings say, so no image
//! is read again.
//!
//! # What it cannot know
//! The poses it compares with are those the map was built with. An error that they share (a wrong scale, a wrong common
//! focal length) shows neither in its errors nor in its coverage.
#![forbid(unsafe_code)]
#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "comparisons are written so that NaN fails")]

mod compressed;
mod fit;
#[cfg(test)]
mod fit_tests;
mod minimum;
mod query;
mod run;
mod summary;
mod trial;

pub use compressed::{self_test_compressed, smallest_within};
pub use fit::fit;
pub use run::{SelfTestOptions, chosen, is_testable, self_test, test_of, trials};
pub use trial::Trial;
pub use veiloc_map::{Calibration, SelfTest};
