//! The map model, its file, and posed images and COLMAP models as ways in and out.
//!
//! For whoever keeps maps (an operator's tools) and whoever reads them (a service that localizes).
//!
//! - [`PosedImages`]: images with cameras and poses, what a map is built of; [`colmap::read_posed`] reads COLMAP's.
//! - [`MapModel`]: a map as an owned value, what mapping builds and changes.
//! - [`MapFile`]: the same in a file that is mapped into memory and served from; [`write()`] makes one, and
//!   [`MapLock`] is for whoever reads a map to change it.
//! - [`SelfTest`]: how well a map localizes its own images, and the [`Calibration`] of covariances that follows.
//! - [`Down`]: which way is down in the map, where somebody knows.
//! - [`Compressed`]: what a small map remembers of the whole one it was made of.
//! - [`Region`]: which part of a larger map a map is; [`MapFile::region`] cuts it out.
//! - [`MapView`]: a map file whole, or with one image left out of it.
//! - [`colmap`]: COLMAP's models, text and binary, read strictly and written; [`write_ply`] writes a map's points.
//!
//! # Who checks what
//! A [`MapModel`] may be put together freely; [`MapModel::validate`] says whether it is a map, and [`write()`] asks it.
//! A [`MapFile`] was checked whole when it was opened (checksums, indices, names, poses), so its accessors neither
//! fail nor panic on what the file holds. The bytes of the format are specified in `docs/reference/map-format.md`.
//!
//! # Changing a map
//! ```
//! use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
//! use veiloc_map::{BuildSettings, MapFile, MapLock, MapModel};
//! use veiloc_protocol::Profile;
//!
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("hall.vmap");
//! // A map without images; `veiloc_mapping::build` makes better ones.
//! let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![30; 128])?;
//! let profile = Profile::vlad(Vocabulary::new(words)?);
//! veiloc_map::write(&MapModel::empty(profile, BuildSettings::default()), &path)?;
//!
//! let lock = MapLock::acquire(&path)?; // nobody else changes it now
//! let mut model = MapFile::open(&path)?.to_model();
//! model.settings.pairs_per_image = 40;
//! lock.write(&model)?;
//! drop(lock);
//!
//! let map = MapFile::open(&path)?;
//! assert_eq!((map.image_count(), map.settings().pairs_per_image), (0, 40));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

pub mod atomic_file;
pub mod colmap;
mod compressed;
mod down;
mod error;
mod file;
mod model;
mod name;
mod ply;
mod posed;
mod region;
pub mod regions;
mod self_test;
mod settings;

pub use compressed::{Compressed, Remembered};
pub use down::{Down, DownError};
pub use error::{ManifestError, MapError, Place, Record};
pub use file::{
    Evidence, FORMAT_VERSION, ImageView, MapFile, MapLock, MapMemory, MapView, PointWithout, Without,
    byte_count, write,
};
pub use model::{MapImage, MapModel, MapPoint, Observation, PointId};
pub use name::is_map_name;
pub use ply::write_ply;
pub use posed::{PosedImage, PosedImages};
pub use region::{Region, RegionImage};
pub use self_test::{ABSOLUTE, Calibration, Coverage, LEVELS, RELATIVE, SchemeTest, SelfTest};
pub use settings::BuildSettings;
