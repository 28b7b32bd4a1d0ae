//! Image retrieval by global descriptors.

use veiloc_descriptor::{GlobalDescriptor, GlobalIndex, RANKS_OF_OTHER_PLACES, images_of_other_places};
use veiloc_map::{MapView, PointId};

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
    ranked(query, map, count, count)
}

/// [`retrieve`], and after its images up to three of other places that look nearly as much like the query.
///
/// Without these images the matches hold one of two places that look alike, and nothing of the other
/// ([`images_of_other_places`]).
pub fn retrieve_with_other_places(
    query: &GlobalDescriptor,
    map: MapView<'_>,
    count: usize,
) -> Vec<RetrievedImage> {
    let mut retrieved = ranked(query, map, count, count + RANKS_OF_OTHER_PLACES);
    let points = |image: usize| -> Vec<PointId> {
        let image = map.file().image(image);
        (0..image.keypoints().len()).filter_map(|keypoint| map.point_of(&image, keypoint)).collect()
    };
    let scored: Vec<(usize, f32)> = retrieved.iter().map(|image| (image.image, image.similarity)).collect();
    let others = images_of_other_places(&scored, count, points);
    let further = retrieved.split_off(count.min(retrieved.len()));
    retrieved.extend(further.into_iter().filter(|image| others.contains(&image.image)));
    retrieved
}

/// Images that the caller retrieved, without those that the map does not have; their similarity is not known (0).
pub(crate) fn given_images(images: &[usize], map: MapView<'_>) -> Vec<RetrievedImage> {
    let is_there = |image: &usize| *image < map.file().image_count() && !map.is_left_out(*image);
    images.iter().copied().filter(is_there).map(|image| RetrievedImage { image, similarity: 0.0 }).collect()
}

/// The `count` map images most similar to the query, among as many candidates as for the `requested` ones.
fn ranked(query: &GlobalDescriptor, map: MapView<'_>, requested: usize, count: usize) -> Vec<RetrievedImage> {
    let found = match map.file().global_index() {
        None => query.most_similar(map.images().map(|(image, view)| (image, view.global())), count),
        Some(index) => {
            let named = index.candidates(query, GlobalIndex::candidates_for(requested));
            let remaining = named.into_iter().filter(|image| !map.is_left_out(*image));
            query.most_similar(remaining.map(|image| (image, map.file().image(image).global())), count)
        }
    };
    found.into_iter().map(|(image, similarity)| RetrievedImage { image, similarity }).collect()
}
