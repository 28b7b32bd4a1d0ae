//! Read access to a map, optionally with some images left out.

use std::collections::{BTreeMap, BTreeSet};

use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;

use super::view::{ImageView, MapFile};
use crate::compressed::PointSummary;
use crate::model::{Observation, PointId};

/// The changes of a map when some of its images are left out.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOut {
    /// Indices of the images.
    pub images: BTreeSet<usize>,
    /// The points that these images observe, as they are without them; `None` for a removed point. All other points
    /// are unchanged.
    pub points: BTreeMap<PointId, Option<HeldOutPoint>>,
}

/// A point without the observations of the images that were left out.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOutPoint {
    /// Position, map units.
    pub position: Point3<World>,
    /// The remaining evidence for the position.
    pub evidence: PointEvidence,
}

/// Evidence for the position of a point.
#[derive(Debug, Clone, PartialEq)]
pub enum PointEvidence {
    /// Its observations, in ascending order.
    Track(Vec<Observation>),
    /// The summary of the whole map, in a compressed map.
    Summary(PointSummary),
}

/// A map file, whole or with some images left out. Indices of images and points are those of the file.
///
/// The left-out images are not among [`Self::images`], and their points are as if they had never been in the map.
#[derive(Debug, Clone, Copy)]
pub struct MapView<'a> {
    map: &'a MapFile,
    without: Option<&'a HeldOut>,
}

impl<'a> From<&'a MapFile> for MapView<'a> {
    /// The whole map.
    fn from(map: &'a MapFile) -> Self {
        Self { map, without: None }
    }
}

impl<'a> MapView<'a> {
    /// The map without these images.
    pub const fn without(map: &'a MapFile, without: &'a HeldOut) -> Self {
        Self { map, without: Some(without) }
    }

    /// The underlying file, including the left-out images.
    pub const fn file(&self) -> &'a MapFile {
        self.map
    }

    /// Whether localization is impossible: no image, or no point.
    pub fn is_empty(&self) -> bool {
        self.images().next().is_none() || self.map.point_count() == 0
    }

    /// The images except the left-out ones, with their indices, in order.
    pub fn images(&self) -> impl Iterator<Item = (usize, ImageView<'a>)> {
        let view = *self;
        self.map.images().enumerate().filter(move |(index, _)| !view.is_left_out(*index))
    }

    /// Whether the image with this index is left out.
    pub fn is_left_out(&self, image: usize) -> bool {
        self.without.is_some_and(|w| w.images.contains(&image))
    }

    /// The point that a keypoint observes, if it exists. The image must not be left out.
    pub fn point_of(&self, image: &ImageView<'a>, keypoint: usize) -> Option<PointId> {
        image.point_of(keypoint).filter(|id| !matches!(self.changed(*id), Some(None)))
    }

    /// Position of a point, map units; a removed point keeps its position.
    pub fn point(&self, id: PointId) -> Point3<World> {
        match self.changed(id) {
            Some(Some(point)) => point.position,
            _ => self.map.point(id),
        }
    }

    /// Number of images that observe a point; in a compressed map, of the whole map.
    pub fn seen_by(&self, id: PointId) -> usize {
        match self.evidence(id) {
            Some(PointEvidence::Track(track)) => track.len(),
            Some(PointEvidence::Summary(summary)) => summary.seen_by as usize,
            None => self.map.seen_by(id),
        }
    }

    /// Covariance of a point's position; see [`MapFile::point_covariance`].
    pub fn point_covariance(&self, id: PointId) -> [[f64; 3]; 3] {
        match self.evidence(id) {
            Some(PointEvidence::Track(track)) => {
                self.map.covariance_of(&self.point(id), track.iter().copied())
            }
            Some(PointEvidence::Summary(summary)) => summary.covariance(),
            None => self.map.point_covariance(id),
        }
    }

    /// Evidence for a point that a left-out image observes; `None` for all others.
    fn evidence(&self, id: PointId) -> Option<&'a PointEvidence> {
        self.changed(id).and_then(|point| point.as_ref()).map(|point| &point.evidence)
    }

    /// The changed state of a point that a left-out image observes.
    fn changed(&self, id: PointId) -> Option<&'a Option<HeldOutPoint>> {
        self.without.and_then(|w| w.points.get(&id))
    }
}
