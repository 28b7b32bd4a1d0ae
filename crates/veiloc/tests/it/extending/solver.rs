//! A user-defined minimal solver: three lines and a known orientation.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc::geometry::frames::World;
use veiloc::geometry::nalgebra::{Matrix3, Rotation3, Vector3};
use veiloc::geometry::{CameraFromWorld, PixelLine, PlaneLine, Point3};
use veiloc_pose::{Correspondences, PoseOptions, PoseProblem, optimize_pose};
use veiloc_synthetic::problems::{PointProblem, PointProblemOptions};

/// Camera position from three line–point pairs with known orientation, for example from a phone's compass.
///
/// Solves `l_iᵀ (R X_i + t) = 0`, three linear equations in `t`. Returns no pose for lines through one image point
/// (their normals are coplanar) and for points behind the camera.
fn r3lp(
    rotation: &Rotation3<f64>,
    lines: &[PlaneLine; 3],
    points: &[Point3<World>; 3],
) -> Option<CameraFromWorld> {
    let normals = Matrix3::from_rows(&[0, 1, 2].map(|i| lines[i].normal().transpose()));
    let seen = [0, 1, 2].map(|i| lines[i].normal().dot(&(rotation * points[i].coords)));
    let t = normals.try_inverse()? * -Vector3::from(seen);
    let pose = CameraFromWorld::new(*rotation, t);
    let in_front = points.iter().all(|p| pose.transform(p).depth() > 0.0);
    (pose.is_finite() && in_front).then_some(pose)
}

/// A problem with a random line through every keypoint.
fn random_lines_through(made: &PointProblem, rng: &mut ChaCha8Rng) -> Vec<PixelLine> {
    made.pixels.iter().map(|p| PixelLine::through(*p, rng.random_range(0.0..std::f64::consts::PI))).collect()
}

#[test]
fn user_defined_solver_finds_truth_in_random_problems() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut found, trials) = (0, 2000);
    for _ in 0..trials {
        let made = PointProblem::generate(&PointProblemOptions::exact(3), &mut rng);
        let lines = random_lines_through(&made, &mut rng);
        let plane = [0, 1, 2].map(|i| lines[i].back_project(&made.camera));
        let points = [0, 1, 2].map(|i| made.points[i]);
        let pose = r3lp(made.cam_from_world.rotation(), &plane, &points);
        found += usize::from(pose.is_some_and(|p| p.translation_error(&made.cam_from_world) < 1e-5));
    }
    assert!(found as f64 / f64::from(trials) > 0.99, "{found} of {trials}");
}

#[test]
fn user_defined_hypotheses_are_refined_and_scored() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let made = PointProblem::generate(&PointProblemOptions::exact(200).noise(0.5).outliers(0.3), &mut rng);
    let lines = random_lines_through(&made, &mut rng);
    let observations = Correspondences::Lines { lines: lines.clone() };
    let problem =
        PoseProblem::new(made.camera, observations, (0..lines.len()).collect(), made.points.clone());
    let best = (0..60)
        .filter_map(|_| {
            let sample = [0; 3].map(|_| rng.random_range(0..lines.len()));
            let plane = sample.map(|i| lines[i].back_project(&made.camera));
            let pose = r3lp(made.cam_from_world.rotation(), &plane, &sample.map(|i| made.points[i]))?;
            optimize_pose(&problem, &pose, &PoseOptions::default()).ok()
        })
        .min_by(|a, b| a.score.total_cmp(&b.score))
        .expect("one sample of sixty is right");
    assert!(best.confidence.is_trusted());
    assert!(best.cam_from_world.rotation_error_degrees(&made.cam_from_world) < 0.2);
}
