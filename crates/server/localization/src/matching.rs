//! Pairs of query rows and map points: matched here through the retrieved images, or by the device with its pack.

use std::collections::BTreeMap;

use veiloc_descriptor::{DescriptorView, MatchOptions, PointImage, match_images};
use veiloc_map::{ImageView, MapFile, MapView, PackPoints, PointId};
use veiloc_pose::{MatchViewpoint, Stop};
use veiloc_protocol::RowMatches;

use crate::retrieval::RetrievedImage;

/// A match of a query row and a map point, with its evidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointMatch {
    /// Row of the query.
    pub query: usize,
    /// The map point.
    pub point: PointId,
    /// What speaks for the match before geometry.
    pub evidence: PairEvidence,
    /// Index of the map image that shows the point as the query does.
    pub image: usize,
}

/// What speaks for a match before geometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PairEvidence {
    /// Descriptors of the query were matched with those of map images.
    Descriptors {
        /// Smallest ratio of nearest to second-nearest descriptor distance among the images that propose the pair.
        ratio: f32,
        /// Number of retrieved images that propose the pair.
        votes: u32,
    },
    /// The device matched, and states the probability.
    Device(f64),
}

impl PointMatch {
    /// Viewpoint of [`Self::image`].
    pub fn viewpoint(&self, map: &MapFile) -> MatchViewpoint {
        let image = map.image(self.image);
        MatchViewpoint {
            center: image.cam_from_world().center(),
            focal_px: image.camera().pinhole().focal[0],
        }
    }
}

/// An image of a map in which something may be left out.
struct SeenImage<'a>(MapView<'a>, ImageView<'a>);

impl PointImage for SeenImage<'_> {
    type Point = PointId;

    fn descriptors(&self) -> DescriptorView<'_> {
        self.1.descriptors()
    }

    fn point_of(&self, row: usize) -> Option<PointId> {
        self.0.point_of(&self.1, row)
    }
}

/// Matches the query with each retrieved image; the result is sorted by query row, then point.
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
    let images = retrieved
        .iter()
        .take_while(|_| !stop.is_set())
        .map(|found| (found.image, SeenImage(map, map.file().image(found.image))));
    let with_evidence = |m: veiloc_descriptor::PointMatch<PointId>| PointMatch {
        query: m.query,
        point: m.point,
        evidence: PairEvidence::Descriptors { ratio: m.ratio, votes: m.votes },
        image: m.image,
    };
    match_images(query, images, options).into_iter().map(with_evidence).collect()
}

/// The matches that a device made with the pack of this map, and the map images that see most of them, best first:
/// instead of retrieval, which needs descriptors. A point's image is the first of these that sees it.
pub(crate) fn matches_of_device(
    matches: &RowMatches,
    points: &PackPoints,
    map: MapView<'_>,
    count: usize,
) -> (Vec<PointMatch>, Vec<RetrievedImage>) {
    let known = matches.rows().iter().enumerate().filter_map(|(row, candidate)| {
        let point = points.point(candidate.point)?;
        (map.seen_by(point) > 0).then_some((row, point, candidate.weight.probability()))
    });
    let pairs: Vec<(usize, PointId, f64)> = known.collect();
    let images_of = |point: PointId| {
        map.file().track(point).map(|seen| seen.image as usize).filter(|image| !map.is_left_out(*image))
    };
    let mut support: BTreeMap<usize, f64> = BTreeMap::new();
    for (_, point, probability) in &pairs {
        for image in images_of(*point) {
            *support.entry(image).or_default() += probability;
        }
    }
    let of = |image: &usize| support.get(image).copied().unwrap_or_default();
    let best_image = |point: PointId| images_of(point).max_by(|a, b| of(a).total_cmp(&of(b)).then(b.cmp(a)));
    let with_image = |(query, point, probability): (usize, PointId, f64)| {
        let evidence = PairEvidence::Device(probability);
        Some(PointMatch { query, point, evidence, image: best_image(point)? })
    };
    let found = pairs.into_iter().filter_map(with_image).collect();
    let mut ranked: Vec<(usize, f64)> = support.iter().map(|(image, sum)| (*image, *sum)).collect();
    ranked.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let rows = matches.rows().len().max(1) as f64;
    let retrieved = ranked
        .into_iter()
        .take(count)
        .map(|(image, sum)| RetrievedImage { image, similarity: (sum / rows).min(1.0) as f32 });
    (found, retrieved.collect())
}
