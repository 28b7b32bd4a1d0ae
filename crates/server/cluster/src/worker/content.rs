//! What stands behind the name of an object, opened.

use veiloc_map::MapFile;
use veiloc_map::regions::Index;

/// What a worker holds of a map.
#[derive(Debug)]
pub(crate) enum Content {
    /// A region, which gives poses.
    Region(Box<MapFile>),
    /// An index, which says which regions to ask.
    Index(Box<Index>),
}
