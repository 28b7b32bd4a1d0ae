//! Covisibility: the number of points that two images share.

use std::collections::BTreeMap;

use crate::MapFile;
use rayon::prelude::*;

/// Maximum number of images per track that are compared: a track of a thousand would give a million pairs. Longer
/// tracks are subsampled, and each image then counts several times.
const MAX_IMAGES_PER_TRACK: usize = 64;

/// Maximum number of neighbours per image, those with most shared points.
const MAX_NEIGHBOURS: usize = 64;

/// Shared points of images, for the strongest neighbours of each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Covisibility {
    /// `[I]`, neighbours and shared points, in ascending order of the neighbour; each pair is stored at both images.
    neighbours: Vec<Vec<(u32, u32)>>,
}

impl Covisibility {
    pub(super) fn of(map: &MapFile) -> Self {
        let strongest = |image: usize| {
            let mut shared: BTreeMap<u32, u32> = BTreeMap::new();
            let view = map.image(image);
            for point in (0..view.keypoints().len()).filter_map(|keypoint| view.point_of(keypoint)) {
                let stride = map.track_length(point).div_ceil(MAX_IMAGES_PER_TRACK).max(1);
                // Both images of a pair find each other, because their positions have the same remainder.
                let own = map.track(point).position(|o| o.image as usize == image).unwrap_or(0);
                for o in map.track(point).skip(own % stride).step_by(stride) {
                    *shared.entry(o.image).or_default() += stride as u32;
                }
            }
            shared.remove(&(image as u32));
            let mut shared: Vec<(u32, u32)> = shared.into_iter().collect();
            shared.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
            shared.truncate(MAX_NEIGHBOURS);
            shared
        };
        Self::of_lists((0..map.image_count()).into_par_iter().map(strongest).collect())
    }

    /// From the lists of each image; a pair that only one image found counts.
    pub(super) fn of_lists(lists: Vec<Vec<(u32, u32)>>) -> Self {
        let mut neighbours = lists.clone();
        for (image, list) in (0_u32..).zip(&lists) {
            for (other, count) in list {
                neighbours[*other as usize].push((image, *count));
            }
        }
        for list in &mut neighbours {
            list.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(b.1.cmp(&a.1)));
            list.dedup_by_key(|(other, _)| *other);
        }
        Self { neighbours }
    }

    /// The neighbours of an image, in ascending order, with the number of shared points.
    pub(super) fn neighbours(&self, image: u32) -> impl ExactSizeIterator<Item = (u32, u32)> {
        self.neighbours[image as usize].iter().copied()
    }

    /// Sum of the shared points of this image over its neighbours.
    pub(super) fn sum(&self, image: u32) -> u64 {
        self.neighbours(image).map(|(_, count)| u64::from(count)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_symmetric_with_the_greater_count() {
        let shared = Covisibility::of_lists(vec![vec![(2, 5)], vec![(2, 7)], vec![(0, 6)], vec![]]);
        let of = |image| shared.neighbours(image).collect::<Vec<_>>();
        assert_eq!(of(0), [(2, 6)]);
        assert_eq!(of(1), [(2, 7)]);
        assert_eq!(of(2), [(0, 6), (1, 7)]);
        assert_eq!((of(3).len(), shared.sum(2)), (0, 13));
    }
}
