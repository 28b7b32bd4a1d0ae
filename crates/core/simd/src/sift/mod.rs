//! The loops of SIFT: blur, peaks of differences, gradients and their histograms, in single precision.
//!
//! - [`blur_down`], [`blur_along`], [`double_row`]: rows of the scale space.
//! - [`differences`], [`peaks`]: peaks of its differences.
//! - [`Patches`]: the directions of the gradients around a keypoint, and its descriptor.
//! - [`exp2`]: a power of two.
//!
//! As in [`crate::pose`], the loops are plain Rust compiled once for each [`crate::Backend`]: multiplications and
//! additions are never fused, sums have a fixed order, and polynomials replace the functions of a mathematical library.
//! Every backend and every machine gives the same bits.

mod blur;
mod grid;
mod lanes;
mod patch;
mod peaks;

pub use crate::approx::exp2;
pub use blur::{Doubling, HalfKernel, MAX_RADIUS, blur_along, blur_down, double_row};
pub use grid::BlurredImage;
pub use lanes::LANES;
pub use patch::{BINS, DESCRIPTOR, PATCH_RADIUS, PatchMemory, Patches};
pub use peaks::{differences, peaks};
