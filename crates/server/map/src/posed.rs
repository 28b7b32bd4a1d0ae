//! Posed images: the input of mapping, from any source of poses.

use std::collections::BTreeMap;

use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};

use crate::error::{MapError, ModelRecord};
use crate::model::{is_name, is_rigid};

/// An image with its camera and its pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedImage {
    /// File name, relative to the folder of the images; unique among the images.
    pub name: String,
    /// Its camera. Images of the same camera have equal values.
    pub camera: Intrinsics,
    /// Its pose.
    pub cam_from_world: CameraFromWorld,
    /// Indices of the [`PosedImages::points`] that it observes, as far as known; may be empty.
    pub seen: Vec<u32>,
}

/// Images with cameras and poses in one world frame, and optionally some points that they observe.
///
/// The points only help to select image pairs; they do not become points of a map. A COLMAP model converts into this
/// type, with or without points.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PosedImages {
    images: Vec<PosedImage>,
    points: Vec<Point3<World>>,
    by_name: BTreeMap<String, usize>,
    remarks: Vec<String>,
}

impl PosedImages {
    /// From images and the points to which [`PosedImage::seen`] refers; the points may be empty.
    ///
    /// # Errors
    /// [`MapError::PosedImages`] with the image or point: an invalid or repeated name, an invalid pose, a non-finite
    /// or missing point.
    pub fn new(images: Vec<PosedImage>, points: Vec<Point3<World>>) -> Result<Self, MapError> {
        let refuse = |record: ModelRecord, reason: &str| {
            Err(MapError::PosedImages { record, reason: reason.to_owned() })
        };
        if let Some(id) = points.iter().position(|p| !p.is_finite()) {
            return refuse(ModelRecord::Point(id as u64), "is not finite; leave it out");
        }
        for image in &images {
            let this = || ModelRecord::Image(image.name.clone());
            if !is_name(&image.name) {
                return refuse(this(), "has no usable file name; give it one");
            }
            if !is_rigid(&image.cam_from_world) {
                return refuse(this(), "has a pose that is not finite or turns by no rotation; leave it out");
            }
            if image.seen.iter().any(|id| *id as usize >= points.len()) {
                return refuse(this(), "sees a point that is not there");
            }
        }
        let count = images.len();
        let posed = Self::indexed(images, points);
        if posed.by_name.len() < count {
            let mut twice = posed.images.iter().enumerate();
            let twice = twice.find(|(i, image)| posed.by_name.get(&image.name) != Some(i));
            let name = twice.map(|(_, image)| image.name.clone()).unwrap_or_default();
            return refuse(ModelRecord::Image(name), "appears twice; keep one of them");
        }
        Ok(posed)
    }

    /// From parts that are known to be consistent.
    pub(crate) fn indexed(images: Vec<PosedImage>, points: Vec<Point3<World>>) -> Self {
        let by_name = images.iter().enumerate().map(|(index, image)| (image.name.clone(), index)).collect();
        Self { images, points, by_name, remarks: Vec::new() }
    }

    /// The same images with other remarks, for readers of other formats.
    #[must_use]
    pub fn with_remarks(self, remarks: Vec<String>) -> Self {
        Self { remarks, ..self }
    }

    /// What reading left out or changed, for people; empty if everything was taken as it is.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// All images, in the order given.
    pub fn images(&self) -> &[PosedImage] {
        &self.images
    }

    /// The image with this name.
    pub fn get(&self, name: &str) -> Option<&PosedImage> {
        self.by_name.get(name).map(|index| &self.images[*index])
    }

    /// Points that images observe, map units.
    pub fn points(&self) -> &[Point3<World>] {
        &self.points
    }

    /// Names of all images, in order.
    pub fn names(&self) -> Vec<String> {
        self.images.iter().map(|i| i.name.clone()).collect()
    }
}

#[cfg(test)]
mod tests {
    use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector3};

    use super::*;

    fn image(name: &str, seen: &[u32]) -> PosedImage {
        PosedImage {
            name: name.to_owned(),
            camera: "PINHOLE,640,480,500,500,320,240".parse().unwrap(),
            cam_from_world: CameraFromWorld::identity(),
            seen: seen.to_vec(),
        }
    }

    #[test]
    fn inconsistent_images_are_named() {
        let here = Point3::new(1.0, 2.0, 3.0);
        let posed = PosedImages::new(vec![image("a.jpg", &[0]), image("b.jpg", &[])], vec![here]).unwrap();
        assert_eq!(posed.get("b.jpg").map(|i| i.name.as_str()), Some("b.jpg"));
        assert_eq!(posed.names(), ["a.jpg", "b.jpg"]);
        assert!(posed.get("c.jpg").is_none());

        let mut nan = image("a.jpg", &[]);
        nan.cam_from_world = nan.cam_from_world.perturbed(&[0.0, 0.0, 0.0, f64::NAN, 0.0, 0.0]);
        let mut mirrored = image("a.jpg", &[]);
        mirrored.cam_from_world =
            CameraFromWorld::new(Rotation3::from_matrix_unchecked(-Matrix3::identity()), Vector3::zeros());
        type Case = (Vec<PosedImage>, Vec<Point3<World>>, &'static str);
        let bad: [Case; 6] = [
            (vec![image("a.jpg", &[]), image("a.jpg", &[])], vec![], "\"a.jpg\" appears twice"),
            (vec![image("", &[])], vec![], "no usable file name"),
            (vec![nan], vec![], "\"a.jpg\" has a pose"),
            (vec![mirrored], vec![], "turns by no rotation"),
            (vec![image("a.jpg", &[1])], vec![here], "a point that is not there"),
            (vec![], vec![Point3::new(f64::NAN, 0.0, 0.0)], "point 0 is not finite"),
        ];
        for (images, points, expected) in bad {
            let error = PosedImages::new(images, points).unwrap_err();
            assert!(matches!(error, MapError::PosedImages { .. }), "{error}");
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
}
