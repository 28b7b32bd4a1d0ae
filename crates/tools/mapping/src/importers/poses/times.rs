//! Poses by time: interpolated at the times of images.

use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{UnitQuaternion, Vector3};
use veiloc_geometry::{CameraFromWorld, Rigid3};

/// Longest time between two poses that are interpolated, seconds.
const MAX_GAP: f64 = 0.2;

/// Largest difference between the times of an image and of a pose without a second one around it, seconds: that of TUM's
/// `associate.py`.
const MAX_DIFFERENCE: f64 = 0.02;

/// A pose of a body in the world at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stamped {
    /// Seconds.
    pub(super) time: f64,
    pub(super) rotation: UnitQuaternion<f64>,
    /// Origin of the body in the world.
    pub(super) position: Vector3<f64>,
}

impl Stamped {
    /// From a quaternion `w x y z` that rotates the body into the world.
    pub(super) fn new(time: f64, wxyz: [f64; 4], position: [f64; 3]) -> Option<Self> {
        let pose = Rigid3::<World, World>::from_quaternion(wxyz, position)?;
        let rotation = UnitQuaternion::from_rotation_matrix(pose.rotation());
        Some(Self { time, rotation, position: *pose.translation() })
    }

    /// The pose of a camera that is the body.
    pub(super) fn cam_from_world(&self) -> CameraFromWorld {
        let rotation = self.rotation.inverse().to_rotation_matrix();
        CameraFromWorld::new(rotation, -(rotation * self.position))
    }
}

/// The pose at a time: interpolated, or the nearest. `None` if no pose is near enough. `trajectory` is sorted by time.
pub(super) fn pose_at_time(trajectory: &[Stamped], time: f64) -> Option<Stamped> {
    let after = trajectory.partition_point(|pose| pose.time < time);
    let (before, after) = (after.checked_sub(1).map(|at| trajectory[at]), trajectory.get(after).copied());
    if let Some(exact) = after.filter(|pose| pose.time == time) {
        return Some(exact);
    }
    if let (Some(a), Some(b)) = (before, after)
        && b.time - a.time <= MAX_GAP
    {
        let share = (time - a.time) / (b.time - a.time);
        let rotation = a.rotation.try_slerp(&b.rotation, share, 1e-9).unwrap_or(a.rotation);
        return Some(Stamped { time, rotation, position: a.position.lerp(&b.position, share) });
    }
    let distance = |pose: &Stamped| (pose.time - time).abs();
    let nearest = before.into_iter().chain(after).min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    (distance(&nearest) <= MAX_DIFFERENCE).then_some(nearest)
}

/// The time of an image by its name: seconds with a decimal point, microseconds (16 digits) or nanoseconds (17 to 19
/// digits).
pub(super) fn time_of(name: &str) -> Option<f64> {
    let file = name.rsplit('/').next()?;
    let stem = super::names::without_extension(file);
    let seconds: f64 = stem.parse().ok()?;
    match (stem.contains('.'), stem.len()) {
        (true, _) => Some(seconds),
        (false, 16) => Some(1e-6 * seconds),
        (false, 17..=19) => Some(1e-9 * seconds),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(time: f64, x: f64) -> Stamped {
        Stamped::new(time, [1.0, 0.0, 0.0, x], [x, 0.0, 0.0]).expect("a pose")
    }

    #[test]
    fn poses_are_interpolated_between_near_times_only() {
        let trajectory = [at(0.0, 0.0), at(0.1, 1.0), at(5.0, 2.0)];
        let middle = pose_at_time(&trajectory, 0.05).expect("between two");
        assert!((middle.position.x - 0.5).abs() < 1e-12, "{middle:?}");
        // A quaternion (1, 0, 0, 1) is a quarter turn; half of it is an eighth.
        assert!((middle.rotation.angle().to_degrees() - 45.0).abs() < 1e-9, "{middle:?}");
        assert_eq!(pose_at_time(&trajectory, 5.0).map(|pose| pose.position.x), Some(2.0));
        assert_eq!(pose_at_time(&trajectory, 0.11).map(|pose| pose.position.x), Some(1.0), "the nearest");
        assert!(pose_at_time(&trajectory, 2.0).is_none());
        assert!(pose_at_time(&[], 2.0).is_none());
    }

    #[test]
    fn names_are_seconds_microseconds_or_nanoseconds() {
        assert_eq!(time_of("rgb/1305031102.175304.png"), Some(1305031102.175304));
        assert_eq!(time_of("1305031102175304.png"), Some(1305031102.175304));
        assert!((time_of("cam0/1403636579763555584.png").expect("a time") - 1403636579.7635555).abs() < 1e-6);
        assert_eq!(time_of("frame-000012.png"), None);
        assert_eq!(time_of("000012.png"), None);
    }
}
