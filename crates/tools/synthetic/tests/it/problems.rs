//! Generated problems have the properties that their options request.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::PlanePoint;
use veiloc_synthetic::problems::{PointProblem, PointProblemOptions};

fn reprojection(problem: &PointProblem, i: usize) -> f64 {
    let p = problem.cam_from_world.transform(&problem.points[i]);
    let on_plane = PlanePoint::from_camera_point(&p).expect("in front");
    problem.camera.project(on_plane).distance(&problem.pixels[i])
}

fn generate(options: &PointProblemOptions, seed: u64) -> PointProblem {
    PointProblem::generate(options, &mut ChaCha8Rng::seed_from_u64(seed))
}

#[test]
fn only_exact_matches_reproject_exactly() {
    let problem = generate(&PointProblemOptions::exact(300).outliers(0.4).depth(1.0, 9.0), 1);
    assert_eq!(problem.inliers.iter().filter(|i| !**i).count(), 120);
    let far_off = (0..300).filter(|&i| !problem.inliers[i] && reprojection(&problem, i) > 5.0).count();
    assert!(far_off > 115, "{far_off}");
    assert!((0..300).filter(|&i| problem.inliers[i]).all(|i| reprojection(&problem, i) < 1e-9));
    let depths = (0..300).map(|i| problem.cam_from_world.transform(&problem.points[i]).depth());
    assert!(depths.into_iter().all(|z| (1.0..=9.0).contains(&z)));
    assert_eq!(problem, generate(&PointProblemOptions::exact(300).outliers(0.4).depth(1.0, 9.0), 1));
    assert_ne!(problem, generate(&PointProblemOptions::exact(300).outliers(0.4).depth(1.0, 9.0), 2));
}

#[test]
fn noise_has_requested_size() {
    let problem = generate(&PointProblemOptions::exact(4000).noise(1.5), 3);
    let square: f64 = (0..4000).map(|i| reprojection(&problem, i).powi(2)).sum::<f64>() / 8000.0;
    assert!((square.sqrt() - 1.5).abs() < 0.06, "{}", square.sqrt());
}

#[test]
fn near_planar_points_are_near_a_plane() {
    let problem = generate(&PointProblemOptions::exact(200).near_planar(0.01), 4);
    let mean = problem.points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / 200.0;
    let scatter: nalgebra::Matrix3<f64> =
        problem.points.iter().map(|p| (p.coords - mean) * (p.coords - mean).transpose()).sum();
    let mut spread = scatter.symmetric_eigenvalues().map(|e| (e.max(0.0) / 200.0).sqrt());
    spread.as_mut_slice().sort_by(f64::total_cmp);
    assert!(spread[0] < 0.01 && spread[1] > 0.3, "{spread}");
    assert!(generate(&PointProblemOptions::exact(0), 1).points.is_empty());
}
