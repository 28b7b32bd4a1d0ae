//! Regions of published maps, which are opened when they are first asked for.

use std::fmt;
use std::future::Future;
use std::num::NonZeroU64;
use std::pin::Pin;
use std::sync::Arc;

use veiloc_map::MapFile;
use veiloc_map::regions::ObjectId;

use crate::http::problem::Problem;
use crate::maps::LoadedMap;
use crate::telemetry::RegionCounts;

/// A region in use. Clones share it; it stays open until the last one is dropped.
#[derive(Clone)]
pub struct OpenRegion(pub(crate) Arc<LoadedMap>);

impl OpenRegion {
    /// A region of the map of this name.
    pub fn new(map: &str, region: MapFile) -> Self {
        // Build the index now, not on the first query.
        region.global_index();
        Self(Arc::new(LoadedMap::local(map, region)))
    }
}

impl fmt::Debug for OpenRegion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("OpenRegion").field("map", &self.0.name).finish_non_exhaustive()
    }
}

/// Why a region cannot be served.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RegionFailure {
    /// No map of this name is published, or its manifest has no such region.
    Unknown,
    /// The region cannot be read at the moment; the log says why.
    Unavailable,
}

impl RegionFailure {
    pub(crate) const fn problem(self) -> Problem {
        match self {
            Self::Unknown => Problem::UnknownMap,
            Self::Unavailable => Problem::Unreached { retry_after: NonZeroU64::MIN },
        }
    }
}

/// A region in the future.
pub type RegionFuture<'a> = Pin<Box<dyn Future<Output = Result<OpenRegion, RegionFailure>> + Send + 'a>>;

/// Where a service finds the regions of published maps.
pub trait RegionSource: Send + Sync {
    /// The region with this id of the published map of this name, opened if it is not yet. It is called for
    /// authenticated clients only, with any name and id.
    fn region<'a>(&'a self, map: &'a str, region: ObjectId) -> RegionFuture<'a>;
}

/// The regions of a service.
#[derive(Clone)]
pub struct Regions {
    /// Where it finds them.
    pub source: Arc<dyn RegionSource>,
    /// Counters of the source, to be included in the metrics.
    pub counts: RegionCounts,
}

impl fmt::Debug for Regions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Regions")
    }
}
