//! The server side on a scene of random points: every scheme, counts of rows and pairs, and refusals.

use super::common;

use common::{open, seal};
use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_geometry::Rigid3;
use veiloc_localization::{LocalizeError, LocalizeOptions, localize, localize_rig};
use veiloc_map::{BuildSettings, MapModel, MapPoint};
use veiloc_obfuscation::{Extracted, KnownPlace, PackUse, Sealer};
use veiloc_protocol::{Pack, SealedFrame, SealedQuery};
use veiloc_testing::pose_in_scene;

#[test]
fn sessions_are_localized_and_invalid_ones_refused() {
    let scene = common::random_scene(1);
    let map = open(&scene.map(8));
    let truth = pose_in_scene(0.13, 0.2);
    // The first frame is the rig; the device turned and moved between the others.
    let sealed = |scheme: &str, k: u64| {
        let cam = pose_in_scene(0.13 - 0.1 * k as f64, 0.2 + 0.15 * k as f64);
        let mut rng = ChaCha20Rng::seed_from_u64(30 + k);
        let query = seal(&scene, scene.features(&cam), scheme, &mut rng);
        SealedFrame {
            query,
            cam_from_rig: Rigid3::new(
                cam.rotation() * truth.rotation().inverse(),
                cam.translation() - cam.rotation() * truth.rotation().inverse() * truth.translation(),
            ),
            rotation_sd_deg: if k == 0 { 0.0 } else { 0.05 },
            translation_sd: if k == 0 { 0.0 } else { 0.005 },
        }
    };
    for scheme in ["points", "random-lines", "dcl"] {
        let frames: Vec<SealedFrame> = (0..4).map(|k| sealed(scheme, k)).collect();
        let found = localize_rig(&frames, &map, &LocalizeOptions::default()).expect("localized");
        assert!(found.frames[0].cam_from_world.translation_error(&truth) < 0.02, "{scheme}");
        assert_eq!((found.frames.len(), found.inlier_frame_count()), (4, 4));
        assert!(found.frames.iter().all(|f| f.inliers > 100 && f.inliers <= f.matches), "{scheme}");
        let single_frame = localize_rig(&frames[..1], &map, &LocalizeOptions::default()).expect("localized");
        let of_query = localize(&frames[0].query, &map, &LocalizeOptions::default()).expect("localized");
        assert!(single_frame.frames[0].cam_from_world.translation_error(&of_query.cam_from_world) < 1e-4);
        assert!(found.confidence.center_sd < 1.1 * single_frame.confidence.center_sd, "{scheme}");
    }
    let none = localize_rig(&[], &map, &LocalizeOptions::default()).expect_err("no frame");
    assert!(none.to_string().contains("rig without frames"), "{none}");
    let other = open(&common::random_scene(2).map(8));
    let frames = [sealed("dcl", 0), sealed("dcl", 1)];
    let wrong = localize_rig(&frames, &other, &LocalizeOptions::default()).expect_err("another map");
    assert!(wrong.to_string().starts_with("frame 0: "), "{wrong}");
}

#[test]
fn every_scheme_localizes() {
    let scene = common::random_scene(1);
    let map = open(&scene.map(8));
    let truth = pose_in_scene(0.13, 0.2);
    for (scheme, bound) in [
        ("points", 0.01),
        ("random-lines", 0.02),
        ("dcl", 0.03),
        ("dcl:horizontal", 0.03),
        ("coordinate-permutation", 0.05),
    ] {
        let mut rng = ChaCha20Rng::seed_from_u64(3);
        let sealed = seal(&scene, scene.features(&truth), scheme, &mut rng);
        let received = SealedQuery::decode(&sealed.encode()).expect("decodes");
        let found = localize(&received, &map, &LocalizeOptions::default()).expect("localized");
        let error = found.cam_from_world.translation_error(&truth);
        assert!(error < bound, "{scheme}: off by {error}");
        assert!(found.cam_from_world.rotation_error_degrees(&truth) < 0.5, "{scheme}");
        assert!(found.inliers > 100 && found.inliers <= found.matches, "{scheme}: {}", found.inliers);
        let again = localize(&received, &map, &LocalizeOptions::default()).expect("localized");
        assert_eq!(found.cam_from_world, again.cam_from_world, "equal seeds give equal poses");
    }
}

#[test]
fn rows_with_several_points_are_counted_once() {
    // Every map point twice, each observed by half of the images, as unfinished tracks leave them: a row has two
    // pairs.
    let scene = common::random_scene(1);
    let whole = scene.map(8);
    let mut halves = whole.clone();
    halves.points = whole
        .points
        .iter()
        .flat_map(|point| {
            let (first, second) = point.track.split_at(point.track.len() / 2);
            [first, second].map(|track| MapPoint { track: track.to_vec(), ..point.clone() })
        })
        .filter(|point| !point.track.is_empty())
        .collect();
    halves.link_keypoints();
    for scheme in ["points", "coordinate-permutation", "dcl"] {
        let mut rng = ChaCha20Rng::seed_from_u64(3);
        let sealed = seal(&scene, scene.features(&pose_in_scene(0.13, 0.2)), scheme, &mut rng);
        let [once, twice] = [&whole, &halves]
            .map(|map| localize(&sealed, &open(map), &LocalizeOptions::default()).expect("localized"));
        assert!(once.inliers <= once.matches && once.matches <= once.pairs, "{scheme}");
        assert_eq!(twice.matches, once.matches, "{scheme}: rows");
        assert!(twice.inliers <= twice.matches && twice.inliers > 100, "{scheme}: {}", twice.inliers);
        assert!(twice.pairs > once.pairs * 3 / 2, "{scheme}: {} pairs", twice.pairs);
        assert!(twice.inlier_pairs > twice.inliers * 3 / 2, "{scheme}: {} agree", twice.inlier_pairs);
        // The same rows observe the same positions, so the evidence must not double.
        let (once, twice) = (once.confidence.log_evidence, twice.confidence.log_evidence);
        assert!(twice < 1.3 * once, "{scheme}: {twice} in place of {once}");
    }
}

#[test]
fn query_for_another_map_is_refused() {
    let (scene, other) = (common::random_scene(1), common::random_scene(2));
    let map = open(&scene.map(8));
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    let sealed = seal(&other, other.features(&pose_in_scene(0.0, 0.0)), "dcl", &mut rng);
    let refused = localize(&sealed, &map, &LocalizeOptions::default()).expect_err("another profile");
    assert!(matches!(refused, LocalizeError::WrongProfile { .. }), "{refused}");
    assert!(refused.to_string().contains("veiloc map profile"), "{refused}");
}

#[test]
fn out_of_map_query_is_not_localized() {
    // The same vocabulary, but points of another scene: matches exist, a pose must not.
    let scene = common::random_scene(1);
    let map = open(&scene.map(8));
    let mut negative = common::random_scene(2);
    negative.profile = scene.profile.clone();
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    let sealed = seal(&scene, negative.features(&pose_in_scene(0.0, 0.0)), "points", &mut rng);
    let lost = localize(&sealed, &map, &LocalizeOptions::default()).expect_err("nothing agrees");
    assert!(matches!(lost, LocalizeError::NoPose { .. }), "{lost}");
}

#[test]
fn empty_map_is_reported() {
    let scene = common::random_scene(1);
    let map = open(&MapModel::empty(scene.profile.clone(), BuildSettings::default()));
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    let sealed = seal(&scene, scene.features(&pose_in_scene(0.0, 0.0)), "dcl", &mut rng);
    let refused = localize(&sealed, &map, &LocalizeOptions::default()).expect_err("nothing to find");
    assert!(matches!(refused, LocalizeError::EmptyMap), "{refused}");
}

/// A device with the pack of the map matches by itself; the server gets points and no descriptors.
#[test]
fn match_queries_are_localized() {
    let scene = common::random_scene(1);
    let map = open(&scene.map(8));
    let truth = pose_in_scene(0.13, 0.2);
    let (pack, points) = map.pack().expect("it has points");
    assert_eq!(points.len(), pack.point_count() as usize);
    let received = Pack::decode(&pack.encode()).expect("a pack");
    let place = KnownPlace::new(received).expect("sift");
    for (scheme, bound) in
        [("points", 0.01), ("random-lines", 0.02), ("dcl", 0.03), ("coordinate-permutation", 0.05)]
    {
        for usage in [PackUse::Explained, PackUse::Matches] {
            let options = common::sealer(&scene, scheme).options().clone().with_place(place.clone(), usage);
            let sealer = Sealer::new(&scene.profile, options).expect("its profile");
            let extracted = Extracted::new(scene.features(&truth), scene.camera);
            let query = sealer.seal(extracted, &mut ChaCha20Rng::seed_from_u64(3)).expect("sealed");
            let query = SealedQuery::decode(&query.encode()).expect("decodes");
            assert_eq!(query.descriptors().is_some(), usage == PackUse::Explained);
            let found = localize(&query, &map, &LocalizeOptions::default()).expect("localized");
            let error = found.cam_from_world.translation_error(&truth);
            assert!(error < bound, "{scheme} {usage:?}: off by {error}");
            assert!(
                found.inliers > 100 && !found.retrieved.is_empty(),
                "{scheme} {usage:?}: {}",
                found.inliers
            );
        }
    }
}

#[test]
fn matches_of_another_pack_are_refused() {
    let scene = common::random_scene(1);
    let (map, smaller) = (open(&scene.map(8)), open(&scene.map(7)));
    let (pack, _) = smaller.pack().expect("it has points");
    let place = KnownPlace::new(pack).expect("sift");
    let options = common::sealer(&scene, "dcl").options().clone().with_place(place, PackUse::Matches);
    let sealer = Sealer::new(&scene.profile, options).expect("its profile");
    let extracted = Extracted::new(scene.features(&pose_in_scene(0.13, 0.2)), scene.camera);
    let query = sealer.seal(extracted, &mut ChaCha20Rng::seed_from_u64(3)).expect("sealed");
    localize(&query, &smaller, &LocalizeOptions::default()).expect("its own map");
    // The profile is the same, but points have other numbers.
    let refused = localize(&query, &map, &LocalizeOptions::default()).expect_err("another pack");
    assert!(matches!(refused, LocalizeError::WrongProfile { .. }), "{refused}");
    assert!(refused.to_string().contains("veiloc map pack"), "{refused}");
}
