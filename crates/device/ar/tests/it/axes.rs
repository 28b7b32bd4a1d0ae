//! One camera in the axes of each framework, worked out by hand, and round trips.

use veiloc_ar::{Alignment, ArWorld, Axes, CameraFromAr, FrameworkPose};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{Point3, Rigid3, frames::World};

const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A camera 1.5 m above the ground, 1 m to the right of and 2 m in front of where the AR session began, turned by a
/// quarter to the right: what is 3 m ahead, 0.25 m to the right and 0.5 m above it is at (4, 2, -1.75) in OpenGL's axes.
const WORKED: [(Axes, FrameworkPose, [f64; 3]); 4] = [
    // Clockwise seen from above is negative about `y`.
    (
        Axes::OpenGl,
        FrameworkPose { position: [1.0, 1.5, -2.0], rotation: [0.0, -HALF, 0.0, HALF] },
        [4.0, 2.0, -1.75],
    ),
    // Quaternion.Euler(0, 90, 0): left-handed, so clockwise is positive.
    (
        Axes::Unity,
        FrameworkPose { position: [1.0, 1.5, 2.0], rotation: [0.0, HALF, 0.0, HALF] },
        [4.0, 2.0, 1.75],
    ),
    // FRotator(0, 90, 0): forward is `x`, right is `y`, centimetres.
    (
        Axes::Unreal,
        FrameworkPose { position: [200.0, 100.0, 150.0], rotation: [0.0, 0.0, HALF, HALF] },
        [175.0, 400.0, 200.0],
    ),
    // The world of OpenGL, and a camera whose `y` is down: half a turn about the axis between right and back.
    (
        Axes::Colmap,
        FrameworkPose { position: [1.0, 1.5, -2.0], rotation: [HALF, 0.0, HALF, 0.0] },
        [4.0, 2.0, -1.75],
    ),
];

/// Largest difference of a number; a quaternion and its negative are one rotation.
fn difference(a: &FrameworkPose, b: &FrameworkPose) -> f64 {
    let largest = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let turned = largest(&a.rotation, &b.rotation).min(largest(&a.rotation, &b.rotation.map(|c| -c)));
    largest(&a.position, &b.position).max(turned)
}

fn some_pose(seed: f64) -> CameraFromAr {
    let axis = Vector3::new(seed.sin(), (2.0 * seed).cos(), (3.0 * seed).sin());
    Rigid3::new(Rotation3::from_scaled_axis(axis), Vector3::new(seed, -2.0 * seed, 0.3))
}

#[test]
fn one_camera_has_the_worked_pose_in_each_framework() {
    let ahead = Point3::new(4.0, 2.0, -1.75);
    for (axes, pose, point) in WORKED {
        let cam_from_ar = axes.cam_from_ar(&pose).expect("a pose");
        let seen = cam_from_ar.transform(&ahead).coords;
        assert!((seen - Vector3::new(0.25, -0.5, 3.0)).norm() < 1e-12, "{axes}: {seen}");
        // Every framework's pose from that of the first.
        let first = WORKED[0].0.cam_from_ar(&WORKED[0].1).expect("a pose");
        assert!(difference(&axes.camera_pose(&first), &pose) < 1e-12, "{axes}");
        // The point itself, as content that is not turned.
        let content = Rigid3::<ArWorld, World>::new(Rotation3::identity(), ahead.coords);
        let placed = axes.object_pose(&content);
        let expected = FrameworkPose { position: point, ..FrameworkPose::default() };
        assert!(difference(&placed, &expected) < 1e-12, "{axes}: {placed:?}");
    }
}

#[test]
fn poses_round_trip_in_each_framework() {
    for axes in Axes::ALL {
        for i in 0..200 {
            let pose = some_pose(f64::from(i) * 0.37);
            let back = axes.cam_from_ar(&axes.camera_pose(&pose)).expect("finite");
            let moved = (back.translation() - pose.translation()).norm();
            assert!(back.rotation_error_degrees(&pose) < 1e-9 && moved < 1e-9, "{axes} {i}");
            let content = some_pose(f64::from(i) * 0.11).inverse();
            let back = axes.ar_from_object(&axes.object_pose(&content)).expect("finite");
            let moved = (back.translation() - content.translation()).norm();
            assert!(back.rotation_error_degrees(&content) < 1e-9 && moved < 1e-9, "{axes} {i}");
        }
        assert_eq!(axes.name().parse(), Ok(axes));
    }
    assert_eq!("ARCore".parse(), Ok(Axes::OpenGl));
    assert!("left".parse::<Axes>().is_err());
}

#[test]
fn left_handed_worlds_mirror_every_distance_and_no_angle() {
    // Two cameras and a point: distances are equal in all frameworks up to the unit, whatever the handedness.
    let (a, b) = (some_pose(0.4), some_pose(1.3));
    for axes in Axes::ALL {
        let [pa, pb] = [&a, &b].map(|pose| Vector3::from(axes.camera_pose(pose).position));
        let expected = (a.inverse().translation() - b.inverse().translation()).norm();
        assert!(((pa - pb).norm() / axes.units_per_metre() - expected).abs() < 1e-9, "{axes}");
    }
}

#[test]
fn matrices_are_read_by_columns() {
    // `ARCamera.transform` of the worked example.
    let columns = [[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [1.0, 1.5, -2.0, 1.0]];
    let mut flat = [0.0; 16];
    flat.copy_from_slice(&columns.concat());
    let pose = FrameworkPose::from_matrix(&flat).expect("rigid");
    assert!(difference(&pose, &WORKED[0].1) < 1e-12, "{pose:?}");
    let by_rows: [f64; 16] = std::array::from_fn(|i| flat[4 * (i % 4) + i / 4]);
    assert_eq!(FrameworkPose::from_matrix(&by_rows), None);
    flat[0] = f64::NAN;
    assert_eq!(FrameworkPose::from_matrix(&flat), None);
}

#[test]
fn invalid_poses_are_rejected() {
    for axes in Axes::ALL {
        let zero = FrameworkPose { rotation: [0.0; 4], ..FrameworkPose::default() };
        let far = FrameworkPose { position: [f64::INFINITY, 0.0, 0.0], ..FrameworkPose::default() };
        assert!(axes.cam_from_ar(&zero).is_none() && axes.cam_from_ar(&far).is_none());
    }
    assert_eq!(Alignment::default().world_from_anchor(Axes::Unity, &FrameworkPose::default()), None);
}

#[test]
fn a_camera_on_a_head_has_the_composed_pose_in_each_framework() {
    // The lens is 0.1 m to the right, 0.2 m above and 0.3 m in front of the head, and looks to the right.
    let lenses = [
        FrameworkPose { position: [0.1, 0.2, -0.3], rotation: [0.0, -HALF, 0.0, HALF] },
        FrameworkPose { position: [0.1, 0.2, 0.3], rotation: [0.0, HALF, 0.0, HALF] },
        FrameworkPose { position: [30.0, 10.0, 20.0], rotation: [0.0, 0.0, HALF, HALF] },
        FrameworkPose { position: [0.1, -0.2, 0.3], rotation: [0.0, HALF, 0.0, HALF] },
    ];
    for ((axes, head, _), lens) in WORKED.into_iter().zip(lenses) {
        let camera = head.composed(&lens).expect("a pose");
        let seen = axes.cam_from_ar(&camera).expect("a pose").transform(&Point3::new(4.0, 2.0, -1.75)).coords;
        // From the lens the point is 0.15 m to the right, 0.3 m above and 2.7 m in front of a camera that is not turned.
        assert!((seen - Vector3::new(-2.7, -0.3, 0.15)).norm() < 1e-12, "{axes}: {seen}");
    }
    let zero = FrameworkPose { rotation: [0.0; 4], ..FrameworkPose::default() };
    assert_eq!(FrameworkPose::default().composed(&zero), None);
}
