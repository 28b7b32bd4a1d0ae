//! Image retrieval by global descriptors.

use veiloc_descriptor::{GlobalDescriptor, GlobalIndex, images_of_other_places};
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
    let mut retrieved = ranked(query, map, count, count + MAX_RANKS);
    let further = retrieved.split_off(count.min(retrieved.len()));
    let Some(best) = retrieved.first() else { return retrieved };
    let least = MIN_SIMILARITY_SHARE * best.similarity;
    let alike = further.iter().take_while(|image| least > 0.0 && image.similarity >= least);
    let alike: Vec<RetrievedImage> = alike.copied().collect();
    let points = |image: usize| -> Vec<PointId> {
        let image = map.file().image(image);
        (0..image.keypoints().len()).filter_map(|keypoint| map.point_of(&image, keypoint)).collect()
    };
    let chosen: Vec<usize> = retrieved.iter().map(|image| image.image).collect();
    let others = images_of_other_places(&chosen, alike.iter().map(|image| image.image), points);
    retrieved.extend(alike.into_iter().filter(|image| others.contains(&image.image)));
    retrieved
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

/// How many of the images after the retrieved ones are examined.
const MAX_RANKS: usize = 100;

/// Least similarity of an added image, as a share of that of the most similar image. Images of other places had at most
/// 0.30 of it on RedKitchen, 0.46 on tum-fr1-rpy, and 0.73 on hololens-office (rooms with equal furniture).
const MIN_SIMILARITY_SHARE: f32 = 0.7;
