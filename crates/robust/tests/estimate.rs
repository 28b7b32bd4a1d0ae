//! `estimate_pose` on synthetic problems: right poses, honest covariance, typed refusals, repeatable results.

mod support;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{Scheme, Setup, problem};
use veiloc_geometry::nalgebra::{Matrix6, Vector3, Vector6};
use veiloc_geometry::{Anchor, CameraFromWorld, Pixel, Point3};
use veiloc_robust::{AnchoredSolver, Correspondences, PoseError, PoseOptions, ScoreKind, estimate_pose};

const SCHEMES: [Scheme; 3] = [Scheme::Points, Scheme::Lines, Scheme::Dcl];

fn options(score: ScoreKind) -> PoseOptions {
    let mut options = PoseOptions::default();
    options.score = Some(score);
    options.noise_px = 1.0;
    options
}

#[test]
fn the_true_pose_is_found_among_wrong_matches() {
    for scheme in SCHEMES {
        for score in [ScoreKind::Msac, ScoreKind::Likelihood] {
            if scheme == Scheme::Dcl && score == ScoreKind::Msac {
                continue; // the collapse, below
            }
            for seed in 0..20 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let setup = Setup { scheme, right: 120, wrong: 180, noise: 0.5 };
                let (problem, truth) = problem(&setup, &mut rng);
                let estimate = estimate_pose(&problem, &options(score), &mut rng).expect("a pose");
                let found = &estimate.cam_from_world;
                assert!(found.rotation_error_degrees(&truth) < 0.3, "{scheme:?} {score} {seed}");
                assert!(found.translation_error(&truth) < 0.03, "{scheme:?} {score} {seed}");
                assert_eq!(estimate.inliers.iter().filter(|i| **i).count(), estimate.inlier_count);
                assert!(estimate.inliers[..120].iter().filter(|i| **i).count() > 110);
                let wrong = estimate.inliers[120..].iter().filter(|i| **i).count();
                assert!(wrong < 40, "{scheme:?} {score} {seed}: {wrong} wrong inliers");
            }
        }
    }
}

#[test]
fn both_solvers_for_anchored_lines_find_it() {
    for solver in [AnchoredSolver::P6lp, AnchoredSolver::RadialVote] {
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let setup = Setup { scheme: Scheme::Dcl, right: 150, wrong: 150, noise: 0.5 };
            let (problem, truth) = problem(&setup, &mut rng);
            let mut options = options(ScoreKind::Likelihood);
            options.anchored_solver = Some(solver);
            let found = estimate_pose(&problem, &options, &mut rng).expect("a pose").cam_from_world;
            assert!(found.translation_error(&truth) < 0.03, "{solver} {seed}");
        }
    }
}

#[test]
fn msac_collapses_on_anchored_lines_and_the_likelihood_does_not() {
    let (mut collapsed, mut right) = (0, 0);
    for seed in 0..10 {
        let setup = Setup { scheme: Scheme::Dcl, right: 150, wrong: 450, noise: 0.5 };
        let (problem, truth) = problem(&setup, &mut ChaCha8Rng::seed_from_u64(seed));
        let solve = |score| {
            let mut options = options(score);
            options.fixed_hypotheses = Some(3000);
            estimate_pose(&problem, &options, &mut ChaCha8Rng::seed_from_u64(seed)).expect("a pose")
        };
        let msac = solve(ScoreKind::Msac);
        // The signature of the collapse: a majority of matches "agree" with a camera far away.
        collapsed +=
            usize::from(msac.inlier_count > 300 && msac.cam_from_world.translation_error(&truth) > 100.0);
        let likelihood = solve(ScoreKind::Likelihood);
        right += usize::from(likelihood.cam_from_world.translation_error(&truth) < 0.05);
    }
    assert!(collapsed >= 8, "{collapsed} of 10 collapsed");
    assert!(right >= 9, "{right} of 10 right");
}

#[test]
fn covariance_predicts_the_error() {
    // Mean squared Mahalanobis distance of the true pose is 6 for an honest covariance.
    for scheme in SCHEMES {
        let (mut sum, count) = (0.0, 150);
        for seed in 0..count {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (problem, truth) = problem(&Setup { scheme, right: 150, wrong: 30, noise: 0.7 }, &mut rng);
            let estimate =
                estimate_pose(&problem, &options(ScoreKind::Likelihood), &mut rng).expect("a pose");
            let step = tangent(&truth, &estimate.cam_from_world);
            let covariance = Matrix6::from_fn(|i, j| estimate.covariance[i][j]);
            let inverse = covariance.try_inverse().expect("invertible");
            sum += step.dot(&(inverse * step));
        }
        let mean = sum / count as f64;
        assert!((4.5..9.0).contains(&mean), "{scheme:?}: {mean}");
    }
}

/// The step with `from.perturbed(step) = to`, for small differences.
fn tangent(to: &CameraFromWorld, from: &CameraFromWorld) -> Vector6<f64> {
    let turn = to.rotation() * from.rotation().inverse();
    let w = 0.5
        * Vector3::new(turn[(2, 1)] - turn[(1, 2)], turn[(0, 2)] - turn[(2, 0)], turn[(1, 0)] - turn[(0, 1)]);
    let v = to.translation() - turn * from.translation();
    Vector6::new(w.x, w.y, w.z, v.x, v.y, v.z)
}

#[test]
fn equal_input_and_seed_give_equal_estimates() {
    for scheme in SCHEMES {
        let setup = Setup { scheme, right: 80, wrong: 120, noise: 0.5 };
        let (problem, _) = problem(&setup, &mut ChaCha8Rng::seed_from_u64(1));
        let run =
            |seed| estimate_pose(&problem, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(seed));
        assert_eq!(run(5), run(5));
    }
}

#[test]
fn a_prior_lets_it_find_a_needle() {
    let setup = Setup { scheme: Scheme::Dcl, right: 60, wrong: 1500, noise: 0.5 };
    let (mut with, mut without) = (0, 0);
    for seed in 0..5 {
        let (mut problem, truth) = problem(&setup, &mut ChaCha8Rng::seed_from_u64(seed));
        let mut options = options(ScoreKind::Likelihood);
        options.fixed_hypotheses = Some(500);
        let right = |problem: &_| {
            estimate_pose(problem, &options, &mut ChaCha8Rng::seed_from_u64(seed))
                .is_ok_and(|e| e.cam_from_world.translation_error(&truth) < 0.1)
        };
        without += usize::from(right(&problem));
        problem.prior = Some((0..1560).map(|i| if i < 60 || i % 30 == 0 { 0.4 } else { 0.01 }).collect());
        with += usize::from(right(&problem));
    }
    assert!(with >= 4 && without <= 2, "{with} with, {without} without");
}

#[test]
fn bad_input_is_refused_with_the_facts() {
    let rng = || ChaCha8Rng::seed_from_u64(1);
    let solve = |p: &_| estimate_pose(p, &PoseOptions::default(), &mut rng());
    let fresh = |scheme, right| problem(&Setup { scheme, right, wrong: 0, noise: 0.0 }, &mut rng()).0;

    assert_eq!(solve(&fresh(Scheme::Points, 2)), Err(PoseError::TooFew { required: 3, actual: 2 }));
    assert_eq!(solve(&fresh(Scheme::Lines, 5)), Err(PoseError::TooFew { required: 6, actual: 5 }));
    assert_eq!(solve(&fresh(Scheme::Dcl, 0)), Err(PoseError::TooFew { required: 6, actual: 0 }));

    let mut p = fresh(Scheme::Points, 20);
    p.points.pop();
    assert_eq!(solve(&p), Err(PoseError::LengthMismatch { what: "points", expected: 20, actual: 19 }));

    let mut p = fresh(Scheme::Points, 20);
    p.points[7] = Point3::new(0.0, f64::NAN, 0.0);
    assert_eq!(solve(&p), Err(PoseError::NotFinite { what: "point", index: 7 }));

    let mut p = fresh(Scheme::Points, 20);
    if let Correspondences::Points { pixels } = &mut p.observations {
        pixels[3] = Pixel::new(f64::INFINITY, 0.0);
    }
    assert_eq!(solve(&p), Err(PoseError::NotFinite { what: "observation", index: 3 }));

    let mut p = fresh(Scheme::Dcl, 20);
    if let Correspondences::Anchored { lines, .. } = &mut p.observations {
        lines[4].1 = f64::NAN;
    }
    assert_eq!(solve(&p), Err(PoseError::NotFinite { what: "observation", index: 4 }));

    let mut p = fresh(Scheme::Dcl, 20);
    if let Correspondences::Anchored { lines, .. } = &mut p.observations {
        for line in lines {
            line.0 = Anchor::Second;
        }
    }
    let refused = solve(&p).expect_err("one-sided");
    assert_eq!(refused, PoseError::OneSided { lines: 20 });
    assert!(refused.to_string().contains("move or turn the camera"));

    let mut p = fresh(Scheme::Points, 20);
    p.prior = Some(vec![0.5; 19]);
    assert_eq!(solve(&p), Err(PoseError::LengthMismatch { what: "prior", expected: 20, actual: 19 }));
    p.prior = Some((0..20).map(|i| if i == 9 { f64::NAN } else { 0.5 }).collect());
    assert!(matches!(solve(&p), Err(PoseError::BadPrior { index: 9, .. })));

    let mut p = fresh(Scheme::Points, 20);
    p.camera.focal[0] = 0.0;
    assert_eq!(solve(&p), Err(PoseError::BadValue { what: "focal length fx", value: 0.0 }));

    let p = fresh(Scheme::Points, 20);
    let mut options = PoseOptions::default();
    options.max_error_px = f64::NAN;
    assert!(matches!(
        estimate_pose(&p, &options, &mut rng()),
        Err(PoseError::BadValue { what: "max_error_px", .. })
    ));
}

#[test]
fn no_consensus_is_said_so() {
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (p, _) = problem(&Setup { scheme, right: 0, wrong: 12, noise: 0.0 }, &mut rng);
        let found = estimate_pose(&p, &PoseOptions::default(), &mut rng);
        assert!(matches!(found, Err(PoseError::NoConsensus { required: 10, .. })), "{scheme:?}: {found:?}");
    }
    // Everything at one place: no sample gives a pose, nothing panics.
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (mut p, _) = problem(&Setup { scheme, right: 30, wrong: 0, noise: 0.0 }, &mut rng);
        p.points = vec![p.points[0]; 30];
        assert!(estimate_pose(&p, &PoseOptions::default(), &mut rng).is_err(), "{scheme:?}");
    }
}

#[test]
fn wild_map_points_change_nothing() {
    // Triangulation sometimes leaves points at absurd distances; single precision must not suffer from them.
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let (mut p, truth) = problem(&Setup { scheme, right: 150, wrong: 60, noise: 0.5 }, &mut rng);
        for i in 150..170 {
            p.points[i] = Point3::new(1e12, -1e15, 1e9);
        }
        let found = estimate_pose(&p, &options(ScoreKind::Likelihood), &mut rng).expect("a pose");
        assert!(found.cam_from_world.translation_error(&truth) < 0.03, "{scheme:?}");
    }
}
