//! Attacks of a server that has localized the images: a synthetic scene, sealed, localized and attacked like real
//! ones.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_evaluation::EvalError;
use veiloc_evaluation::attack_evaluation::{
    Attack, AttackDocument, AttackEvaluation, AttackSummary, FrameChoice, MeasuredKeypoints, PrivateRegion,
    ServerKnowledge, evaluate_attacks,
};
use veiloc_geometry::frames::World;
use veiloc_geometry::{CameraFromWorld, PlanePoint, Point3};
use veiloc_protocol::Scheme;

const POINTS: usize = 500;
const FOCAL: f64 = 500.0;

/// Matches in the problem file.
#[derive(Clone, Copy, PartialEq)]
enum Matches {
    /// For every other keypoint, correct.
    Right,
    /// For every other keypoint, with random map points.
    Wrong,
    /// For images with other names.
    OtherNames,
    /// For an image of another size.
    OtherSize,
    /// For keypoints half a pixel away from those of the image.
    OtherKeypoints,
}

/// Keypoints and matches of `frames` images in a new folder.
fn files(frames: usize, matches: Matches) -> (tempfile::TempDir, [PathBuf; 2]) {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let poses: Vec<CameraFromWorld> = (0..frames)
        .map(|_| {
            let step = [0.0; 6].map(|_: f64| rng.random_range(-0.2..0.2));
            CameraFromWorld::identity().perturbed(&step)
        })
        .collect();
    let see = |pose: &CameraFromWorld, x: &Point3<World>| {
        PlanePoint::from_camera_point(&pose.transform(x))
            .map(|p| [FOCAL * p.x + 320.0, FOCAL * p.y + 240.0])
            .filter(|[u, v]| (1.0..639.0).contains(u) && (1.0..479.0).contains(v))
    };
    let mut points = Vec::new();
    while points.len() < POINTS {
        let z = rng.random_range(3.0..6.0);
        let x = Point3::new(z * rng.random_range(-0.6..0.6), z * rng.random_range(-0.45..0.45), z);
        if poses.iter().all(|pose| see(pose, &x).is_some()) {
            points.push(x);
        }
    }
    let bytes: Vec<u8> = (0..POINTS * 16).map(|_| rng.random()).collect();
    let (mut keypoints, mut problems) = (String::new(), String::new());
    for (i, pose) in poses.iter().enumerate() {
        let seen: Vec<[f64; 2]> = points.iter().filter_map(|x| see(pose, x)).collect();
        let image = serde_json::json!({
            "name": format!("p{i}"), "width": 640, "height": 480, "keypoints": seen,
            "descriptors": STANDARD.encode(&bytes), "features": "random", "descriptor_dim": 16,
            "descriptor_encoding": "unsigned", "descriptor_norm": 590,
        });
        let off = if matches == Matches::OtherKeypoints { 0.5 } else { 0.0 };
        let rows: Vec<usize> = (0..POINTS).step_by(2).collect();
        let of = |k: &usize| if matches == Matches::Wrong { (k * 7 + 131) % POINTS } else { *k };
        let t = pose.translation();
        let problem = serde_json::json!({
            "name": if matches == Matches::OtherNames { format!("q{i}") } else { format!("p{i}") },
            "camera": {
                "model": "PINHOLE", "width": if matches == Matches::OtherSize { 641 } else { 640 }, "height": 480,
                "params": [FOCAL, FOCAL, 320.0, 240.0],
            },
            "points2d": rows.iter().map(|k| [seen[*k][0] + off, seen[*k][1]]).collect::<Vec<_>>(),
            "points3d": rows.iter().map(of).map(|k| <[f64; 3]>::from(points[k].coords)).collect::<Vec<_>>(),
            "cam_from_world": {"q": pose.quaternion(), "t": [t.x, t.y, t.z]},
        });
        writeln!(keypoints, "{image}").expect("into memory");
        writeln!(problems, "{problem}").expect("into memory");
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let paths = [write("keypoints.jsonl", &keypoints), write("problems.jsonl", &problems)];
    (folder, paths)
}

fn named(attack: &str) -> Attack {
    attack.parse().expect("an attack of the table")
}

fn evaluation(keypoints: &Path, problems: &Path, attacks: &[Attack]) -> AttackEvaluation {
    AttackEvaluation {
        files: vec![keypoints.to_owned()],
        images: Some(1),
        schemes: vec!["dcl:paper".parse().expect("a scheme")],
        attacks: attacks.to_vec(),
        server: Some(ServerKnowledge {
            problems: vec![problems.to_owned()],
            map_problems: Vec::new(),
            private: None,
            rotated: 0.0,
            measured: MeasuredKeypoints::Hidden,
        }),
        frames: vec![3],
        ..AttackEvaluation::default()
    }
}

fn run(evaluation: &AttackEvaluation) -> Result<AttackDocument, EvalError> {
    evaluate_attacks(evaluation, "", &(), &mut |_| {})
}

fn row(document: &AttackDocument, attack: Attack, frames: Option<usize>) -> &AttackSummary {
    let found = document.attacks.iter().find(|a| a.attack == attack && a.frames == frames);
    found.expect("the row was requested")
}

#[test]
fn server_knows_inliers_and_recovers_others() {
    let (_folder, [keypoints, problems]) = files(6, Matches::Right);
    let attacks = [
        named("server-side"),
        named("iterative"),
        Attack::GRAPH,
        named("guided-transfer"),
        named("several-frames"),
    ];
    let mut options = evaluation(&keypoints, &problems, &attacks);
    options.frames = vec![2, 6];
    let document = run(&options).expect("attacked");
    let server = &document.server[0];
    assert_eq!((server.images, server.trusted, server.scheme.as_str()), (1, 1, "dcl:paper"));
    assert!(
        (server.known - 0.5).abs() < 0.02 && (server.known + server.measured - 1.0).abs() < 1e-9,
        "{server:?}"
    );
    assert!(server.known_median_px < 2.0 && server.known_under_30px > 0.97, "{server:?}");

    let mean = |attack| row(&document, attack, None).mean_px;
    let guess = mean(Attack::PRIOR);
    assert!(mean(named("iterative")) < 0.5 * guess && mean(Attack::GRAPH) < 0.2 * guess, "{document:?}");
    let [two, six] = [2, 6].map(|n| row(&document, named("several-frames"), Some(n)));
    assert!(six.median_px < 0.5 * two.median_px && two.accepted == Some(0.0), "{two:?} {six:?}");
    assert!(six.accepted.expect("reported") > 0.3 && six.accepted_under_10px > Some(0.9), "{six:?}");
    let guided = row(&document, named("guided-transfer"), None);
    assert!(guided.median_px < 10.0 && guided.accepted > Some(0.5), "{guided:?}");

    // With the known keypoints included, half of the errors are those of projections.
    options.attacks = vec![named("iterative")];
    options.server.as_mut().expect("set").measured = MeasuredKeypoints::All;
    let all = run(&options).expect("attacked");
    assert_eq!(all.server[0].measured, 1.0);
    assert!(row(&all, named("iterative"), None).mean_px < mean(named("iterative")));
}

/// Keypoints that the map knows are attacked as well: from the lines of the frames alone, without their positions.
#[test]
fn matched_keypoints_are_attacked_from_lines_alone() {
    let (_folder, [keypoints, problems]) = files(6, Matches::Right);
    let mut options = evaluation(&keypoints, &problems, &[named("several-frames")]);
    options.frames = vec![2, 6];
    options.server.as_mut().expect("set").measured = MeasuredKeypoints::Matched;
    let document = run(&options).expect("attacked");
    let server = &document.server[0];
    assert!((server.measured - server.known).abs() < 1e-9 && server.known > 0.4, "{server:?}");
    // The baseline ignores their positions, and the frames recover them.
    let guess = row(&document, Attack::PRIOR, None);
    let [two, six] = [2, 6].map(|n| row(&document, named("several-frames"), Some(n)));
    assert!(guess.median_px > 50.0, "{guess:?}");
    assert!(two.bits_over_prior > 0.3 && six.median_px < 0.1 * guess.median_px, "{two:?} {six:?}");

    // Selection by rotation against translation is better than by matches, of which all frames have the same number.
    assert_eq!(document.frame_selection, Some(FrameChoice::Turn));
    options.choice = FrameChoice::Nearest;
    let nearest = run(&options).expect("attacked");
    assert_eq!(nearest.frame_selection, Some(FrameChoice::Nearest));
    let near = row(&nearest, named("several-frames"), Some(2));
    assert!(near.bits_over_prior < two.bits_over_prior, "{near:?} {two:?}");
}

/// Without a server or map: the angles of one image sealed several times.
#[test]
fn scatter_of_seals_reveals_positions() {
    let (_folder, [keypoints, problems]) = files(2, Matches::Right);
    let mut options = evaluation(&keypoints, &problems, &[named("static-camera")]);
    options.server = None;
    options.frames = vec![2, 8, 32];
    let bits = |options: &AttackEvaluation| {
        let document = run(options).expect("attacked");
        assert_eq!(document.frame_selection, None);
        [2, 8, 32].map(|n| row(&document, named("static-camera"), Some(n)).bits_over_prior)
    };
    let [two, eight, many] = bits(&options);
    assert!(two > 0.1 && eight > two + 0.4 && many > eight + 0.5, "{two} {eight} {many}");
    // New frames: the detector's noise adds to the dither, and its width does not depend on the distance.
    options.static_noise_px = 0.4;
    let [_, frames, _] = bits(&options);
    assert!(frames > 0.3 && frames < eight, "{frames} {eight}");
    // Random lines intersect.
    options.schemes = vec![Scheme::RandomLines];
    options.static_noise_px = 0.0;
    let document = run(&options).expect("attacked");
    let crossed = row(&document, named("static-camera"), Some(2));
    assert!(crossed.median_px < 3.0, "{crossed:?}");
}

#[test]
fn private_region_has_no_matches() {
    let (_folder, [keypoints, problems]) = files(2, Matches::Right);
    let mut options = evaluation(&keypoints, &problems, &[named("iterative")]);
    options.images = None;
    let hidden = run(&options).expect("attacked");
    options.server.as_mut().expect("set").private = Some(PrivateRegion::Share(0.1));
    let private = run(&options).expect("attacked");
    assert!((private.server[0].measured - 0.1).abs() < 1e-9, "{:?}", private.server);
    let known = |d: &AttackDocument| d.server[0].known;
    // About half of the region's keypoints were matched.
    let lost = known(&hidden) - known(&private);
    assert!((0.02..0.08).contains(&lost), "{lost}");
    assert_eq!(
        run(&options).expect("attacked").attacks[1].mean_px,
        private.attacks[1].mean_px,
        "equal seeds"
    );
}

/// The private region is what is black in the mask, and nothing else.
#[test]
fn masked_region_has_no_matches() {
    let (folder, [keypoints, problems]) = files(2, Matches::Right);
    let mut options = evaluation(&keypoints, &problems, &[named("occlusion")]);
    options.images = None;
    let whole = run(&options).expect("attacked");
    let masks = folder.path().join("masks");
    std::fs::create_dir(&masks).expect("created");
    options.server.as_mut().expect("set").private = Some(PrivateRegion::Masks(masks.clone()));
    run(&options).expect_err("no masks");
    // The left quarter of the image holds a quarter of the keypoints and of the matches.
    let mask =
        |width: u32| image::GrayImage::from_fn(width, 480, |u, _| image::Luma([255 * u8::from(u >= 160)]));
    let save = |width| {
        for name in ["p0", "p1"] {
            mask(width).save(masks.join(format!("{name}.png"))).expect("saved");
        }
    };
    save(640);
    let private = run(&options).expect("attacked");
    let (server, whole) = (&private.server[0], &whole.server[0]);
    assert!((0.2..0.3).contains(&server.measured), "{server:?}");
    assert!((0.68..0.82).contains(&(server.known / whole.known)), "{server:?} {whole:?}");
    save(641);
    let refused = run(&options).expect_err("another size");
    assert!(refused.to_string().contains("641"), "{refused}");
}

/// Rotated descriptors match nothing, and errors are not measured on them.
#[test]
fn rotated_regions_have_no_matches() {
    let (_folder, [keypoints, problems]) = files(2, Matches::Right);
    let mut options = evaluation(&keypoints, &problems, &[named("occlusion")]);
    options.images = None;
    let server = options.server.as_mut().expect("set");
    server.private = Some(PrivateRegion::Share(0.1));
    let whole = run(&options).expect("attacked");
    options.server.as_mut().expect("set").rotated = 0.4;
    let rotated = run(&options).expect("attacked");
    let ratio = rotated.server[0].known / whole.server[0].known;
    assert!((0.4..0.8).contains(&ratio), "{ratio}");
    assert!(rotated.server[0].measured < 0.1 - 1e-9, "{:?}", rotated.server);
    let auc = row(&rotated, named("occlusion"), None).hiding_auc;
    assert!(auc.is_some_and(|auc| (0.0..=1.0).contains(&auc)), "{auc:?}");
}

#[test]
fn mismatched_files_and_missing_poses_are_reported() {
    let refused = |matches| {
        let (_folder, [keypoints, problems]) = files(2, matches);
        run(&evaluation(&keypoints, &problems, &[named("iterative")])).expect_err("refused")
    };
    let error = refused(Matches::OtherNames);
    assert!(matches!(&error, EvalError::NoMatches { image } if image == "p0"), "{error}");
    let error = refused(Matches::OtherSize);
    assert!(matches!(&error, EvalError::OtherSize { size: [641, 480], .. }), "{error}");
    let error = refused(Matches::OtherKeypoints);
    assert!(matches!(&error, EvalError::NoSuchKeypoint { image, .. } if image == "p0"), "{error}");
    let error = refused(Matches::Wrong);
    assert!(matches!(&error, EvalError::NoPose { images: 1, .. }), "{error}");
}

#[test]
fn contradictory_options_are_refused() {
    let (_folder, [keypoints, problems]) = files(2, Matches::Right);
    let check = |attack, expected: &str, change: fn(&mut AttackEvaluation)| {
        let mut options = evaluation(&keypoints, &problems, &[attack]);
        change(&mut options);
        let error = run(&options).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}");
    };
    let private = |share| {
        move |e: &mut AttackEvaluation| {
            e.server.as_mut().expect("set").private = Some(PrivateRegion::Share(share));
        }
    };
    check(named("iterative"), "give its matches", |e| e.server = None);
    check(named("iterative"), "one neighbour", |e| e.k = 0);
    check(named("several-frames"), "at least two", |e| e.frames = vec![1]);
    check(named("static-camera"), "at least two", |e| e.frames = vec![1]);
    check(named("several-frames"), "has 2 images", |e| e.frames = vec![3]);
    check(named("guided-transfer"), "nothing can be transferred", |e| {
        e.server.as_mut().expect("set").private = Some(PrivateRegion::Share(0.1));
    });
    for share in [0.0, 1.0, f64::NAN] {
        let mut options = evaluation(&keypoints, &problems, &[named("iterative")]);
        private(share)(&mut options);
        assert!(matches!(run(&options), Err(EvalError::Options(_))), "{share}");
    }
}
