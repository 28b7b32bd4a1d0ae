//! What a scheme costs and what it leaks: the same images localized and attacked, side by side.
//!
//! - [`sessions`]: what several frames of one place give away, by what their anchors are tied to.
//! - [`adversaries`]: what each adversary gets from the queries of every scheme.
//! - [`layouts`]: layouts of dcl: how exact poses are beside those of points, and what each adversary gains.
//!
//! It measures with the attacks of `attacks` and the road of `eval`, and has neither of its own. Nothing here is for
//! devices or servers: it knows the truth, to judge attacks and poses by.
#![forbid(unsafe_code)]

pub mod adversaries;
pub mod layouts;
pub mod sessions;
mod spread;
