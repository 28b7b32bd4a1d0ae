//! One service of many machines: workers that hold regions of a map, and the gateway that asks them.
//!
//! ```text
//! device ── HTTP ── gateway ──┬── index group ── which regions?
//!                             └── region groups ── the sealed query, as it came ── pose
//!                 bus: NATS, or one process        source: where maps are published
//! ```
//! - [`Gateway`]: asks for poses in the place of a map in memory; `veiloc_service` takes it as
//!   [`veiloc_service::MapElsewhere`], and does all that HTTP needs.
//! - [`Worker`]: holds a [`Share`] of a map's regions, each verified, and answers for them.
//! - [`ManifestSource`]: where both look what is published.
//! - [`message`]: what they say to each other.
//!
//! What is sent is what the device sealed, byte for byte, also when it is sent to a second worker or once more (rule L7): two
//! seals of one image would tell more than one, two copies of one seal do not. This crate depends neither on
//! `veiloc-features` nor on `veiloc-obfuscation`: like the service, it cannot name a keypoint of a query.
//!
//! `docs/guide/cluster.md` is for operators, decision 0029 says why it is as it is.
#![forbid(unsafe_code)]

pub mod bus;
mod error;
mod gateway;
mod manifest_source;
pub mod message;
pub mod object_store;
mod reachability;
mod share;
mod subjects;
mod worker;

pub use error::ClusterError;
pub use gateway::{Gateway, GatewayOptions};
pub use manifest_source::{Fetching, FolderSource, ManifestSource, ObjectStoreSource, Published};
pub use share::Share;
pub use worker::{Worker, WorkerHandle, WorkerOptions};
