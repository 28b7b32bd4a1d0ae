//! Internal: the map model, its file format, and posed images and COLMAP models as input and output.
//!
//! For tools that build maps, and for services that localize in them.
//!
//! - [`PosedImages`]: images with cameras and poses, the input of mapping; [`colmap::read_posed`] reads them from
//!   COLMAP.
//! - [`MapModel`]: a map as an owned value, which mapping builds and changes.
//! - [`MapFile`]: a map in a validated file, from which queries are served; [`write()`] writes one, and [`MapLock`]
//!   is needed to modify one.
//! - [`SelfTest`]: how well a map localizes its own images, and the [`CovarianceCalibration`] of covariances that
//!   follows.
//! - [`GravityDirection`]: the direction of gravity in the map, if known. [`AlignmentAccuracy`]: how well its frame is known.
//! - [`WholeMapSummary`]: data that a compressed map keeps about the whole map.
//! - [`Region`]: the part of a larger map that a map is; [`MapFile::region`] extracts it.
//! - [`MapFile::pack`]: its descriptors without positions, for devices.
//! - [`AnchorsEdit`], [`read_anchors`]: the content anchors beside a map file.
//! - [`MapView`]: a map file, whole or with one image left out.
//! - [`text`]: text files that people and other programs write.
//! - [`colmap`]: strict reader and writer of COLMAP models, text and binary; [`write_ply`] writes the points of a
//!   map.
//!
//! # Validation
//! A [`MapModel`] may be modified freely; [`MapModel::validate`] checks its consistency, and [`write()`] calls it. A
//! [`MapFile`] is validated when it is opened (checksums, indices, names, poses), so its accessors neither fail nor
//! panic. `docs/reference/map-format.md` specifies the format.
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
//! let lock = MapLock::acquire(&path)?; // no other program changes it now
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

mod alignment;
mod anchors;
pub mod atomic_file;
pub mod colmap;
mod compressed;
mod error;
mod file;
mod gravity;
mod model;
mod pack;
mod ply;
mod posed;
mod region;
pub mod regions;
mod self_test;
mod settings;
pub mod text;

pub use alignment::AlignmentAccuracy;
pub use anchors::{AnchorsEdit, anchors_path, read_anchors};
pub use compressed::{PointSummary, WholeMapSummary};
pub use error::{FilePosition, ManifestError, MapError, ModelRecord};
pub use file::{
    FORMAT_VERSION, HeldOut, HeldOutPoint, ImageView, MapFile, MapLock, MapMemory, MapView, PointEvidence,
    byte_count, write,
};
pub use gravity::{GravityDirection, GravityDirectionError};
pub use model::{MapImage, MapModel, MapPoint, Observation, PointId};
pub use pack::PackPoints;
pub use ply::write_ply;
pub use posed::{PosedImage, PosedImages};
pub use region::{Region, RegionImage};
pub use self_test::{
    ABSOLUTE, CameraErrors, ConfidenceCoverage, CovarianceCalibration, LEVELS, RELATIVE, SchemeTest, SelfTest,
};
pub use settings::BuildSettings;
pub use veiloc_protocol::is_map_name;
pub use veiloc_simd::open_regular_file;
