//! Read access to a map, optionally with one image left out.

use std::collections::BTreeMap;

use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;

use super::view::{ImageView, MapFile};
use crate::compressed::PointSummary;
use crate::model::{Observation, PointId};

/// The changes of a map when one of its images is left out.
#[derive(Debug, Clone, PartialEq)]
pub struct LeaveOneOut {
    /// Index of the image.
    pub image: usize,
    /// The points that the image observes, as they are without it; `None` for a removed point. All other points are
    /// unchanged.
    pub points: BTreeMap<PointId, Option<LeaveOneOutPoint>>,
}

/// A point without the observation of the image that was left out.
#[derive(Debug, Clone, PartialEq)]
pub struct LeaveOneOutPoint {
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

/// A map file, whole or with one image left out. Indices of images and points are those of the file.
///
/// The left-out image is not among [`Self::images`], and its points are as if it had never been in the map.
#[derive(Debug, Clone, Copy)]
pub struct MapView<'a> {
    map: &'a MapFile,
    without: Option<&'a LeaveOneOut>,
}

impl<'a> From<&'a MapFile> for MapView<'a> {
    /// The whole map.
    fn from(map: &'a MapFile) -> Self {
        Self { map, without: None }
    }
}

impl<'a> MapView<'a> {
    /// The map without one image.
    pub const fn without(map: &'a MapFile, without: &'a LeaveOneOut) -> Self {
        Self { map, without: Some(without) }
    }

    /// The underlying file, including the left-out image.
    pub const fn file(&self) -> &'a MapFile {
        self.map
    }

    /// Whether localization is impossible: no image, or no point.
    pub fn is_empty(&self) -> bool {
        self.images().next().is_none() || self.map.point_count() == 0
    }

    /// The images except the left-out one, with their indices, in order.
    pub fn images(&self) -> impl Iterator<Item = (usize, ImageView<'a>)> {
        let view = *self;
        self.map.images().enumerate().filter(move |(index, _)| !view.is_left_out(*index))
    }

    /// Whether the image with this index is left out.
    pub fn is_left_out(&self, image: usize) -> bool {
        self.without.is_some_and(|w| w.image == image)
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

    /// Evidence for a point that the left-out image observes; `None` for all others.
    fn evidence(&self, id: PointId) -> Option<&'a PointEvidence> {
        self.changed(id).and_then(|point| point.as_ref()).map(|point| &point.evidence)
    }

    /// The changed state of a point that the left-out image observes.
    fn changed(&self, id: PointId) -> Option<&'a Option<LeaveOneOutPoint>> {
        self.without.and_then(|w| w.points.get(&id))
    }
}
