//! Internal: published maps in an object store, and a service distributed over several machines: workers that serve the
//! regions of maps, and gateways that query them.
//!
//! ```text
//! device ── HTTP ── gateway: which regions? ──┬── HTTP ── worker: pose in a region ──┐
//!                      │                      └── HTTP ── worker: pose in a region ──┤
//!                      └────────── object store: manifests, index, regions ──────────┘
//! ```
//! - [`object_store`]: publishes and fetches maps that were cut into regions.
//! - [`PublishedMaps`]: what is published, through a cache on the local disk.
//! - [`StoredRegions`]: the regions of a worker, which is [`veiloc_service`] with this
//!   [`RegionSource`](veiloc_service::RegionSource).
//! - [`Gateway`]: computes poses by querying [`Workers`]; it is a [`RemoteBackend`](veiloc_service::RemoteBackend) of
//!   [`veiloc_service`], which handles HTTP.
//!
//! Workers receive exactly the bytes that the device sealed, also when they are sent to a second worker or again
//! (rule L7): two seals of one image would reveal more than one, two copies of one seal do not. This crate depends
//! neither on `veiloc-features` nor on `veiloc-obfuscation`: like the service, it cannot name a keypoint of a query.
//!
//! `docs/guide/cluster.md` is for operators, decision 0066 explains the design.
#![forbid(unsafe_code)]

mod error;
mod gateway;
pub mod object_store;
mod published;
mod regions;

pub use error::ClusterError;
pub use gateway::{Gateway, GatewayOptions, WorkerAccess, Workers};
pub use published::{CachedObject, PublishedManifest, PublishedMaps};
pub use regions::StoredRegions;
