//! A map as it is, or as it would be without one of its images: what localization reads.

use std::collections::BTreeMap;

use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;

use super::view::{ImageView, MapFile};
use crate::compressed::Remembered;
use crate::model::{Observation, PointId};

/// What changes in a map when one of its images is left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Without {
    /// Index of the image.
    pub image: usize,
    /// The points that it sees: as they are without it, or gone. All other points stay as they are.
    pub points: BTreeMap<PointId, Option<PointWithout>>,
}

/// A point as it is without an image that sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct PointWithout {
    /// Where, map units.
    pub position: Point3<World>,
    /// What holds it there.
    pub evidence: Evidence,
}

/// What holds a point where it is.
#[derive(Debug, Clone, PartialEq)]
pub enum Evidence {
    /// The keypoints of the map that see it, in rising order.
    Track(Vec<Observation>),
    /// What keypoints told that a compressed map no longer has.
    Remembered(Remembered),
}

/// A map file, whole or with one image left out. Indices of images and points are those of the file.
///
/// An image that is left out takes no part: it is not among [`Self::images`], and the points it sees are as they would be
/// had it never been there.
#[derive(Debug, Clone, Copy)]
pub struct MapView<'a> {
    map: &'a MapFile,
    without: Option<&'a Without>,
}

impl<'a> From<&'a MapFile> for MapView<'a> {
    /// The whole map.
    fn from(map: &'a MapFile) -> Self {
        Self { map, without: None }
    }
}

impl<'a> MapView<'a> {
    /// The map without an image.
    pub const fn without(map: &'a MapFile, without: &'a Without) -> Self {
        Self { map, without: Some(without) }
    }

    /// The file itself, image and all.
    pub const fn file(&self) -> &'a MapFile {
        self.map
    }

    /// Whether there is nothing to localize in: no image, or no point.
    pub fn is_empty(&self) -> bool {
        self.images().next().is_none() || self.map.point_count() == 0
    }

    /// The images that take part, with their indices, in order.
    pub fn images(&self) -> impl Iterator<Item = (usize, ImageView<'a>)> {
        let view = *self;
        self.map.images().enumerate().filter(move |(index, _)| !view.is_left_out(*index))
    }

    /// Whether the image with this index takes no part.
    pub fn is_left_out(&self, image: usize) -> bool {
        self.without.is_some_and(|w| w.image == image)
    }

    /// The point that a keypoint of an image sees, when it is there. The image must take part.
    pub fn point_of(&self, image: &ImageView<'a>, keypoint: usize) -> Option<PointId> {
        image.point_of(keypoint).filter(|id| !matches!(self.changed(*id), Some(None)))
    }

    /// Where a point is, map units. One that is gone is where it was.
    pub fn point(&self, id: PointId) -> Point3<World> {
        match self.changed(id) {
            Some(Some(point)) => point.position,
            _ => self.map.point(id),
        }
    }

    /// Number of images that see a point; of the whole map where this one is a compressed one.
    pub fn seen_by(&self, id: PointId) -> usize {
        match self.evidence(id) {
            Some(Evidence::Track(track)) => track.len(),
            Some(Evidence::Remembered(remembered)) => remembered.seen_by as usize,
            None => self.map.seen_by(id),
        }
    }

    /// Covariance of a point's position; see [`MapFile::point_covariance`].
    pub fn point_covariance(&self, id: PointId) -> [[f64; 3]; 3] {
        match self.evidence(id) {
            Some(Evidence::Track(track)) => self.map.covariance_of(&self.point(id), track.iter().copied()),
            Some(Evidence::Remembered(remembered)) => remembered.covariance(),
            None => self.map.point_covariance(id),
        }
    }

    /// What holds a point that the image left out sees too; `None` of all others.
    fn evidence(&self, id: PointId) -> Option<&'a Evidence> {
        self.changed(id).and_then(|point| point.as_ref()).map(|point| &point.evidence)
    }

    /// What became of a point that the image left out sees.
    fn changed(&self, id: PointId) -> Option<&'a Option<PointWithout>> {
        self.without.and_then(|w| w.points.get(&id))
    }
}
