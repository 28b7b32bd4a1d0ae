//! Cost and leakage of schemes: the same images localized and attacked.
//!
//! - [`sessions`]: leakage of several frames of one scene, by the reference frame of their anchors.
//! - [`adversaries`]: gain of each adversary from the queries of every scheme.
//!
//! This module uses the attacks of `attacks` and the pipeline of `evaluation`. It knows the ground truth and must not
//! run on devices or servers.
#![forbid(unsafe_code)]

pub mod adversaries;
pub mod sessions;
mod spread;
