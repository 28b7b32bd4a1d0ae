//! Orientation of the camera.

use veiloc_geometry::nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use veiloc_protocol::CoarseGravity;

/// Orientation of the camera during a frame, as far as the device knows it. The rotation is never sent: a query contains
/// the rotation of its layout relative to the camera, which is the difference to the session's first frame. The gravity
/// direction is sent, rounded ([`Extracted::with_orientation`](crate::Extracted::with_orientation)).
///
/// Camera axes: `x` right, `y` down, `z` forward, of the image as its pixels are stored.
#[derive(Clone, Copy, PartialEq, Default)]
pub struct Orientation {
    cam_from_world: Option<Rotation3<f64>>,
    /// Unit length.
    down: Option<Vector3<f64>>,
}

impl Orientation {
    /// Nothing is known.
    pub const fn unknown() -> Self {
        Self { cam_from_world: None, down: None }
    }

    /// The rotation to the camera from any frame that is fixed in the world during the session; `None` when it is not
    /// finite.
    pub fn in_world(cam_from_world: Rotation3<f64>) -> Option<Self> {
        let is_finite = cam_from_world.matrix().iter().all(|x| x.is_finite());
        is_finite.then_some(Self { cam_from_world: Some(cam_from_world), down: None })
    }

    /// As [`Self::in_world`], from a Hamilton quaternion `[w, x, y, z]` of any length; `None` when it is zero or not
    /// finite.
    pub fn from_quaternion([w, x, y, z]: [f64; 4]) -> Option<Self> {
        let quaternion = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9)?;
        Self::in_world(quaternion.to_rotation_matrix())
    }

    /// This orientation with the gravity direction in the camera's axes, of any length; `None` when it is zero or not
    /// finite.
    pub fn with_down(self, down: [f64; 3]) -> Option<Self> {
        let down = Vector3::from(down).try_normalize(1e-9).filter(|d| d.iter().all(|x| x.is_finite()))?;
        Some(Self { down: Some(down), ..self })
    }

    /// Rotation from the world to the camera.
    pub const fn cam_from_world(&self) -> Option<&Rotation3<f64>> {
        self.cam_from_world.as_ref()
    }

    /// Rotation to the camera from a level frame: `y` down, `z` along the horizontal component of the viewing
    /// direction, or where the upper end of the image points when the camera looks at the ground.
    ///
    /// Gravity is rounded as in [`CoarseGravity`]: a query reveals the rotation of the level frame and so the sensor's
    /// value, whose further digits would identify the device (rule L6).
    pub(super) fn levelled(&self) -> Option<Rotation3<f64>> {
        levelled(self.coarse_gravity()?.in_camera().into())
    }

    /// The gravity direction, rounded.
    pub(crate) fn coarse_gravity(&self) -> Option<CoarseGravity> {
        CoarseGravity::new(self.down?.into(), CoarseGravity::TRACKING_SD_DEG).ok()
    }
}

/// The same for an exact direction.
fn levelled(down: Vector3<f64>) -> Option<Rotation3<f64>> {
    // Looking at the ground the image's upper end points ahead, looking at the sky its lower end.
    let ahead = if down.z.abs() < MAX_STEEPNESS { Vector3::z() } else { Vector3::y() * -down.z.signum() };
    let ahead = (ahead - down * down.dot(&ahead)).try_normalize(1e-9)?;
    Some(Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[down.cross(&ahead), down, ahead])))
}

/// Cosine between viewing direction and vertical above which the horizontal component of the former is undefined.
const MAX_STEEPNESS: f64 = 0.9;

// An orientation must not appear in logs.
impl std::fmt::Debug for Orientation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Orientation")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levelled_frame_is_vertical_and_faces_forward() {
        for (x, y, z) in
            [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (-0.9, 1.0, 0.2), (1.5, 0.4, 3.0), (-1.5, 0.0, 1.0)]
        {
            // The camera in a world whose y axis is down.
            let cam_from_world = Rotation3::from_euler_angles(x, y, z);
            let down = cam_from_world * Vector3::y();
            let orientation = Orientation::in_world(cam_from_world).expect("finite");
            let orientation = orientation.with_down((down * 9.81).into()).expect("a direction");
            let cam_from_level = orientation.levelled().expect("a direction");
            assert!((cam_from_level.matrix().determinant() - 1.0).abs() < 1e-9);
            // The rounding is about a degree.
            assert!((cam_from_level * Vector3::y()).angle(&down) < 1.0_f64.to_radians());
            let exact = levelled(down).expect("a direction");
            assert!((exact * Vector3::y() - down).norm() < 1e-9);
            let ahead = cam_from_level * Vector3::z();
            let seen = if down.z.abs() < 0.9 { ahead.z } else { -ahead.y * down.z.signum() };
            assert!(seen > 0.0, "{x} {y} {z}: {ahead}");
        }
    }

    #[test]
    fn invalid_directions_are_rejected() {
        assert!(Orientation::from_quaternion([0.0; 4]).is_none());
        assert!(Orientation::from_quaternion([f64::NAN, 0.0, 0.0, 1.0]).is_none());
        assert!(Orientation::unknown().with_down([0.0; 3]).is_none());
        assert!(Orientation::unknown().with_down([f64::INFINITY, 0.0, 0.0]).is_none());
        assert!(Orientation::unknown().levelled().is_none());
    }
}
