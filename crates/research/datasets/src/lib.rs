//! Internal: scenes of published data sets, in their original folders and lists.
//!
//! - [`seven_scenes`]: 7Scenes, with the poses of its depth camera or the SfM pseudo ground truth.
//! - [`cambridge`]: Cambridge Landmarks.
//! - [`aachen`]: Aachen Day-Night v1 and v1.1, whose queries have no published poses.
//! - [`mod@write`]: writes the same folders, so that other programs can read a user's own scene. Writer and reader of
//!   a data set are in one file.
//!
//! A reader returns a [`DatasetScene`]: images with cameras and poses, split into map images and queries. Errors name
//! what is missing and where to get it. Readers use lists and image sizes, never pixels.
#![forbid(unsafe_code)]

pub mod aachen;
pub mod cambridge;
mod error;
mod files;
mod lines;
mod official;
pub mod problem_files;
mod scene;
pub mod seven_scenes;
pub mod write;

pub use error::DatasetError;
pub use files::MissingImages;
pub use scene::{DatasetQuery, DatasetScene};
