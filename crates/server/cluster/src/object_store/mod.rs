//! Regions of maps in object storage.
//!
//! ```text
//! folder of regions ── publish ──▶ URL/objects/<sha256>          first
//!                                  URL/manifests/<id>.json       then
//!                                  URL/<map name>.json           last: the id of the current manifest
//! cache folder      ◀── fetch ──  pointer, manifest, objects; each verified before it gets its name
//! ```
//! - [`Storage`]: a place by its URL (`file://…` or a path; `s3://…`, `gs://…` and `az://…` with the cargo feature `clouds`),
//!   and [`Storage::publish`].
//! - [`Cache`]: verified objects on the local disk, of bounded size; what was used least recently goes.
//! - [`fetch_folder`]: all regions of a map, as a folder.
//! - [`Pointer`]: which manifest of a map is the current one.
//!
//! Nothing that storage says is believed: names of objects are SHA-256 and nothing else, no more bytes are read than are
//! expected, and a file gets its name only when its content is right. So storage that is wrong or hostile can withhold, and
//! no more. `docs/reference/map-format.md` specifies what lies where.
//!
//! # Example
//! ```
//! # async fn run(url: &str) -> Result<(), veiloc_cluster::ClusterError> {
//! use veiloc_cluster::object_store::{Cache, Storage};
//!
//! let storage = Storage::open(url)?;
//! let cache = Cache::open(std::path::Path::new("cache"), 20 << 30)?;
//! let id = storage.current("kitchen").await?;
//! let manifest = cache.manifest(&storage, "kitchen", id).await?;
//! let region = cache.object(&storage, &manifest.regions[0].object()).await?;
//! println!("{}", region.display());
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

mod address;
mod cache;
mod fetch;
mod pointer;
mod publish;
pub(crate) mod refusal;
mod retry;
mod storage;

pub use cache::{Cache, Trimmed};
pub use fetch::{Fetched, fetch_folder};
pub use pointer::Pointer;
pub use publish::{Published, Watch};
pub use storage::Storage;
