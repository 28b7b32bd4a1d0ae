//! Image retrieval by global descriptors.

use veiloc_descriptor::{GlobalDescriptor, GlobalIndex};
use veiloc_map::MapView;

/// A retrieved image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RetrievedImage {
    /// Index of the image in the map.
    pub image: usize,
    /// Cosine similarity of the global descriptors, -1 to 1.
    pub similarity: f32,
}

/// The `count` map images most similar to the query, best first; ties in map order.
///
/// In a map of thousands of images only candidates of the index are compared: they include practically all of the
/// best ten (`docs/results/scale.md`).
pub fn retrieve(query: &GlobalDescriptor, map: MapView<'_>, count: usize) -> Vec<RetrievedImage> {
    let found = match map.file().global_index() {
        None => query.most_similar(map.images().map(|(image, view)| (image, view.global())), count),
        Some(index) => {
            let named = index.candidates(query, GlobalIndex::candidates_for(count));
            let remaining = named.into_iter().filter(|image| !map.is_left_out(*image));
            query.most_similar(remaining.map(|image| (image, map.file().image(image).global())), count)
        }
    };
    found.into_iter().map(|(image, similarity)| RetrievedImage { image, similarity }).collect()
}
