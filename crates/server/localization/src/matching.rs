//! Matches query descriptors with map points through the retrieved images.

use std::collections::BTreeMap;

use veiloc_descriptor::{DescriptorView, MatchOptions, match_descriptors};
use veiloc_map::{MapFile, MapView, PointId};
use veiloc_pose::{MatchViewpoint, Stop};

use crate::retrieval::RetrievedImage;

/// A match of a query descriptor and a map point, with its evidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointMatch {
    /// Row of the query.
    pub query: usize,
    /// The map point.
    pub point: PointId,
    /// Smallest ratio of nearest to second-nearest descriptor distance among the images that propose the pair.
    pub ratio: f32,
    /// Number of retrieved images that propose the pair.
    pub votes: u32,
    /// Index of the map image with this ratio.
    pub image: usize,
}

impl PointMatch {
    /// Viewpoint of the image that proposes the pair with the smallest ratio.
    pub fn viewpoint(&self, map: &MapFile) -> MatchViewpoint {
        let image = map.image(self.image);
        MatchViewpoint {
            center: image.cam_from_world().center(),
            focal_px: image.camera().pinhole().focal[0],
        }
    }
}

/// Matches the query with each retrieved image separately, as hloc does, and merges equal pairs.
///
/// Keypoints without a map point take part in the nearest-neighbour search, so that their descriptors do not match
/// other points; their matches are dropped. The result is sorted by query row, then point.
pub fn match_points(
    query: DescriptorView<'_>,
    map: MapView<'_>,
    retrieved: &[RetrievedImage],
    options: &MatchOptions,
) -> Vec<PointMatch> {
    match_points_until(query, map, retrieved, options, &Stop::default())
}

/// [`match_points`] with as many images as possible until `stop` is set.
pub(crate) fn match_points_until(
    query: DescriptorView<'_>,
    map: MapView<'_>,
    retrieved: &[RetrievedImage],
    options: &MatchOptions,
    stop: &Stop,
) -> Vec<PointMatch> {
    let mut joined: BTreeMap<(usize, PointId), PointMatch> = BTreeMap::new();
    for RetrievedImage { image: index, .. } in retrieved {
        if stop.is_set() {
            break;
        }
        let image = map.file().image(*index);
        for m in match_descriptors(query, image.descriptors(), options) {
            let Some(point) = map.point_of(&image, m.database as usize) else { continue };
            let query = m.query as usize;
            joined
                .entry((query, point))
                .and_modify(|known| {
                    known.votes += 1;
                    if m.ratio < known.ratio {
                        (known.ratio, known.image) = (m.ratio, *index);
                    }
                })
                .or_insert(PointMatch { query, point, ratio: m.ratio, votes: 1, image: *index });
        }
    }
    joined.into_values().collect()
}
