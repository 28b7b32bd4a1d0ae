//! Errors that neighbouring matches share, as of a rolling shutter or an imperfect lens: the covariance must cover them.

use super::support;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::{Scheme, Setup, problem};
use veiloc_geometry::nalgebra::{Matrix6, Vector3, Vector6};
use veiloc_geometry::{CameraFromWorld, Pixel, PlanePoint, Point3};
use veiloc_pose::{PoseOptions, PoseProblem, estimate_pose};

/// Moves the right map points so that their projections wave by up to this many pixels, with a wavelength of about the
/// image's height: as if the shutter had rolled over a shaking camera.
fn wave(problem: &mut PoseProblem, right: usize, truth: &CameraFromWorld, pixels: f64, rng: &mut ChaCha8Rng) {
    let camera = problem.camera;
    let phases = [(); 2].map(|()| rng.random_range(0.0..std::f64::consts::TAU));
    let height = f64::from(camera.height);
    for point in &mut problem.points[..right] {
        let p = truth.rotation() * point.coords + truth.translation();
        let at = camera.project(PlanePoint::new(p.x / p.z, p.y / p.z));
        let shift = phases.map(|phase| pixels * (std::f64::consts::TAU * at.v / height + phase).sin());
        let moved: Vector3<f64> =
            camera.unproject(Pixel::new(at.u + shift[0], at.v + shift[1])).homogeneous() * p.z;
        *point = Point3::from_vector(truth.rotation().inverse() * (moved - truth.translation()));
    }
}

/// Share of poses whose truth lies in the region of 99 % of the covariance.
fn coverage(scheme: Scheme, pixels: f64) -> f64 {
    let runs = 60;
    let inside = (0..runs).filter(|seed| {
        let mut rng = ChaCha8Rng::seed_from_u64(*seed);
        let setup = Setup { scheme, right: 300, wrong: 150, noise: 0.5 };
        let (mut problem, truth) = problem(&setup, &mut rng);
        wave(&mut problem, 300, &truth, pixels, &mut rng);
        let estimate = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
        let covariance = estimate.noise_covariance();
        let step = Vector6::from(estimate.cam_from_world.step_to(&truth));
        let factor = Matrix6::from_fn(|i, j| covariance[i][j]).cholesky().expect("held");
        // The quantile of 99 % of chi-squared with six degrees of freedom.
        step.dot(&factor.solve(&step)) < 16.81
    });
    inside.count() as f64 / runs as f64
}

#[test]
fn covariance_covers_errors_that_neighbours_share() {
    for scheme in [Scheme::Points, Scheme::Lines, Scheme::Dcl] {
        assert!(coverage(scheme, 0.0) > 0.93, "{scheme:?}, independent errors: {}", coverage(scheme, 0.0));
        assert!(coverage(scheme, 1.5) > 0.7, "{scheme:?}, shared errors: {}", coverage(scheme, 1.5));
    }
}
