//! How networks are trained here, whatever they learn: simple layers, the optimizer, the loop, and its state.
//!
//! All numbers of a network stand in one list, in the order of its layers; a layer knows where its own begin ([`layers`]),
//! and derivatives stand in a list of the same order. So an optimizer, a file and a checkpoint are about lists of numbers and
//! nothing else. Everything is on the CPU and in `f32`, derivatives are written by hand, and no sum depends on the number of
//! threads. Decision 0021 says why no library does this.
//!
//! - [`Subject`]: what is learned; [`learn`]: the loop, which [`Progress`] looks on at.
//! - [`TrainingState`]: everything from which an interrupted training goes on as if it had not been.
//! - [`mod@file`]: what files of networks have in common.
#![forbid(unsafe_code)]

mod course;
pub mod file;
pub mod layers;
mod learn;
mod optimizer;
mod schedule;
mod state;

use veiloc_geometry::nalgebra::DMatrix;

pub use course::Course;
pub use learn::{Progress, Subject, Trained, begin, learn};
pub use state::{CurvePoint, TrainingState, fingerprint};

/// `[features, columns]`; a column is a keypoint, or a pixel.
pub type Matrix = DMatrix<f32>;
