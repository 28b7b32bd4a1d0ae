//! What the demo does.

use std::path::PathBuf;

use veiloc_protocol::Scheme;

/// What the demo does.
#[derive(Debug, Clone)]
pub(crate) struct DemoOptions {
    /// Folder for everything that is written.
    pub out: PathBuf,
    /// Seed of the place and of every random choice.
    pub seed: u64,
    /// Views the map is built from. 40 look into every corner of the room from several sides.
    pub map_views: usize,
    /// Hidden views that are localized.
    pub query_views: usize,
    /// Schemes that are compared.
    pub schemes: Vec<Scheme>,
}

impl DemoOptions {
    /// The demo's own size: 40 views for the map, 12 hidden ones, all four schemes.
    pub(crate) fn new(out: PathBuf, seed: u64) -> Self {
        let schemes =
            vec![Scheme::Points, Scheme::RandomLines, Scheme::CoordinatePermutation, Scheme::default()];
        Self { out, seed, map_views: 40, query_views: 12, schemes }
    }
}
