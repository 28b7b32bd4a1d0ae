//! Half-planes that begin at an axis: the observation of a keypoint in an anchored query.

use nalgebra::{Vector2, Vector3};
use veiloc_geometry::PlanePoint;

/// A half-plane through the camera's centre: the map point lies at `a · axis + b · inward`, `b > 0`, in the camera
/// frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HalfPlane {
    /// The direction of its anchor, where it begins; any length.
    pub axis: Vector3<f64>,
    /// The direction into the half-plane, any length, not along the axis.
    pub inward: Vector3<f64>,
}

impl HalfPlane {
    /// The half-plane of a half-line on the plane `z = 1` that begins at `origin` and has this direction.
    pub fn of_half_line(origin: PlanePoint, direction: Vector2<f64>) -> Self {
        Self { axis: origin.homogeneous(), inward: Vector3::new(direction.x, direction.y, 0.0) }
    }

    /// Normal of the whole plane, of any length.
    pub fn normal(&self) -> Vector3<f64> {
        self.axis.cross(&self.inward)
    }

    /// Whether a point of the camera frame in the plane is in the half-plane, and in front of the camera.
    pub fn contains(&self, point: &Vector3<f64>) -> bool {
        // The part of `inward` across the axis, times the axis' squared length.
        let across = self.inward * self.axis.norm_squared() - self.axis * self.axis.dot(&self.inward);
        point.z > 0.0 && across.dot(point) > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_the_half_plane_and_of_its_other_half() {
        let half = HalfPlane::of_half_line(PlanePoint::new(0.2, -0.5), Vector2::new(-3.0, 4.0));
        for (s, depth, seen) in
            [(0.1, 2.0, true), (-0.1, 2.0, false), (0.1, -2.0, false), (-0.1, -2.0, false)]
        {
            let p = Vector3::new(0.2 - 3.0 * s, -0.5 + 4.0 * s, 1.0) * depth;
            assert!(half.normal().dot(&p).abs() < 1e-14);
            assert_eq!(half.contains(&p), seen, "{s} {depth}");
        }
        assert!(!half.contains(&Vector3::repeat(f64::NAN)));
        // An anchor beside the camera.
        let half = HalfPlane { axis: Vector3::x(), inward: Vector3::new(0.3, 0.1, 1.0) };
        assert!(half.contains(&Vector3::new(-7.0, 0.2, 2.0)));
        let half = HalfPlane { inward: -half.inward, ..half };
        assert!(!half.contains(&Vector3::new(-7.0, 0.2, 2.0)));
    }
}
