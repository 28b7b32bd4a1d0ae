//! Positions in an image: in pixels, or on the plane at `z = 1`.

use nalgebra::{Vector2, Vector3};

use crate::frames::{Camera, Point3};

/// A position in an image, COLMAP's convention: the centre of the first pixel is (0.5, 0.5).
///
/// Positions of programs that put it at (0, 0) (OpenCV, hloc's keypoint files, 7Scenes) are converted with
/// [`Pixel::from_center_at_zero`] when they are read, and nowhere else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pixel {
    /// To the right.
    pub u: f64,
    /// Down.
    pub v: f64,
}

impl Pixel {
    /// The position `(u, v)`.
    pub const fn new(u: f64, v: f64) -> Self {
        Self { u, v }
    }

    /// From coordinates with their origin at the centre of the first pixel, as in OpenCV.
    pub const fn from_center_at_zero(x: f64, y: f64) -> Self {
        Self { u: x + 0.5, v: y + 0.5 }
    }

    /// Coordinates with their origin at the centre of the first pixel: the inverse.
    pub const fn center_at_zero(&self) -> [f64; 2] {
        [self.u - 0.5, self.v - 0.5]
    }

    /// As a vector, for arithmetic.
    pub const fn vector(&self) -> Vector2<f64> {
        Vector2::new(self.u, self.v)
    }

    /// Homogeneous coordinates `(u, v, 1)`.
    pub const fn homogeneous(&self) -> Vector3<f64> {
        Vector3::new(self.u, self.v, 1.0)
    }

    /// Distance in pixels.
    pub fn distance(&self, other: &Self) -> f64 {
        (self.u - other.u).hypot(self.v - other.v)
    }

    /// True when both numbers are finite.
    pub const fn is_finite(&self) -> bool {
        self.u.is_finite() && self.v.is_finite()
    }
}

/// A position on the plane `z = 1` of the camera, independent of intrinsics and distortion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanePoint {
    /// Along the camera's `x` axis.
    pub x: f64,
    /// Along the camera's `y` axis.
    pub y: f64,
}

impl PlanePoint {
    /// The position `(x, y, 1)`.
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// Intersection of the ray to a point with the plane; `None` when the point is not in front of the camera.
    pub fn from_camera_point(point: &Point3<Camera>) -> Option<Self> {
        let z = point.depth();
        (z > 0.0).then(|| Self::new(point.coords.x / z, point.coords.y / z))
    }

    /// Homogeneous coordinates `(x, y, 1)`: the ray, not of unit length.
    pub const fn homogeneous(&self) -> Vector3<f64> {
        Vector3::new(self.x, self.y, 1.0)
    }

    /// The ray as a unit vector in the camera frame.
    pub fn bearing(&self) -> Vector3<f64> {
        self.homogeneous().normalize()
    }
}
