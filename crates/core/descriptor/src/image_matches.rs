//! Matches of a query with the points of several images.

use std::collections::BTreeMap;

use crate::{DescriptorView, MatchOptions, match_descriptors};

/// An image whose rows may belong to points.
pub trait PointImage {
    /// Names a point in all images.
    type Point: Ord + Copy;

    /// `[N, dim]`
    fn descriptors(&self) -> DescriptorView<'_>;

    /// The point of row `row`, which must be below N.
    fn point_of(&self, row: usize) -> Option<Self::Point>;
}

/// A match of a query descriptor and a point, with its evidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointMatch<P> {
    /// Row of the query.
    pub query: usize,
    /// The point.
    pub point: P,
    /// Smallest ratio of nearest to second-nearest descriptor distance among the images that propose the pair.
    pub ratio: f32,
    /// Number of images that propose the pair.
    pub votes: u32,
    /// Index of the image with this ratio.
    pub image: usize,
}

/// Matches the query with each image separately, as hloc does, and merges equal pairs. `images` gives each image with
/// its index; the result is sorted by query row, then point.
///
/// Rows without a point take part in the nearest-neighbour search, so that their descriptors do not match other points;
/// their matches are dropped.
pub fn match_images<I: PointImage>(
    query: DescriptorView<'_>,
    images: impl IntoIterator<Item = (usize, I)>,
    options: &MatchOptions,
) -> Vec<PointMatch<I::Point>> {
    let mut joined: BTreeMap<(usize, I::Point), PointMatch<I::Point>> = BTreeMap::new();
    for (index, image) in images {
        for m in match_descriptors(query, image.descriptors(), options) {
            let Some(point) = image.point_of(m.database as usize) else { continue };
            let query = m.query as usize;
            joined
                .entry((query, point))
                .and_modify(|known| {
                    known.votes += 1;
                    if m.ratio < known.ratio {
                        (known.ratio, known.image) = (m.ratio, index);
                    }
                })
                .or_insert(PointMatch { query, point, ratio: m.ratio, votes: 1, image: index });
        }
    }
    joined.into_values().collect()
}

/// Images that a query is matched with, on devices and servers: as in hloc for scenes of this size. More cost time, fewer
/// cost recall.
pub const RETRIEVED_IMAGES: usize = 10;

/// How many images after the retrieved ones may be of another place.
pub const RANKS_OF_OTHER_PLACES: usize = 100;

/// Of the images after the first `count` that look nearly as much like a query, those that show another place: up to
/// [`OTHER_IMAGES`] that share hardly any point with the first ones.
///
/// Without them the matches hold one of two places that look alike, the one that was photographed from nearer viewpoints,
/// and nothing of the other. `ranked`: images with their similarity to the query, of any scale, best first. `points`: those
/// that an image sees.
pub fn images_of_other_places<P: Ord + Copy>(
    ranked: &[(usize, f32)],
    count: usize,
    points: impl Fn(usize) -> Vec<P>,
) -> Vec<usize> {
    let (chosen, further) = ranked.split_at(count.min(ranked.len()));
    let least = chosen.first().map_or(0.0, |best| MIN_SIMILARITY_SHARE * best.1);
    let is_alike = |image: &&(usize, f32)| least > 0.0 && image.1 >= least;
    let mut further = further.iter().take(RANKS_OF_OTHER_PLACES).take_while(is_alike).peekable();
    if further.peek().is_none() {
        return Vec::new();
    }
    let mut seen: Vec<P> = chosen.iter().flat_map(|image| points(image.0)).collect();
    seen.sort_unstable();
    let is_elsewhere = |image: &usize| {
        let own = points(*image);
        // A sample decides: covisible images share a large part of their points.
        let sample = || own.iter().step_by(own.len().div_ceil(MAX_SAMPLE).max(1));
        let shared = sample().filter(|point| seen.binary_search(point).is_ok()).count();
        !own.is_empty() && shared * 50 < sample().count()
    };
    further.map(|image| image.0).filter(is_elsewhere).take(OTHER_IMAGES).collect()
}

/// Least similarity of an added image, as a share of that of the most similar image. Images of other places had at most
/// 0.30 of it on RedKitchen, 0.46 on tum-fr1-rpy, and 0.73 on hololens-office (rooms with equal furniture).
const MIN_SIMILARITY_SHARE: f32 = 0.7;

/// Images of other places that are added.
const OTHER_IMAGES: usize = 3;

/// Points of an image that are compared with those of the chosen ones.
const MAX_SAMPLE: usize = 200;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::random_descriptors;
    use crate::{DescriptorKind, Descriptors};

    struct Own(Descriptors, Vec<Option<u8>>);

    impl PointImage for &Own {
        type Point = u8;

        fn descriptors(&self) -> DescriptorView<'_> {
            self.0.view()
        }

        fn point_of(&self, row: usize) -> Option<u8> {
            self.1[row]
        }
    }

    #[test]
    fn equal_pairs_are_merged_and_rows_without_points_dropped() {
        let rows = random_descriptors(4, 9);
        let first = Own(rows.select([0, 1, 2]), vec![Some(7), None, Some(5)]);
        let second = Own(rows.select([2, 0]), vec![Some(5), Some(8)]);
        let found = match_images(rows.view(), [(3, &first), (6, &second)], &MatchOptions::default());
        let pairs: Vec<_> = found.iter().map(|m| (m.query, m.point, m.votes, m.image)).collect();
        assert_eq!(pairs, [(0, 7, 1, 3), (0, 8, 1, 6), (2, 5, 2, 3)]);
        let none = Own(Descriptors::empty(DescriptorKind::ROOT_SIFT), Vec::new());
        assert_eq!(match_images(rows.view(), [(0, &none)], &MatchOptions::default()), []);
    }

    #[test]
    fn images_of_other_places_share_no_points() {
        // Images 0 and 1 see points below 100, image 2 half of them, images 3 and 4 others.
        let points = |image: usize| -> Vec<u32> {
            match image {
                0 | 1 => (0..100).collect(),
                2 => (50..150).collect(),
                3 => Vec::new(),
                _ => (1000..1100).collect(),
            }
        };
        let others = |images: &[usize], similarity: f32| {
            let further = images.iter().map(|image| (*image, similarity));
            let ranked: Vec<(usize, f32)> = std::iter::once((0, 1.0)).chain(further).collect();
            images_of_other_places(&ranked, 1, points)
        };
        assert_eq!(others(&[1, 2, 3, 4], 0.7), [4]);
        assert_eq!(others(&[], 0.7), []);
        assert_eq!(others(&[4, 5, 6, 7], 0.7).len(), OTHER_IMAGES);
        assert_eq!(others(&[4, 5, 6, 7], 0.69), []);
    }
}
