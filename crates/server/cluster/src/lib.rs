//! Internal: a service distributed over several machines: workers hold regions of a map, and gateways query them.
//!
//! ```text
//! device ── HTTP ── gateway ──┬── a worker with the index ── which regions?
//!                             └── a worker of each region ── the sealed query, as it came ── pose
//!                 bus: NATS, or one process        source: where maps are published
//! ```
//! - [`Gateway`]: computes poses by querying workers; `veiloc_service` uses it as [`veiloc_service::RemoteMap`]
//!   and handles HTTP.
//! - [`Worker`]: holds a verified [`RegionShare`] of the regions of a map, or what is [`Placed`] on it, and answers requests for
//!   them.
//! - [`ManifestSource`]: where both read what is published.
//! - [`message`]: the messages between gateways and workers. [`Announcement`]: what workers say of themselves, from which
//!   gateways know whom to ask.
//!
//! Workers receive exactly the bytes that the device sealed, also when they are sent to a second worker or again
//! (rule L7): two seals of one image would reveal more than one, two copies of one seal do not. This crate depends
//! neither on `veiloc-features` nor on `veiloc-obfuscation`: like the service, it cannot name a keypoint of a query.
//!
//! `docs/guide/cluster.md` is for operators, decisions 0029, 0052 and 0055 to 0057 explain the design.
#![forbid(unsafe_code)]

mod announcement;
pub mod bus;
mod error;
mod frame_version;
mod gateway;
mod manifest_source;
mod members;
pub mod message;
pub mod object_store;
mod placement;
mod rate_exchange;
mod share;
mod subjects;
mod worker;

pub use announcement::{Announced, Announcement, MemberId};
pub use error::ClusterError;
pub use frame_version::{FrameVersions, OLDEST_VERSION, VERSION};
pub use gateway::{Gateway, GatewayOptions};
pub use manifest_source::{FolderSource, ManifestSource, ObjectStoreSource, PublishedManifest, SourceFuture};
pub use placement::Placed;
pub use rate_exchange::{RateExchangeOptions, share_rates};
pub use share::RegionShare;
pub use worker::{PlacementOptions, Worker, WorkerHandle, WorkerOptions};
