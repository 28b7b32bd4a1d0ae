//! A map cut into regions, so that a place may be larger than a machine: neither network nor clock here.
//!
//! ```text
//! map ── cut: who is with whom ── regions: maps of their own ─┐
//!                              └─ index: globals, who is where ┴─ manifest: names them all by SHA-256
//! ```
//! - [`cut`]: which images go into which region. Every image is in the core of exactly one; regions overlap.
//! - [`FolderWriter`], [`Folder`]: a folder of `manifest.json` and `objects/<sha256>`, as `veiloc map split` writes it.
//! - [`Manifest`]: what belongs together. Its id is the SHA-256 of its bytes, and every object is named by its own.
//! - [`Index`]: global descriptors of all images and where each image is, for machines that only choose regions.
//! - [`ObjectId`], [`ObjectRef`]: names that cannot leave their folder, and what must be found under them.
//!
//! A region is a map file like any other ([`crate::Region`] says of what), with the profile of the whole map to the
//! bit: a query that was sealed for the whole map fits every region. What the whole map knows of a point is remembered, so
//! that a match counts in a region as it does in the whole. `docs/reference/map-format.md` specifies the manifest and the index.
//!
//! # From a folder to a pose
//! ```no_run
//! use veiloc_map::MapMemory;
//! use veiloc_map::regions::Folder;
//!
//! # fn of_query() -> veiloc_descriptor::GlobalDescriptor { unimplemented!() }
//! let folder = Folder::open(std::path::Path::new("kitchen"))?;
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
mod rounds;
mod verify;

pub use cut::{SplitOptions, cut};
pub use folder::{Folder, FolderWriter, MANIFEST_FILE, OBJECTS_FOLDER};
pub use index::{INDEX_VERSION, Index, Ranked};
pub use manifest::{MANIFEST_VERSION, MOST_MANIFEST_BYTES, MOST_OBJECT_BYTES, Manifest, RegionEntry};
pub use object::{ObjectId, ObjectRef};
pub use rounds::{ASKED, is_better, rounds};
pub use verify::verify_file;
