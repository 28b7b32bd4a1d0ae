//! `estimate_pose` on synthetic problems: right poses, correct covariance, typed errors, repeatable results.

use super::support;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{Scheme, Setup, problem};
use veiloc_geometry::nalgebra::{Matrix6, Rotation3, Vector3, Vector6};
use veiloc_geometry::{Anchor, CameraFromWorld, Pixel, Point3, Rigid3};
use veiloc_pose::{
    AnchoredSolver, Correspondences, Doubt, Gravity, PoseError, PoseOptions, ScoreKind, estimate_pose,
    fisher_information, optimize_pose, refine_pose,
};

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
fn all_anchored_solvers_find_the_pose() {
    for solver in [AnchoredSolver::P6lp, AnchoredSolver::DualRadial, AnchoredSolver::RadialVote] {
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
fn covariance_coverage_matches_chi_squared() {
    // The squared Mahalanobis distance of the true pose follows χ² of six degrees of freedom.
    const QUANTILES: [(f64, f64); 3] = [(0.5, 5.348), (0.9, 10.645), (0.99, 16.812)];
    for scheme in SCHEMES {
        for (right, wrong, noise) in [(150, 30, 0.7), (200, 150, 1.5)] {
            let mut distances = Vec::new();
            for seed in 0..300 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let (problem, truth) = problem(&Setup { scheme, right, wrong, noise }, &mut rng);
                let estimate = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
                let step = tangent(&truth, &estimate.cam_from_world);
                // The given camera is exact here.
                let own = estimate.noise_covariance();
                let covariance = Matrix6::from_fn(|i, j| own[i][j]);
                distances.push(step.dot(&(covariance.try_inverse().expect("invertible") * step)));
            }
            for (share, quantile) in QUANTILES {
                let inside = distances.iter().filter(|d| **d < quantile).count() as f64 / 300.0;
                // Three standard deviations of a share of 300, plus some slack for asymptotics.
                let slack = 3.0 * (share * (1.0 - share) / 300.0_f64).sqrt() + 0.02;
                assert!((inside - share).abs() < slack, "{scheme:?} {right}+{wrong}: {inside} for {share}");
            }
        }
    }
}

#[test]
fn the_noise_is_estimated_or_taken_as_given() {
    for scheme in SCHEMES {
        for noise in [0.3, 1.0, 2.0] {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let (problem, truth) = problem(&Setup { scheme, right: 400, wrong: 200, noise }, &mut rng);
            let found = optimize_pose(&problem, &truth, &PoseOptions::default()).expect("a pose");
            let shown = found.noise_px;
            assert!((shown / noise - 1.0).abs() < 0.2, "{scheme:?}: {shown} shown for {noise}");
        }
        // Keypoints are precise, the options claim otherwise, and wrong matches are many: with the noise of the
        // options, wrong matches within a few pixels distort the pose.
        let mut options = PoseOptions::default();
        options.noise_px = 4.0;
        let mut squared = [0.0; 2];
        for seed in 0..30 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (problem, truth) = problem(&Setup { scheme, right: 200, wrong: 600, noise: 0.3 }, &mut rng);
            for (k, estimate_noise) in [true, false].into_iter().enumerate() {
                options.estimate_noise = estimate_noise;
                let found = optimize_pose(&problem, &truth, &options).expect("a pose");
                squared[k] += found.cam_from_world.translation_error(&truth).powi(2);
            }
        }
        let [estimated, given] = squared.map(f64::sqrt);
        assert!(
            estimated < 0.85 * given,
            "{scheme:?}: {estimated} with the noise estimated, {given} as given"
        );
    }
}

#[test]
fn errors_come_close_to_the_cramer_rao_bound() {
    for scheme in SCHEMES {
        let (mut squared, count) = (0.0, 200);
        for seed in 0..count {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (problem, truth) = problem(&Setup { scheme, right: 150, wrong: 100, noise: 1.0 }, &mut rng);
            let estimate = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
            let right: Vec<bool> = (0..250).map(|i| i < 150).collect();
            let information = fisher_information(&problem, &truth, &right, 1.0).expect("a fair problem");
            let step = tangent(&estimate.cam_from_world, &truth);
            squared += step.dot(&(Matrix6::from_fn(|i, j| information[i][j]) * step)) / 6.0;
        }
        let ratio = (squared / count as f64).sqrt();
        assert!((0.95..1.15).contains(&ratio), "{scheme:?}: {ratio} times the bound");
    }
}

#[test]
fn refinement_on_given_matches_is_the_least_squares_floor() {
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (problem, truth) = problem(&Setup { scheme, right: 100, wrong: 50, noise: 0.0 }, &mut rng);
        let right: Vec<bool> = (0..150).map(|i| i < 100).collect();
        let start = truth.perturbed(&[0.002, -0.001, 0.001, 0.01, -0.01, 0.02]);
        let options = PoseOptions::default();
        let floor = refine_pose(&problem, &start, &right, &options).expect("a pose");
        assert!(floor.cam_from_world.translation_error(&truth) < 1e-6, "{scheme:?}");
        assert_eq!((floor.inliers, floor.inlier_count), (right.clone(), 100));
        let short = refine_pose(&problem, &start, &right[1..], &options);
        assert_eq!(short, Err(PoseError::LengthMismatch { what: "inliers", expected: 150, actual: 149 }));
        let few = refine_pose(&problem, &start, &[false; 150], &options);
        assert!(matches!(few, Err(PoseError::TooFew { actual: 0, .. })));
        let noiseless = fisher_information(&problem, &start, &right, 0.0);
        assert!(matches!(noiseless, Err(PoseError::BadValue { what: "noise_px", .. })));
    }
}

#[test]
fn optimize_from_initial_pose_matches_the_search() {
    for scheme in SCHEMES {
        for score in [ScoreKind::Msac, ScoreKind::Likelihood] {
            if scheme == Scheme::Dcl && score == ScoreKind::Msac {
                continue; // the collapse
            }
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let (problem, truth) = problem(&Setup { scheme, right: 100, wrong: 100, noise: 0.5 }, &mut rng);
            let initial = truth.perturbed(&[0.003, -0.002, 0.001, 0.02, -0.01, 0.02]);
            let options = options(score);
            let optimum = optimize_pose(&problem, &initial, &options).expect("a pose");
            assert_eq!(optimum.hypotheses, 0);
            assert!(optimum.cam_from_world.translation_error(&truth) < 0.03, "{scheme:?} {score}");
            let found = estimate_pose(&problem, &options, &mut rng).expect("a pose");
            assert!(found.score <= optimum.score + 0.05, "{} {}", found.score, optimum.score);
            let not_finite = Rigid3::new(Rotation3::identity(), Vector3::repeat(f64::NAN));
            let refused = optimize_pose(&problem, &not_finite, &options);
            assert_eq!(refused, Err(PoseError::NotFinite { what: "initial pose", index: 0 }));
        }
    }
}

#[test]
fn gravity_needs_fewer_samples() {
    for scheme in SCHEMES {
        let (mut with, mut without) = (0, 0);
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            // The number of samples for a hit probability of one half with gravity, for which half of them are drawn.
            let (wrong, samples) = if scheme == Scheme::Points { (840, 300) } else { (240, 860) };
            let (mut problem, truth) = problem(&Setup { scheme, right: 60, wrong, noise: 0.5 }, &mut rng);
            let mut options = PoseOptions::default();
            options.fixed_hypotheses = Some(samples);
            let found = |problem: &_| {
                estimate_pose(problem, &options, &mut ChaCha8Rng::seed_from_u64(seed))
                    .is_ok_and(|e| e.cam_from_world.translation_error(&truth) < 0.1)
            };
            without += usize::from(found(&problem));
            let in_world = Vector3::new(0.2, -0.4, 0.9);
            problem.gravity = Some(Gravity::from_accelerometer(truth.rotation() * in_world * 9.81, in_world));
            with += usize::from(found(&problem));
        }
        assert!(with > without + 5, "{scheme:?}: {with} with, {without} without");
    }
}

#[test]
fn gravity_error_of_one_degree_is_tolerated() {
    for scheme in SCHEMES {
        for seed in 0..10 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (mut problem, truth) =
                problem(&Setup { scheme, right: 150, wrong: 100, noise: 0.5 }, &mut rng);
            let tilt = Rotation3::from_scaled_axis(Vector3::new(0.0, 0.0, 1.0_f64.to_radians()));
            let in_world = Vector3::y();
            problem.gravity =
                Some(Gravity::from_accelerometer(tilt * (truth.rotation() * in_world), in_world));
            let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
            assert!(found.cam_from_world.rotation_error_degrees(&truth) < 0.3, "{scheme:?} {seed}");
        }
    }
    let (mut problem, _) = problem(
        &Setup { scheme: Scheme::Dcl, right: 30, wrong: 0, noise: 0.0 },
        &mut ChaCha8Rng::seed_from_u64(1),
    );
    problem.gravity = Some(Gravity::from_accelerometer(Vector3::zeros(), Vector3::y()));
    let refused = estimate_pose(&problem, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(1));
    assert!(matches!(refused, Err(PoseError::BadValue { what: "length of gravity in the camera", .. })));
}

#[test]
fn right_poses_are_trusted_and_chance_is_not() {
    for scheme in SCHEMES {
        let (mut trusted, mut fooled) = (0, 0);
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (right, _) = problem(&Setup { scheme, right: 100, wrong: 200, noise: 1.0 }, &mut rng);
            let (wrong, _) = problem(&Setup { scheme, right: 0, wrong: 600, noise: 1.0 }, &mut rng);
            let confident = |p: &_| {
                estimate_pose(p, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(seed))
                    .is_ok_and(|e| e.confidence.is_trusted())
            };
            trusted += usize::from(confident(&right));
            fooled += usize::from(confident(&wrong));
        }
        assert!(trusted >= 19 && fooled == 0, "{scheme:?}: {trusted} trusted, {fooled} fooled");
    }
}

#[test]
fn doubts_name_the_cause() {
    // All but two lines belong to one anchor, so the depth along its ray depends on those two.
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let setup = Setup { scheme: Scheme::Dcl, right: 200, wrong: 0, noise: 0.5 };
    let (full, _) = problem(&setup, &mut rng);
    let Correspondences::Anchored { pencils, lines } = full.observations.clone() else { unreachable!() };
    let second: Vec<usize> = (0..200).filter(|&i| lines[i].0 == Anchor::SECOND).collect();
    let keep: Vec<usize> =
        (0..200).filter(|i| lines[*i].0 == Anchor::FIRST || second[..2].contains(i)).collect();
    let mut one_sided = full.clone();
    one_sided.keypoints.clone_from(&keep);
    one_sided.points = keep.iter().map(|&i| full.points[i]).collect();
    one_sided.observations =
        Correspondences::Anchored { pencils, lines: keep.iter().map(|&i| lines[i]).collect() };
    let estimate = estimate_pose(&one_sided, &PoseOptions::default(), &mut rng).expect("a pose");
    assert_eq!(estimate.confidence.sides.map(|s| s[1] <= 2), Some(true));
    let doubts = estimate.confidence.doubts();
    assert!(doubts.iter().any(|d| matches!(d, Doubt::OneSided { .. })), "{doubts:?}");
    assert!(doubts.iter().any(|d| d.to_string().contains("run through one anchor")));
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
fn match_prior_finds_rare_inliers() {
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
fn invalid_input_is_rejected_with_facts() {
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
    p.keypoints.clear();
    assert_eq!(solve(&p), Err(PoseError::LengthMismatch { what: "keypoints", expected: 20, actual: 0 }));

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

    let mut p = fresh(Scheme::Dcl, 7);
    if let Correspondences::Anchored { lines, .. } = &mut p.observations {
        for line in lines {
            line.0 = Anchor::SECOND;
        }
    }
    let refused = solve(&p).expect_err("one-sided");
    assert_eq!(refused, PoseError::OneSided { lines: 7 });
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
fn no_consensus_is_reported() {
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (p, _) = problem(&Setup { scheme, right: 0, wrong: 12, noise: 0.0 }, &mut rng);
        let found = estimate_pose(&p, &PoseOptions::default(), &mut rng);
        assert!(matches!(found, Err(PoseError::NoConsensus { required: 10, .. })), "{scheme:?}: {found:?}");
    }
    // All points equal: no sample gives a pose, nothing panics.
    for scheme in SCHEMES {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (mut p, _) = problem(&Setup { scheme, right: 30, wrong: 0, noise: 0.0 }, &mut rng);
        p.points = vec![p.points[0]; 30];
        assert!(estimate_pose(&p, &PoseOptions::default(), &mut rng).is_err(), "{scheme:?}");
    }
}

#[test]
fn outlier_map_points_do_not_matter() {
    // Triangulation sometimes gives points at absurd distances; single precision must not suffer from them.
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

/// A stopped search gives no pose, both before its first sample and later; an unset flag changes nothing.
#[test]
fn stopped_search_gives_no_pose() {
    let setup = Setup { scheme: Scheme::Dcl, right: 120, wrong: 180, noise: 0.5 };
    let (problem, _) = problem(&setup, &mut ChaCha8Rng::seed_from_u64(1));
    let solve = |options: &PoseOptions| estimate_pose(&problem, options, &mut ChaCha8Rng::seed_from_u64(2));
    let plain = solve(&options(ScoreKind::Likelihood)).expect("a pose");
    let stopped = options(ScoreKind::Likelihood);
    assert_eq!(solve(&stopped).expect("a pose").cam_from_world, plain.cam_from_world);
    stopped.stop.set();
    assert!(matches!(solve(&stopped), Err(PoseError::Stopped)));
    // In the middle of a search that would never end.
    let mut endless = options(ScoreKind::Likelihood);
    endless.fixed_hypotheses = Some(usize::MAX);
    let stop = endless.stop.clone();
    std::thread::scope(|scope| {
        let search = scope.spawn(|| solve(&endless));
        std::thread::sleep(std::time::Duration::from_millis(50));
        stop.set();
        assert!(matches!(search.join().expect("it ends"), Err(PoseError::Stopped)));
    });
}
