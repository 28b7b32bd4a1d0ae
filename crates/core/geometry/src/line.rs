//! 2D lines: in the image, and on the plane at `z = 1`.
//!
//! A line is stored as homogeneous coordinates with a unit normal, `a u + b v + c = 0`, `a² + b² = 1`, so that its
//! product with `(u, v, 1)` is a signed distance. Its scale must not carry information: the norm of the plain cross
//! product of a keypoint and an anchor is the keypoint's distance from the anchor, which obfuscation must hide (leak
//! L1). Therefore the constructors always normalize.

use nalgebra::{Vector2, Vector3};

use crate::intrinsics::Pinhole;
use crate::pixel::{Pixel, PlanePoint};

/// A line in an image, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelLine {
    coefficients: Vector3<f64>,
}

impl PixelLine {
    /// The line through `point` in the direction `angle` (radians from the `u` axis towards `v`).
    pub fn through(point: Pixel, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self::from_normal(Vector2::new(-sin, cos), point)
    }

    /// The line through two points; `None` when they coincide or are not finite.
    pub fn joining(a: Pixel, b: Pixel) -> Option<Self> {
        let along = b.vector() - a.vector();
        let length = along.norm();
        (length.is_finite() && length > 1e-9)
            .then(|| Self::from_normal(Vector2::new(-along.y, along.x) / length, a))
    }

    /// From homogeneous coordinates of any scale; `None` when they have no direction or are not finite.
    pub fn from_homogeneous(coefficients: Vector3<f64>) -> Option<Self> {
        let norm = coefficients.xy().norm();
        (norm > 1e-12 && norm.is_finite() && coefficients.z.is_finite())
            .then(|| Self { coefficients: coefficients / norm })
    }

    fn from_normal(normal: Vector2<f64>, point: Pixel) -> Self {
        Self { coefficients: Vector3::new(normal.x, normal.y, -normal.dot(&point.vector())) }
    }

    /// `(a, b, c)` with `a² + b² = 1`.
    pub const fn coefficients(&self) -> &Vector3<f64> {
        &self.coefficients
    }

    /// Unit direction of the line.
    pub fn direction(&self) -> Vector2<f64> {
        Vector2::new(self.coefficients.y, -self.coefficients.x)
    }

    /// Signed distance of a pixel from the line, in pixels.
    pub fn signed_distance(&self, pixel: Pixel) -> f64 {
        self.coefficients.dot(&pixel.homogeneous())
    }

    /// The foot of the perpendicular from a pixel.
    pub fn closest_point(&self, pixel: Pixel) -> Pixel {
        let d = self.signed_distance(pixel);
        Pixel::new(pixel.u - d * self.coefficients.x, pixel.v - d * self.coefficients.y)
    }

    /// The intersection of two lines; `None` when they are parallel up to rounding.
    pub fn intersection(&self, other: &Self) -> Option<Pixel> {
        let p = self.coefficients.cross(&other.coefficients);
        (p.z.abs() > 1e-12).then(|| Pixel::new(p.x / p.z, p.y / p.z))
    }

    /// The line back-projected by a pinhole camera, `n = Kᵀ l`.
    pub fn back_project(&self, camera: &Pinhole) -> PlaneLine {
        let l = &self.coefficients;
        let n = Vector3::new(
            camera.focal[0] * l.x,
            camera.focal[1] * l.y,
            camera.principal[0] * l.x + camera.principal[1] * l.y + l.z,
        );
        PlaneLine { normal: n.normalize() }
    }
}

/// A line on the plane `z = 1`, stored as the unit normal `n` of the plane through it and the projection centre.
///
/// A map point on the line satisfies `nᵀ (R X + t) = 0`: the paper's Eq. 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneLine {
    normal: Vector3<f64>,
}

impl PlaneLine {
    /// From a normal of any length; `None` when it has no direction or is not finite.
    pub fn from_normal(normal: Vector3<f64>) -> Option<Self> {
        let norm = normal.norm();
        (norm > 1e-12 && norm.is_finite()).then(|| Self { normal: normal / norm })
    }

    /// The line through two positions; `None` when they coincide or are not finite.
    pub fn joining(a: PlanePoint, b: PlanePoint) -> Option<Self> {
        Self::from_normal(a.homogeneous().cross(&b.homogeneous()))
    }

    /// Unit normal of the back-projected plane, in the camera frame.
    pub const fn normal(&self) -> &Vector3<f64> {
        &self.normal
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_do_not_depend_on_their_points() {
        // L1: the same line from a near and from a far keypoint is equal to the last significant bit.
        let anchor = Pixel::new(320.0, 0.0);
        let toward =
            |r: f64| PixelLine::joining(anchor, Pixel::new(320.0 - 0.6 * r, 0.8 * r)).expect("apart");
        let (near, far) = (toward(10.0), toward(500.0));
        assert!((near.coefficients() - far.coefficients()).norm() < 1e-12);
        assert!((near.coefficients().xy().norm() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn distances_feet_and_crossings() {
        let line = PixelLine::through(Pixel::new(3.0, 4.0), 0.3);
        let p = Pixel::new(-7.0, 11.0);
        let foot = line.closest_point(p);
        assert!(line.signed_distance(foot).abs() < 1e-12);
        assert!((foot.distance(&p) - line.signed_distance(p).abs()).abs() < 1e-12);
        let other = PixelLine::through(Pixel::new(3.0, 4.0), 1.9);
        assert!(line.intersection(&other).expect("cross").distance(&Pixel::new(3.0, 4.0)) < 1e-9);
        assert!(line.intersection(&PixelLine::through(p, 0.3)).is_none());
        assert!(PixelLine::joining(p, p).is_none());
        assert!(PixelLine::joining(p, Pixel::new(f64::NAN, 0.0)).is_none());
        assert!(PixelLine::from_homogeneous(Vector3::new(0.0, 0.0, 1.0)).is_none());
    }

    #[test]
    fn back_projected_plane_contains_the_rays_of_its_pixels() {
        let camera = Pinhole { width: 640, height: 480, focal: [500.0, 510.0], principal: [310.0, 250.0] };
        let (a, b) = (Pixel::new(12.0, 400.0), Pixel::new(600.0, 33.0));
        let n = PixelLine::joining(a, b).expect("apart").back_project(&camera);
        for p in [a, b] {
            assert!(n.normal().dot(&camera.unproject(p).bearing()).abs() < 1e-12);
        }
    }
}
