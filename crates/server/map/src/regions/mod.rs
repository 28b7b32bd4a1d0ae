//! A map cut into regions, so that a scene may be larger than the memory of a machine. This module uses neither
//! network nor clock.
//!
//! ```text
//! map ── cut: who is with whom ── regions: maps of their own ─┐
//!                              └─ index: globals, who is where ┴─ manifest: names them all by SHA-256
//! ```
//! - [`cut()`]: assigns images to regions. Every image is in the core of exactly one region; regions overlap.
//! - [`FolderWriter`], [`RegionFolder`]: a folder of `manifest.json` and `objects/<sha256>`, as `veiloc map split`
//!   writes it.
//! - [`Manifest`]: the parts of a cut map. Its id is the SHA-256 of its bytes, and every object is named by its
//!   SHA-256.
//! - [`RegionIndex`]: global descriptors of all images, and the regions of each image, for selecting regions.
//! - [`ObjectId`], [`ObjectRef`]: names that cannot leave their folder, and the expected content.
//!
//! A region is an ordinary map file ([`crate::Region`]) with the profile of the whole map, so a query sealed for the
//! whole map fits every region. It has the summary of each point in the whole map, so a match has the same likelihood
//! as in the whole map. `docs/reference/map-format.md` specifies the manifest and the index.
//!
//! # From a folder to a pose
//! ```no_run
//! use veiloc_map::MapMemory;
//! use veiloc_map::regions::RegionFolder;
//!
//! # fn of_query() -> veiloc_descriptor::GlobalDescriptor { unimplemented!() }
//! let folder = RegionFolder::open(std::path::Path::new("kitchen"))?;
//! let index = folder.open_index(MapMemory::Mapped)?;
//! // The region that holds most of what whole-map retrieval would give.
//! let best = index.rank(&of_query(), 10)[0].region;
//! let region = folder.open_region(best, MapMemory::Mapped)?;
//! println!("{} images", region.image_count());
//! # Ok::<(), veiloc_map::MapError>(())
//! ```
#![forbid(unsafe_code)]

mod cut;
mod folder;
mod index;
mod manifest;
mod object;
mod search_rounds;
mod verify;

pub use cut::{SplitOptions, cut};
pub use folder::{FolderWriter, MANIFEST_FILE, OBJECTS_FOLDER, RegionFolder};
pub use index::{INDEX_VERSION, RankedRegion, RegionIndex};
pub use manifest::{MANIFEST_VERSION, MAX_MANIFEST_BYTES, MAX_OBJECT_BYTES, Manifest, RegionEntry};
pub use object::{ObjectId, ObjectRef};
pub use search_rounds::{DEFAULT_SEARCHED_REGIONS, is_better_pose, search_rounds};
pub use verify::verify_file;
