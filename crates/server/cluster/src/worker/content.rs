//! The opened content of an object.

use veiloc_map::MapFile;
use veiloc_map::regions::RegionIndex;

/// A part of a map that a worker holds.
#[derive(Debug)]
pub(crate) enum Content {
    /// A region, in which queries are localized.
    Region(Box<MapFile>),
    /// An index, which selects the regions for a query.
    Index(Box<RegionIndex>),
}
