//! Camera knowledge beside the matches: a focal length that is wrong or open, gravity, an approximate position.

use super::support;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{Scheme, Setup, bend, problem};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Point3};
use veiloc_pose::likelihood::MapCameras;
use veiloc_pose::{
    Confidence, Doubt, FocalPrior, Gravity, PoseError, PoseOptions, PoseProblem, PositionPrior, Precision,
    State, estimate_pose,
};

const SCHEMES: [Scheme; 3] = [Scheme::Points, Scheme::Lines, Scheme::Dcl];

/// A problem whose camera has a focal length that is a multiple of the true one.
fn zoomed(scheme: Scheme, factor: f64, rng: &mut ChaCha8Rng) -> (PoseProblem, CameraFromWorld) {
    let (mut problem, truth) = problem(&Setup { scheme, right: 150, wrong: 150, noise: 0.5 }, rng);
    problem.camera.focal = problem.camera.focal.map(|f| f * factor);
    (problem, truth)
}

#[test]
fn wrong_focal_length_is_estimated_and_right_one_unchanged() {
    for scheme in SCHEMES {
        for (factor, knowledge) in [
            (1.03, FocalPrior::Calibrated),
            (0.9, FocalPrior::Calibrated),
            (1.3, FocalPrior::Calibrated),
            (1.04, FocalPrior::Exif),
            (0.7, FocalPrior::Unknown),
            (1.4, FocalPrior::Unknown),
        ] {
            for seed in 0..5 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let (mut problem, truth) = zoomed(scheme, factor, &mut rng);
                problem.focal = knowledge;
                let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
                let what = format!("{scheme:?} {factor} {knowledge:?} {seed}: {}", found.focal_scale);
                let error = found.cam_from_world.translation_error(&truth);
                // A calibrated focal length that few matches contradict is not changed: it is doubted, or the
                // covariance covers the error.
                if factor == 1.03 && found.focal_scale == 1.0 {
                    let held = error < 3.0 * found.confidence.center_sd;
                    assert!(found.confidence.state() == State::Doubtful || held, "{what} {error}");
                    continue;
                }
                assert!((found.focal_scale * factor - 1.0).abs() < 0.02, "{what}");
                assert!(error < 0.1, "{what} {error}");
                assert_eq!(found.confidence.state(), State::Trusted, "{what}");
            }
        }
        for seed in 0..10 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (problem, _) = zoomed(scheme, 1.0, &mut rng);
            let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
            assert_eq!(found.focal_scale, 1.0, "{scheme:?} {seed}");
        }
    }
}

/// A focal length error within lens tolerances is neither estimated nor doubted: the covariance covers its effect.
#[test]
fn small_focal_error_is_in_the_covariance() {
    for scheme in SCHEMES {
        let (mut inside, mut noticed, mut looked_at) = (0, 0, 0);
        for seed in 0..10 {
            let mut sd = [0.0; 2];
            for (sd, factor) in sd.iter_mut().zip([1.0, 1.01]) {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let (problem, truth) = zoomed(scheme, factor, &mut rng);
                let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
                *sd = found.confidence.center_sd;
                if factor == 1.01 && found.focal_scale == 1.0 && found.confidence.state() == State::Trusted {
                    looked_at += 1;
                    inside += usize::from(found.cam_from_world.translation_error(&truth) < 3.0 * *sd);
                }
            }
            noticed += usize::from(sd[1] > 1.5 * sd[0]);
        }
        assert!(looked_at >= 8 && inside + 1 >= looked_at, "{scheme:?}: {inside} of {looked_at}");
        assert!(noticed >= 5, "{scheme:?}: {noticed}");
    }
}

/// Few matches in a small part of the image determine the position, but the orientation less: it is doubted.
#[test]
fn uncertain_orientation_is_doubted() {
    let (problem, _, mut rng) = few(Scheme::Points, 4);
    let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
    assert!(found.confidence.held_rotation_deg <= found.confidence.rotation_sd_deg);
    assert!(found.confidence.held_rotation_deg < 2.0);
    let mut loose = found.confidence;
    loose.held_rotation_deg = 5.4;
    let doubts = loose.doubts();
    let loose =
        |doubt: &Doubt| matches!(doubt, Doubt::Imprecise { rotation_sd_deg, .. } if *rotation_sd_deg > 5.0);
    assert!(doubts.iter().any(loose), "{doubts:?}");
    // A caller may need more.
    let mut needed = found.confidence;
    let is_less = |confidence: &Confidence| {
        confidence.doubts().iter().any(|doubt| matches!(doubt, Doubt::LessThanNeeded { .. }))
    };
    let rotation_deg = needed.rotation_sd_deg;
    needed.needed = Precision { rotation_deg: 1.1 * rotation_deg, ..Precision::ANY };
    assert!(!is_less(&found.confidence) && !is_less(&needed));
    needed.needed = Precision { rotation_deg: 0.9 * rotation_deg, ..Precision::ANY };
    assert!(is_less(&needed));
    needed.needed = Precision { position: 0.9 * needed.center_sd, ..Precision::ANY };
    assert!(is_less(&needed));
}

#[test]
fn unknown_focal_length_widens_the_covariance() {
    for scheme in SCHEMES {
        // Of the noise alone: the camera model adds about as much to a calibrated camera with this number of matches.
        let sd = |knowledge| {
            let mut rng = ChaCha8Rng::seed_from_u64(2);
            let (mut problem, _) = zoomed(scheme, 1.0, &mut rng);
            problem.focal = knowledge;
            let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
            let own = found.noise_covariance();
            (own[3][3] + own[4][4] + own[5][5]).sqrt()
        };
        let [unknown, calibrated] = [FocalPrior::Unknown, FocalPrior::Calibrated].map(sd);
        assert!(unknown > 1.1 * calibrated, "{scheme:?}: {unknown} {calibrated}");
    }
}

/// Few and noisy matches, so that priors matter.
fn few(scheme: Scheme, seed: u64) -> (PoseProblem, CameraFromWorld, ChaCha8Rng) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (problem, truth) = problem(&Setup { scheme, right: 40, wrong: 30, noise: 2.5 }, &mut rng);
    (problem, truth, rng)
}

#[test]
fn gravity_acts_according_to_its_deviation() {
    for scheme in SCHEMES {
        let (mut with, mut without) = (0.0, 0.0);
        for seed in 0..12 {
            let (mut problem, truth, mut rng) = few(scheme, seed);
            let tilt = |pose: &CameraFromWorld| {
                let down = Vector3::new(0.0, 0.0, -1.0);
                (pose.rotation() * down).angle(&(truth.rotation() * down)).to_degrees()
            };
            let Ok(plain) = estimate_pose(&problem, &PoseOptions::default(), &mut rng) else { continue };
            let down = Vector3::new(0.0, 0.0, -1.0);
            let gravity = Gravity { in_camera: truth.rotation() * down, in_world: down, sd_deg: 0.02 };
            problem.gravity = Some(gravity);
            let helped = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
            without += tilt(&plain.cam_from_world);
            with += tilt(&helped.cam_from_world);
            // Thirty degrees wrong, with a standard deviation of two: the prior loses its influence.
            let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.5) * gravity.in_camera;
            problem.gravity = Some(Gravity::from_accelerometer(turned, down));
            if let Ok(misled) = estimate_pose(&problem, &PoseOptions::default(), &mut rng) {
                let right = misled.confidence.state() != State::Trusted || tilt(&misled.cam_from_world) < 5.0;
                assert!(right, "{scheme:?} {seed}");
            }
        }
        assert!(with < 0.2 * without, "{scheme:?}: {with} after {without}");
    }
}

#[test]
fn position_prior_acts_and_is_validated() {
    let (mut problem, truth, mut rng) = few(Scheme::Dcl, 3);
    let plain = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
    problem.position = Some(PositionPrior { center: truth.center(), sd: 1e-3 });
    let held = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
    assert!(held.cam_from_world.translation_error(&truth) < 0.01);
    assert!(held.confidence.center_sd < 2e-3 && held.confidence.center_sd < plain.confidence.center_sd);
    for sd in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        problem.position = Some(PositionPrior { center: truth.center(), sd });
        let refused = estimate_pose(&problem, &PoseOptions::default(), &mut rng);
        assert!(matches!(refused, Err(PoseError::BadValue { .. })), "{sd}");
    }
    problem.position = Some(PositionPrior { center: Point3::new(f64::NAN, 0.0, 0.0), sd: 1.0 });
    let refused = estimate_pose(&problem, &PoseOptions::default(), &mut rng);
    assert!(matches!(refused, Err(PoseError::NotFinite { .. })));
}

/// A problem whose camera has its principal point and focal lengths wrong by these numbers.
fn wrong_camera(
    scheme: Scheme,
    (shift, aspect): ([f64; 2], f64),
    rng: &mut ChaCha8Rng,
) -> (PoseProblem, CameraFromWorld) {
    let (mut problem, truth) = problem(&Setup { scheme, right: 300, wrong: 200, noise: 0.7 }, rng);
    problem.camera.principal = [0, 1].map(|k| problem.camera.principal[k] + shift[k]);
    problem.camera.focal[1] *= aspect;
    (problem, truth)
}

#[test]
fn wrong_principal_point_and_aspect_are_estimated() {
    for scheme in SCHEMES {
        for (shift, aspect) in [
            ([32.0, 0.0], 1.0),
            ([-40.0, 30.0], 1.0),
            ([64.0, -20.0], 1.0),
            ([-120.0, 90.0], 1.0),
            ([0.0, 0.0], 0.9),
        ] {
            for seed in 0..4 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let (problem, truth) = wrong_camera(scheme, (shift, aspect), &mut rng);
                let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
                let error = found.cam_from_world.translation_error(&truth);
                let turn = found.cam_from_world.rotation_error_degrees(&truth);
                let what =
                    format!("{scheme:?} {shift:?} {aspect} {seed}: {error} {turn} {:?}", found.confidence);
                assert_eq!(found.confidence.state(), State::Trusted, "{what}");
                assert!(error < 0.1 && turn < 1.0, "{what}");
                assert!(error < 4.0 * found.confidence.center_sd, "{what}");
                assert!(turn < 4.0 * found.confidence.rotation_sd_deg, "{what}");
                for k in 0..2 {
                    assert!((found.principal_shift_px[k] + shift[k]).abs() < 12.0, "{what}");
                }
            }
        }
    }
}

/// A cropped image whose principal point is taken for its middle, with a focal length that is not calibrated.
#[test]
fn wrong_principal_point_beside_an_open_focal_length_is_estimated_or_covered() {
    for scheme in SCHEMES {
        for (focal, factor) in
            [(FocalPrior::Exif, 1.03), (FocalPrior::Exif, 0.75), (FocalPrior::Unknown, 0.8)]
        {
            for shift in [[0.0, 0.0], [10.0, -6.0], [48.0, 20.0], [-96.0, 72.0]] {
                let mut trusted = 0;
                for seed in 0..4 {
                    let mut rng = ChaCha8Rng::seed_from_u64(seed);
                    let (mut problem, truth) = wrong_camera(scheme, (shift, 1.0), &mut rng);
                    problem.camera.focal = problem.camera.focal.map(|f| f * factor);
                    problem.focal = focal;
                    let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
                    let error = found.cam_from_world.translation_error(&truth);
                    let turn = found.cam_from_world.rotation_error_degrees(&truth);
                    let what = format!(
                        "{scheme:?} {focal:?} {factor} {shift:?} {seed}: {error} {turn} {:?} {:?}",
                        found.principal_shift_px, found.confidence
                    );
                    if found.confidence.state() == State::Trusted {
                        trusted += 1;
                        assert!(error < 4.0 * found.confidence.center_sd, "{what}");
                        assert!(turn < 4.0 * found.confidence.rotation_sd_deg, "{what}");
                    }
                }
                assert!(trusted >= 3, "{scheme:?} {focal:?} {shift:?}: {trusted}");
            }
        }
    }
}

/// A small error of the camera is not estimated, because the map's own cameras have such errors: the covariance covers
/// its effect on the pose.
#[test]
fn small_error_of_principal_point_is_in_the_covariance() {
    for scheme in SCHEMES {
        let (mut inside, mut kept) = (0, 0);
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (problem, truth) = wrong_camera(scheme, ([7.0, -5.0], 1.0), &mut rng);
            let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
            kept += usize::from(found.principal_shift_px == [0.0; 2]);
            let turn = found.cam_from_world.rotation_error_degrees(&truth);
            let covered = found.cam_from_world.translation_error(&truth) < 3.0 * found.confidence.center_sd
                && turn < 3.0 * found.confidence.rotation_sd_deg;
            inside += usize::from(covered);
        }
        assert!(kept >= 19 && inside >= 19, "{scheme:?}: {kept} {inside}");
    }
}

#[test]
fn right_camera_is_not_changed() {
    for scheme in SCHEMES {
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (problem, _) = wrong_camera(scheme, ([0.0; 2], 1.0), &mut rng);
            let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
            assert_eq!((found.principal_shift_px, found.focal_scale), ([0.0; 2], 1.0), "{scheme:?} {seed}");
            assert_eq!(found.confidence.state(), State::Trusted, "{scheme:?} {seed}");
        }
    }
}

/// Barrel distortion that the camera's parameters lack is a doubt, unless the images of the map lack it as well.
#[test]
fn distortion_is_a_doubt_unless_the_map_has_it_as_well() {
    for scheme in SCHEMES {
        let estimate = |map_cameras, seed: u64| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (mut problem, _) = bent(scheme, -0.2, &mut rng);
            problem.map_cameras = map_cameras;
            let mut options = PoseOptions::default();
            options.camera_evidence = true;
            estimate_pose(&problem, &options, &mut rng).expect("a pose")
        };
        let exact = MapCameras { sd: [0.002; 6], min_log_odds: 3.0, min_focal_gain: 0.0 };
        let images: Vec<_> = (100..112).map(|seed| estimate(MapCameras::UNMEASURED, seed)).collect();
        let evidence: Vec<_> = images.iter().filter_map(|image| image.camera_evidence).collect();
        let distorted = MapCameras::fit(&evidence);
        assert!(distorted.sd[5] > 0.1, "{scheme:?} {distorted:?}");
        let doubted = |map| {
            let of_seed = |seed| estimate(map, seed).confidence.doubts().contains(&Doubt::Camera);
            (0..8).filter(|seed| of_seed(*seed)).count()
        };
        let counts = (doubted(exact), doubted(distorted));
        assert!(counts.0 >= 7 && counts.1 <= 1, "{scheme:?} {counts:?}");
    }
}

/// Barrel distortion that the camera's parameters lack: the covariance covers its effect.
#[test]
fn missing_distortion_is_in_the_covariance() {
    for scheme in SCHEMES {
        let (mut inside, mut wider) = (0, 0);
        for seed in 0..10 {
            let [straight, found] = [0.0, -0.1].map(|radial| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let (problem, truth) = bent(scheme, radial, &mut rng);
                let found = estimate_pose(&problem, &PoseOptions::default(), &mut rng).expect("a pose");
                (found.cam_from_world.translation_error(&truth), found.confidence.center_sd)
            });
            inside += usize::from(found.0 < 3.0 * found.1);
            wider += usize::from(found.1 > 1.5 * straight.1);
        }
        assert!(inside >= 9 && wider >= 8, "{scheme:?}: {inside} {wider}");
    }
}

/// A problem whose keypoints have a radial distortion that its camera lacks.
fn bent(scheme: Scheme, radial: f64, rng: &mut ChaCha8Rng) -> (PoseProblem, CameraFromWorld) {
    let (mut problem, truth) = problem(&Setup { scheme, right: 300, wrong: 200, noise: 0.7 }, rng);
    bend(&mut problem, &truth, radial);
    (problem, truth)
}
