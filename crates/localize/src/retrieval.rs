//! Image retrieval: which map images look like the query, by their global descriptors.

use veiloc_descriptor::GlobalDescriptor;
use veiloc_map::MapView;

/// A retrieved image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Retrieved {
    /// Index of the image in the map.
    pub image: usize,
    /// Cosine similarity of the global descriptors, -1 to 1.
    pub similarity: f32,
}

/// The `count` map images most similar to the query, best first; equal ones in the map's order.
pub fn retrieve(query: &GlobalDescriptor, map: MapView<'_>, count: usize) -> Vec<Retrieved> {
    let mut all: Vec<Retrieved> = map
        .images()
        .map(|(image, view)| Retrieved { image, similarity: query.similarity(view.global()) })
        .collect();
    all.sort_by(|a, b| b.similarity.total_cmp(&a.similarity).then(a.image.cmp(&b.image)));
    all.truncate(count);
    all
}
