//! Lines that end: what an anchored query tells of a keypoint.

use nalgebra::{Vector2, Vector3};
use veiloc_geometry::PlanePoint;

/// A half-line on the plane `z = 1` of the camera: the image of a map point lies at `origin + s · direction`, `s > 0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HalfLine {
    /// Where it begins: the image of its anchor.
    pub origin: PlanePoint,
    /// Where it leads, any length.
    pub direction: Vector2<f64>,
}

impl HalfLine {
    /// Normal of the plane through the half-line and the projection centre, as long as `direction` or longer.
    pub fn normal(&self) -> Vector3<f64> {
        let (a, v) = (self.origin, self.direction);
        Vector3::new(-v.y, v.x, a.x * v.y - a.y * v.x)
    }

    /// Whether a point of the camera frame that lies in the plane of [`Self::normal`] is seen on the half-line: in
    /// front of the camera and beyond the origin.
    pub fn leads_to(&self, point: &Vector3<f64>) -> bool {
        let along = self
            .direction
            .dot(&Vector2::new(point.x - self.origin.x * point.z, point.y - self.origin.y * point.z));
        point.z > 0.0 && along > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_the_half_line_and_of_its_other_half() {
        let half = HalfLine { origin: PlanePoint::new(0.2, -0.5), direction: Vector2::new(-3.0, 4.0) };
        for (s, depth, seen) in
            [(0.1, 2.0, true), (-0.1, 2.0, false), (0.1, -2.0, false), (-0.1, -2.0, false)]
        {
            let p = Vector3::new(0.2 - 3.0 * s, -0.5 + 4.0 * s, 1.0) * depth;
            assert!(half.normal().dot(&p).abs() < 1e-14);
            assert_eq!(half.leads_to(&p), seen, "{s} {depth}");
        }
        assert!(!half.leads_to(&Vector3::repeat(f64::NAN)));
    }
}
