//! Poses by time: interpolated at the times of images.

use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{UnitQuaternion, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Rigid3};

use super::posed_input::Poses;

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

    /// Whether the body is exactly at the origin, and not rotated.
    pub(super) fn is_identity(&self) -> bool {
        self.rotation == UnitQuaternion::identity() && self.position == Vector3::zeros()
    }

    /// The pose of a camera that is the body.
    pub(super) fn cam_from_world(&self) -> CameraFromWorld {
        let rotation = self.rotation.inverse().to_rotation_matrix();
        CameraFromWorld::new(rotation, -(rotation * self.position))
    }
}

/// Why a pose of [`lost`] is left out.
pub(super) const LOST: &str =
    "the pose is exactly the identity in the middle of the trajectory, as when tracking is lost";

/// Which poses in the order of time were written while tracking was lost: several that are exactly the identity, after others.
/// A trajectory may begin there, and one pose may be the reference of all.
pub(super) fn lost(is_identity: &[bool]) -> Vec<bool> {
    let first = is_identity.iter().position(|is_identity| !is_identity).unwrap_or(is_identity.len());
    let lost: Vec<bool> = (0..).zip(is_identity).map(|(at, is)| *is && at > first).collect();
    let is_several = lost.iter().filter(|lost| **lost).count() > 1;
    lost.into_iter().map(|lost| lost && is_several).collect()
}

/// A trajectory sorted by time, without the poses of lost tracking, which are left out of `poses`.
pub(super) fn tracked(mut trajectory: Vec<Stamped>, poses: &mut Poses) -> Vec<Stamped> {
    trajectory.sort_by(|a, b| a.time.total_cmp(&b.time));
    let lost = lost(&trajectory.iter().map(Stamped::is_identity).collect::<Vec<_>>());
    for (pose, _) in trajectory.iter().zip(&lost).filter(|(_, lost)| **lost) {
        poses.leave_out("poses", &format!("that of time {}", pose.time), LOST);
    }
    trajectory.into_iter().zip(lost).filter(|(_, lost)| !lost).map(|(pose, _)| pose).collect()
}

/// Gives images their poses by time; those without one are left out.
pub(super) fn pose_images(
    poses: &mut Poses,
    trajectory: &[Stamped],
    images: &[(f64, String)],
    camera: Intrinsics,
    cam_from_world: impl Fn(&Stamped) -> CameraFromWorld,
) {
    let mut late = Vec::new();
    for (time, name) in images {
        match pose_at_time(trajectory, *time) {
            Some(pose) => poses.push(name.clone(), camera, cam_from_world(&pose), Vec::new()),
            None => late.push(name),
        }
    }
    let range = |times: &mut dyn Iterator<Item = f64>| {
        let (first, last) = times.fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), time| {
            (time.min(first), time.max(last))
        });
        format!("{first:.3} to {last:.3} s")
    };
    let reason = format!(
        "the trajectory has no pose near their times (images: {}; poses: {})",
        range(&mut images.iter().map(|(time, _)| *time)),
        if trajectory.is_empty() {
            "none".to_owned()
        } else {
            range(&mut trajectory.iter().map(|pose| pose.time))
        },
    );
    for name in late {
        poses.leave_out("images", name, &reason);
    }
}

/// The pose at a time: interpolated, or the nearest. `None` if no pose is near enough. `trajectory` is sorted by time.
fn pose_at_time(trajectory: &[Stamped], time: f64) -> Option<Stamped> {
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

/// The time of an image by its name: seconds with a decimal point, or a whole number of 13 digits and more, whose unit is that
/// of [`seconds_of`].
pub(super) fn time_of(name: &str) -> Option<f64> {
    let file = name.rsplit('/').next()?;
    let stem = super::names::without_extension(file);
    let time: f64 = stem.parse().ok()?;
    (stem.contains('.') || (13..=19).contains(&stem.len())).then(|| seconds_of(time))
}

/// A time in seconds. Large numbers are in other units, by what makes them a time of this century: milliseconds (13 digits),
/// microseconds (16 digits) or nanoseconds.
pub(super) fn seconds_of(time: f64) -> f64 {
    match time {
        1e11..1e14 => 1e-3 * time,
        1e15..1e16 => 1e-6 * time,
        1e14.. => 1e-9 * time,
        _ => time,
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
    fn names_are_seconds_or_parts_of_them() {
        assert_eq!(time_of("rgb/1305031102.175304.png"), Some(1305031102.175304));
        assert_eq!(time_of("1305031102175304.png"), Some(1305031102.175304));
        assert!((time_of("cam0/1403636579763555584.png").expect("a time") - 1403636579.7635555).abs() < 1e-6);
        assert!(
            (time_of("1403636579763555584.000000.png").expect("a time") - 1403636579.7635555).abs() < 1e-6
        );
        assert_eq!(time_of("1305031102175.jpg"), Some(1305031102.175), "milliseconds");
        assert_eq!(time_of("frame-000012.png"), None);
        assert_eq!(time_of("000012.png"), None);
    }

    #[test]
    fn identity_is_lost_tracking_if_it_comes_again_after_the_start() {
        let identity = |time| at(time, 0.0);
        let mut poses = Poses::default();
        let trajectory =
            vec![at(4.0, 3.0), identity(0.0), identity(1.0), at(2.0, 1.0), identity(3.0), identity(5.0)];
        let tracked = tracked(trajectory, &mut poses);
        assert_eq!(tracked.iter().map(|pose| pose.time).collect::<Vec<_>>(), [0.0, 1.0, 2.0, 4.0]);
        assert_eq!(lost(&[false, true, false]), [false; 3], "one may be the reference");
        assert_eq!(lost(&[true, true]), [false; 2]);
    }
}
