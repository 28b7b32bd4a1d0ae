//! Why a machine of a cluster could not start or go on, with the remedy.

use crate::bus::BusError;
use veiloc_map::regions::RegionsError;
use veiloc_service::ServerError;

use crate::shelf::ShelfError;

/// Why a worker or a gateway could not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// The bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Where maps are published.
    #[error(transparent)]
    Shelf(#[from] ShelfError),
    /// A region or an index.
    #[error(transparent)]
    Regions(#[from] RegionsError),
    /// A share of the regions that is none.
    #[error(
        "{text:?} is no share of regions; write 1/3 for the first of three, or numbers with commas between: 0,4,7"
    )]
    Share {
        /// What was written.
        text: String,
    },
    /// A name that no map has.
    #[error("{name:?} cannot name a map; use letters, digits, `-`, `_` and `.`, at most 64")]
    Name {
        /// The name.
        name: String,
    },
    /// A profile that is none.
    #[error("the profile {object} that the manifest names: {source}; publish the map again")]
    Profile {
        /// Which object.
        object: veiloc_map::regions::ObjectId,
        /// What is wrong with it.
        source: veiloc_protocol::QueryError,
    },
    /// The listener of probes and metrics.
    #[error(transparent)]
    Probes(#[from] ServerError),
    /// Threads or signal handlers could not be had.
    #[error("the system refused {what}: {source}")]
    System {
        /// What was asked for.
        what: &'static str,
        /// What it said.
        source: std::io::Error,
    },
}
