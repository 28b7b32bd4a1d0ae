//! What all networks here are made of: layers with their derivatives by hand, on the CPU, in `f32`.
//!
//! A keypoint is a **column** of a matrix. All numbers of a network stand in one list, in the order of its layers; a
//! layer knows where its own begin ([`layers`]), and derivatives stand in a list of the same order. So an optimizer,
//! a file and a checkpoint are about lists of numbers and nothing else.
//!
//! Nothing here draws numbers but [`layers::draw`] and [`dropout`], from a generator that is passed in; no sum depends
//! on the number of threads.

pub(crate) mod attention;
pub(crate) mod dropout;
pub(crate) mod encoder;
pub(crate) mod exponential;
pub(crate) mod layers;
pub(crate) mod optimizer;
pub(crate) mod schedule;

use veiloc_geometry::nalgebra::DMatrix;

/// `[features, keypoints]`.
pub(crate) type Matrix = DMatrix<f32>;
