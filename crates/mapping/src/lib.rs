//! Posed images to map: pairs, matching, tracks, triangulation.
//!
//! ```text
//! images ── features ── pairs ── matches ── epipolar check ── tracks ── triangulation ── completion ── map
//!                            from the poses      with the poses
//! ```
//! - [`build`]: a map of images whose poses are known.
//! - [`add`], [`remove`]: images join and leave; what they do not touch stays as it is, bit for bit.
//! - [`import`]: a complete COLMAP model, whose points and observations are kept.
//!
//! Poses are taken for true: only points move. Results depend neither on the number of threads nor on time.
#![forbid(unsafe_code)]

mod build;
mod change;
mod complete;
mod error;
mod extract;
mod import;
mod matching;
mod options;
mod pairs;
mod progress;
mod scene;
mod tracks;
mod triangulation;
mod view;

pub use build::build;
pub use change::{add, remove};
pub use error::MappingError;
pub use import::{ImportReport, import};
pub use options::BuildOptions;
pub use progress::Progress;

#[cfg(test)]
mod tests;
