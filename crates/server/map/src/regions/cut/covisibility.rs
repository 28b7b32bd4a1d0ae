//! How many points two images share.

use std::collections::BTreeMap;

use crate::MapFile;
use rayon::prelude::*;

/// Images that an image is compared with through one point: a track of a thousand would count a million pairs. Of a longer
/// track every so many images count, each for as many.
const THROUGH_ONE_POINT: usize = 64;

/// Neighbours that are kept of an image: those that share most with it.
const NEIGHBOURS: usize = 64;

/// The points that images share, of each image with those that it shares most with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Covisibility {
    /// `[I]`, other images and shared points, in rising order of the image; each pair stands at both.
    neighbours: Vec<Vec<(u32, u32)>>,
}

impl Covisibility {
    pub(super) fn of(map: &MapFile) -> Self {
        let strongest = |image: usize| {
            let mut shared: BTreeMap<u32, u32> = BTreeMap::new();
            let view = map.image(image);
            for point in (0..view.keypoints().len()).filter_map(|keypoint| view.point_of(keypoint)) {
                let stride = map.track_length(point).div_ceil(THROUGH_ONE_POINT).max(1);
                // Both images of a pair find each other: they stand at the same remainder.
                let own = map.track(point).position(|o| o.image as usize == image).unwrap_or(0);
                for o in map.track(point).skip(own % stride).step_by(stride) {
                    *shared.entry(o.image).or_default() += stride as u32;
                }
            }
            shared.remove(&(image as u32));
            let mut shared: Vec<(u32, u32)> = shared.into_iter().collect();
            shared.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
            shared.truncate(NEIGHBOURS);
            shared
        };
        Self::of_lists((0..map.image_count()).into_par_iter().map(strongest).collect())
    }

    /// Of what each image found; a pair that one of them found is one.
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

    /// The images that share points with this one, in rising order, and how many.
    pub(super) fn neighbours(&self, image: u32) -> impl ExactSizeIterator<Item = (u32, u32)> {
        self.neighbours[image as usize].iter().copied()
    }

    /// Points that this image shares with all others together.
    pub(super) fn sum(&self, image: u32) -> u64 {
        self.neighbours(image).map(|(_, count)| u64::from(count)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_stands_at_both_by_its_greater_count() {
        let shared = Covisibility::of_lists(vec![vec![(2, 5)], vec![(2, 7)], vec![(0, 6)], vec![]]);
        let of = |image| shared.neighbours(image).collect::<Vec<_>>();
        assert_eq!(of(0), [(2, 6)]);
        assert_eq!(of(1), [(2, 7)]);
        assert_eq!(of(2), [(0, 6), (1, 7)]);
        assert_eq!((of(3).len(), shared.sum(2)), (0, 13));
    }
}
