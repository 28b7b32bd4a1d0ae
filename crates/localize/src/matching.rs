//! Query descriptors to map points, through the retrieved images.

use std::collections::BTreeMap;

use veiloc_descriptor::{DescriptorView, MatchOptions, match_descriptors};
use veiloc_map::{MapFile, PointId};

use crate::retrieval::Retrieved;

/// A query descriptor paired with a map point, and what speaks for the pair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointMatch {
    /// Row of the query.
    pub query: usize,
    /// The map point.
    pub point: PointId,
    /// Smallest ratio of nearest to second-nearest descriptor distance among the images that propose the pair.
    pub ratio: f32,
    /// How many retrieved images propose the pair.
    pub votes: u32,
}

/// Matches the query with every retrieved image on its own, as hloc does, and joins the pairs that agree.
///
/// An image's keypoints that have no map point take part in the nearest-neighbour search, so that they draw away the
/// descriptors that belong to them; their matches are then dropped. The result is sorted by query row, then point.
pub fn match_points(
    query: DescriptorView<'_>,
    map: &MapFile,
    retrieved: &[Retrieved],
    options: &MatchOptions,
) -> Vec<PointMatch> {
    let mut joined: BTreeMap<(usize, PointId), PointMatch> = BTreeMap::new();
    for Retrieved { image, .. } in retrieved {
        let image = map.image(*image);
        for m in match_descriptors(query, image.descriptors(), options) {
            let Some(point) = image.point_of(m.database as usize) else { continue };
            let query = m.query as usize;
            joined
                .entry((query, point))
                .and_modify(|known| {
                    known.votes += 1;
                    known.ratio = known.ratio.min(m.ratio);
                })
                .or_insert(PointMatch { query, point, ratio: m.ratio, votes: 1 });
        }
    }
    joined.into_values().collect()
}
