//! Places of published data sets, in the folders and lists they are handed out in.
//!
//! - [`seven_scenes`]: 7Scenes, with the poses of its depth camera or the SfM pseudo ground truth.
//! - [`cambridge`]: Cambridge Landmarks.
//! - [`aachen`]: Aachen Day-Night v1 and v1.1, whose queries have no published poses.
//! - [`mod@write`]: the same folders, written: a place of one's own for programs that read only these. Writer and reader of a data
//!   set stand in one file.
//! - [`nvm`]: VisualSFM's models, which two of them bring.
//!
//! A reader answers a [`Place`]: images with cameras and poses, which of them a map is built from, and which are queries.
//! What is missing is named with where users get it. Reads lists and sizes of images, never their pixels.
#![forbid(unsafe_code)]

pub mod aachen;
pub mod cambridge;
mod error;
mod files;
mod lines;
pub mod nvm;
mod official;
mod place;
pub mod problem_files;
mod radial;
pub mod seven_scenes;
pub mod write;

pub use error::DatasetError;
pub use files::MissingImages;
pub use place::{Place, Query};
