//! One image for geometry: pose, undistorted keypoints, and thresholds in its own pixels.

use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel, PlanePoint, Point3};

/// An image whose pose is known. Errors are measured in undistorted pixels, where lines are straight and the
/// derivative of the projection is simple; within a few pixels of a keypoint they equal those of the image.
#[derive(Debug, Clone)]
pub(crate) struct View {
    pub(crate) camera: Intrinsics,
    pub(crate) cam_from_world: CameraFromWorld,
    /// Projection centre in the world.
    pub(crate) center: Vector3<f64>,
    /// `R` of the pose.
    rotation: Matrix3<f64>,
    /// `t` of the pose.
    translation: Vector3<f64>,
    focal: Vector2<f64>,
    /// Keypoints on the plane `z = 1`; `None` if the distortion cannot be inverted.
    pub(crate) plane: Vec<Option<Vector2<f64>>>,
    /// Largest reprojection error of an observation, pixels.
    pub(crate) max_error: f64,
    /// Largest distance from an epipolar line, pixels.
    pub(crate) max_epipolar_error: f64,
}

impl View {
    /// Creates a view from an image's parts; thresholds are in its pixels.
    pub(crate) fn new(
        camera: Intrinsics,
        cam_from_world: CameraFromWorld,
        keypoints: &[[f32; 2]],
        max_error: f64,
        max_epipolar_error: f64,
    ) -> Self {
        let plane = |[u, v]: &[f32; 2]| {
            let p = camera.unproject(Pixel::new(f64::from(*u), f64::from(*v)))?;
            Some(Vector2::new(p.x, p.y))
        };
        Self {
            center: cam_from_world.center().coords,
            rotation: *cam_from_world.rotation().matrix(),
            translation: *cam_from_world.translation(),
            focal: Vector2::from(camera.pinhole().focal),
            plane: keypoints.iter().map(plane).collect(),
            camera,
            cam_from_world,
            max_error,
            max_epipolar_error,
        }
    }

    /// The same image with another pose and a scaled focal length; keypoints are undistorted as before.
    pub(crate) fn with(&self, cam_from_world: CameraFromWorld, focal_scale: f64) -> Self {
        Self {
            center: cam_from_world.center().coords,
            rotation: *cam_from_world.rotation().matrix(),
            translation: *cam_from_world.translation(),
            cam_from_world,
            focal: self.focal * focal_scale,
            plane: self.plane.iter().map(|p| p.map(|p| p / focal_scale)).collect(),
            ..self.clone()
        }
    }

    /// Geometric mean of the focal lengths, pixels.
    pub(crate) fn mean_focal(&self) -> f64 {
        (self.focal.x * self.focal.y).sqrt()
    }

    /// A point in the camera's frame.
    pub(crate) fn in_camera(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// Ray of a position on the plane `z = 1`, in the world frame, not normalized: its parameter is the depth.
    pub(crate) fn ray(&self, plane: &Vector2<f64>) -> Vector3<f64> {
        self.rotation.tr_mul(&Vector3::new(plane.x, plane.y, 1.0))
    }

    /// Projection minus keypoint, undistorted pixels; `None` if the point is not in front of the camera.
    pub(crate) fn residual(&self, plane: &Vector2<f64>, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let x = self.in_camera(point);
        (x.z > 0.0).then(|| (x.xy() / x.z - plane).component_mul(&self.focal))
    }

    /// The same with its derivative with respect to the point, `[2, 3]` as two rows.
    pub(crate) fn residual_and_rows(
        &self,
        plane: &Vector2<f64>,
        point: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, [Vector3<f64>; 2])> {
        let x = self.in_camera(point);
        if x.z <= 0.0 {
            return None;
        }
        let p = x.xy() / x.z;
        let r = &self.rotation;
        let row = |i: usize| (r.row(i) - r.row(2) * p[i]).transpose() * (self.focal[i] / x.z);
        Some(((p - plane).component_mul(&self.focal), [row(0), row(1)]))
    }

    /// Position of a point in the image, distorted; `None` if it is not in front of the camera or outside the image.
    pub(crate) fn pixel_inside(&self, point: &Vector3<f64>) -> Option<Pixel> {
        let p = PlanePoint::from_camera_point(
            &self.cam_from_world.transform(&Point3::<World>::from_vector(*point)),
        )?;
        // Far outside, a polynomial distortion may fold back into the image.
        let pinhole = self.camera.pinhole();
        let margin = f64::from(pinhole.width.max(pinhole.height)) / 2.0;
        if !pinhole.contains(pinhole.project(p), margin) {
            return None;
        }
        let pixel = self.camera.project(p);
        pinhole.contains(pixel, 0.0).then_some(pixel)
    }

    /// Distance of a point's projection from a keypoint in the image, distorted pixels.
    pub(crate) fn error_in_image(&self, keypoint: [f32; 2], point: &Vector3<f64>) -> Option<f64> {
        let p = PlanePoint::from_camera_point(
            &self.cam_from_world.transform(&Point3::<World>::from_vector(*point)),
        )?;
        Some(self.camera.project(p).distance(&Pixel::new(f64::from(keypoint[0]), f64::from(keypoint[1]))))
    }
}
