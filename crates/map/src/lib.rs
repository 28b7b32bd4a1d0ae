//! The map model, its file, and COLMAP models as the way in and out.
//!
//! - [`MapModel`]: a map as an owned value, what mapping builds and changes.
//! - [`MapFile`]: the same in a file that is mapped into memory and served from; [`write()`] makes one.
//! - [`colmap`]: COLMAP's models, text and binary, read strictly; text written.
//!
//! # Who checks what
//! A [`MapModel`] may be put together freely; [`MapModel::validate`] says whether it is a map, and [`write()`] asks it.
//! A [`MapFile`] was checked whole when it was opened (checksums, indices, names, poses), so its accessors neither
//! fail nor panic on what the file holds. The bytes of the format are specified in `docs/map-format.md`.
#![forbid(unsafe_code)]

pub mod colmap;
mod error;
mod file;
mod model;

pub use error::{MapError, Place, Record};
pub use file::{FORMAT_VERSION, ImageView, MapFile, write};
pub use model::{MapImage, MapModel, MapPoint, Observation, PointId};
