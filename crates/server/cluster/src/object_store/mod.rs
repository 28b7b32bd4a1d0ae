//! Regions of maps in object storage.
//!
//! ```text
//! folder of regions ── publish ──▶ URL/objects/<sha256>          first
//!                                  URL/manifests/<id>.json       then
//!                                  URL/<map name>.json           last: the id of the current manifest
//! cache folder      ◀── fetch ──  pointer, manifest, objects; each verified before it gets its name
//! ```
//! - [`Storage`]: storage by its URL (`file://…` or a path; `s3://…`, `gs://…` and `az://…` with the cargo feature
//!   `clouds`), [`Storage::publish`], and the published [`Storage::versions`] of
//!   a map, with [`Storage::restore`] and [`Storage::remove_older`].
//! - [`ObjectCache`]: verified objects on the local disk with a size limit; the least recently used are evicted.
//! - [`fetch_folder`]: fetches all regions of a map into a folder.
//! - [`ManifestPointer`]: names the current manifest of a map.
//!
//! Storage is not trusted: names of objects are SHA-256 values, no more bytes are read than expected, and a file gets
//! its name only after verification. So faulty or hostile storage can only withhold objects. `docs/reference/map-format.md`
//! specifies the layout.
//!
//! # Example
//! ```
//! # async fn run(url: &str) -> Result<(), veiloc_cluster::ClusterError> {
//! use veiloc_cluster::object_store::{ObjectCache, Storage};
//!
//! let storage = Storage::open(url)?;
//! let cache = ObjectCache::open(std::path::Path::new("cache"), 20 << 30)?;
//! let id = storage.current("kitchen").await?;
//! let manifest = cache.manifest(&storage, "kitchen", id).await?;
//! let region = cache.object(&storage, &manifest.regions[0].object()).await?;
//! println!("{}", region.display());
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

pub(crate) mod address;
mod cache;
mod fetch;
mod pointer;
mod publish;
pub(crate) mod refusal;
mod retry;
mod storage;
mod versions;

pub use cache::{ObjectCache, TrimSummary};
pub use fetch::{FetchSummary, fetch_folder};
pub use pointer::ManifestPointer;
pub use publish::{ProgressCallback, PublishSummary};
pub use storage::Storage;
pub use versions::{PublishedVersion, RemovalSummary};
