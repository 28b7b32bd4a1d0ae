//! The caller assigns correspondences to keypoints; they are not inferred from the observations.

use super::support;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{CAMERA, Scheme, Setup, problem};
use veiloc_geometry::{CameraFromWorld, Pixel, PixelLine, PlanePoint, Point3};
use veiloc_pose::{
    Confidence, Correspondences, PoseError, PoseOptions, PoseProblem, estimate_pose, optimize_pose,
};

fn right(scheme: Scheme, right: usize) -> (PoseProblem, CameraFromWorld) {
    problem(&Setup { scheme, right, wrong: 0, noise: 0.3 }, &mut ChaCha8Rng::seed_from_u64(11))
}

fn confidence(problem: &PoseProblem, truth: &CameraFromWorld) -> Confidence {
    optimize_pose(problem, truth, &PoseOptions::default()).expect("a pose").confidence
}

/// Appends copies of the observations and map points of these correspondences; the caller sets the keypoints.
fn repeat(problem: &mut PoseProblem, which: &[usize]) {
    problem.points.extend(which.iter().map(|&i| problem.points[i]).collect::<Vec<_>>());
    match &mut problem.observations {
        Correspondences::Points { pixels } => {
            pixels.extend(which.iter().map(|&i| pixels[i]).collect::<Vec<_>>());
        }
        Correspondences::Lines { lines } => {
            lines.extend(which.iter().map(|&i| lines[i]).collect::<Vec<_>>());
        }
        Correspondences::Anchored { lines, .. } => {
            lines.extend(which.iter().map(|&i| lines[i]).collect::<Vec<_>>());
        }
    }
}

/// The point of the map on the ray of this pixel, `depth` from the camera.
fn lift(truth: &CameraFromWorld, pixel: Pixel, depth: f64) -> Point3<veiloc_geometry::frames::World> {
    truth.inverse().transform(&Point3::from_vector(CAMERA.unproject(pixel).homogeneous() * depth))
}

fn projection(truth: &CameraFromWorld, point: &Point3<veiloc_geometry::frames::World>) -> Pixel {
    CAMERA.project(PlanePoint::from_camera_point(&truth.transform(point)).expect("in front"))
}

#[test]
fn keypoints_with_equal_codes_count_separately() {
    // Twelve more keypoints, each on the line of another one, but at another position and with its own map point.
    let (mut problem, truth) = right(Scheme::Dcl, 60);
    let before = confidence(&problem, &truth).log_evidence;
    repeat(&mut problem, &(0..12).collect::<Vec<_>>());
    let Correspondences::Anchored { pencils, lines } = &problem.observations else { unreachable!() };
    for i in 0..12 {
        let anchor = pencils.position(lines[i].0).expect("at the edge");
        let seen = projection(&truth, &problem.points[i]);
        let nearer = Pixel::new(0.3 * anchor.u + 0.7 * seen.u, 0.3 * anchor.v + 0.7 * seen.v);
        problem.points[60 + i] = lift(&truth, nearer, 2.5);
    }
    problem.keypoints = (0..72).collect();
    let different = confidence(&problem, &truth);
    problem.keypoints = (0..60).chain(0..12).collect();
    let one = confidence(&problem, &truth);
    // An agreeing line adds about four units of evidence; a second agreeing point of the same line adds almost none.
    assert!(different.log_evidence > before + 25.0, "{} after {before}", different.log_evidence);
    assert!(one.log_evidence < before + 12.0 * 2.0_f64.ln() + 3.0, "{} after {before}", one.log_evidence);
    assert_eq!(different.sides.map(|s| s[0] + s[1]), one.sides.map(|s| s[0] + s[1] + 12));
}

#[test]
fn keypoint_with_several_map_points_counts_once() {
    for scheme in [Scheme::Points, Scheme::Lines, Scheme::Dcl] {
        let (mut problem, truth) = right(scheme, 60);
        let single = confidence(&problem, &truth).log_evidence;
        repeat(&mut problem, &(0..60).collect::<Vec<_>>());
        for (i, point) in problem.points.iter_mut().enumerate().skip(60) {
            *point = Point3::new(point.coords.x + 1e-7 * i as f64, point.coords.y, point.coords.z);
        }
        problem.keypoints = (0..60).chain(0..60).collect();
        let once = confidence(&problem, &truth).log_evidence;
        problem.keypoints = (0..120).collect();
        let twice = confidence(&problem, &truth).log_evidence;
        // Two candidates instead of one may add ln 2 per keypoint, not more. (The pose is also less certain than with
        // two keypoints, so more poses explain them.)
        assert!(
            once < single + 60.0 * 2.0_f64.ln() + 3.0,
            "{scheme:?}: {once}, {single} with one point each"
        );
        assert!(twice > 1.6 * single, "{scheme:?}: {twice}, {single} with one point each");
    }
}

#[test]
fn the_two_lines_of_a_permuted_keypoint_count_once() {
    let (mut problem, truth) = right(Scheme::Points, 60);
    let Correspondences::Points { pixels } = problem.observations.clone() else { unreachable!() };
    let either =
        |p: &Pixel| [PixelLine::through(*p, 0.0), PixelLine::through(*p, std::f64::consts::FRAC_PI_2)];
    // The worst case: both lines of each row agree.
    problem.points = problem.points.iter().flat_map(|p| [*p, *p]).collect();
    problem.observations = Correspondences::Lines { lines: pixels.iter().flat_map(either).collect() };
    problem.keypoints = (0..120).map(|i| i / 2).collect();
    let rows = confidence(&problem, &truth).log_evidence;
    let estimate = estimate_pose(&problem, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(1));
    let estimate = estimate.expect("a pose");
    assert!(estimate.inlier_count > 100 && estimate.inlier_keypoints <= 60);
    problem.keypoints = (0..120).collect();
    let lines = confidence(&problem, &truth).log_evidence;
    assert!(rows < 0.7 * lines, "{rows} by rows, {lines} by lines");
}

#[test]
fn keypoint_ids_are_arbitrary() {
    for scheme in [Scheme::Points, Scheme::Lines, Scheme::Dcl] {
        let setup = Setup { scheme, right: 80, wrong: 80, noise: 0.5 };
        let (mut problem, _) = problem(&setup, &mut ChaCha8Rng::seed_from_u64(5));
        problem.keypoints = (0..160).map(|i| i / 2).collect();
        let solve = |p: &_| estimate_pose(p, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(6));
        let expected = solve(&problem).expect("a pose");
        for keypoint in &mut problem.keypoints {
            *keypoint = usize::MAX - 7919 * *keypoint;
        }
        assert_eq!(solve(&problem).expect("a pose"), expected, "{scheme:?}");
    }
}

#[test]
fn consensus_counts_keypoints_not_matches() {
    // Nine keypoints, each with three map points at the same position.
    let (mut problem, _) = right(Scheme::Points, 9);
    repeat(&mut problem, &(0..9).chain(0..9).collect::<Vec<_>>());
    problem.keypoints = (0..9).chain(0..9).chain(0..9).collect();
    let found = estimate_pose(&problem, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(1));
    assert!(matches!(found, Err(PoseError::NoConsensus { inliers: 9, required: 10, .. })), "{found:?}");
}
