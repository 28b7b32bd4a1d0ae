//! What networks over sets of keypoints are made of, beside the layers of `veiloc_attacks::training`: attention and its softmax,
//! dropout, with their derivatives by hand, on the CPU, in `f32`.
//!
//! A keypoint is a **column** of a matrix. Nothing here draws numbers but [`dropout`], from a generator that is passed in; no
//! sum depends on the number of threads.

pub(crate) mod attention;
pub(crate) mod dropout;
pub(crate) mod encoder;
pub(crate) mod exponential;

pub(crate) use crate::training::Matrix;
