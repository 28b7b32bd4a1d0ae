//! Options of the demo.

use std::path::PathBuf;

use veiloc_protocol::Scheme;

/// Options of the demo.
#[derive(Debug, Clone)]
pub(crate) struct DemoOptions {
    /// Output folder.
    pub out: PathBuf,
    /// Seed of the scene and of every random choice.
    pub seed: u64,
    /// Number of views that the map is built from. 40 views cover every corner of the room from several sides.
    pub map_views: usize,
    /// Hidden views that are localized.
    pub query_views: usize,
    /// Schemes that are compared.
    pub schemes: Vec<Scheme>,
}

impl DemoOptions {
    /// Default size: 40 map views, 12 hidden ones, all four schemes.
    pub(crate) fn new(out: PathBuf, seed: u64) -> Self {
        let schemes =
            vec![Scheme::Points, Scheme::RandomLines, Scheme::CoordinatePermutation, Scheme::default()];
        Self { out, seed, map_views: 40, query_views: 12, schemes }
    }
}
