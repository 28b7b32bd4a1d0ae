//! The gravity direction of a query is used if the map has one, ignored otherwise, and never a reason to trust a
//! pose.

use super::common;

use common::{open, sealer};
use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_features::Features;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Rotation3, Unit, Vector3};
use veiloc_localization::{Localization, LocalizeOptions, localize};
use veiloc_map::{GravityDirection, MapFile, MapModel};
use veiloc_obfuscation::Extracted;
use veiloc_pose::State;
use veiloc_protocol::{CoarseGravity, GravityUse, SealedQuery};
use veiloc_testing::pose_in_scene;

const SCHEMES: [&str; 3] = ["points", "random-lines", "dcl"];

/// The gravity direction of the scene: its cameras are roughly upright.
const DOWN: [f64; 3] = [0.1, 0.9, -0.2];

fn map(down: Option<GravityDirection>) -> MapFile {
    open(&MapModel { down, ..common::random_scene(1).map(8) })
}

fn down() -> GravityDirection {
    GravityDirection::new(DOWN).expect("a direction")
}

/// The measured gravity direction, rotated by an error in degrees.
fn measured(truth: &CameraFromWorld, degrees: f64, sd_deg: f64) -> CoarseGravity {
    let exact = truth.rotation() * Vector3::from(DOWN);
    let axis = Unit::new_normalize(exact.cross(&Vector3::new(0.4, 0.1, 0.9)));
    let turned = Rotation3::from_axis_angle(&axis, degrees.to_radians()) * exact;
    CoarseGravity::new(turned.into(), sd_deg).expect("a direction")
}

fn sealed(scheme: &str, features: Features, gravity: Option<CoarseGravity>) -> SealedQuery {
    let scene = common::random_scene(1);
    let extracted = Extracted::new(features, scene.camera).with_gravity(gravity);
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    let query = sealer(&scene, scheme).seal(extracted, &mut rng).expect("sealed");
    SealedQuery::decode(&query.encode()).expect("decodes")
}

fn found(query: &SealedQuery, map: &MapFile) -> Option<Localization> {
    localize(query, map, &LocalizeOptions::default()).ok()
}

#[test]
fn use_of_gravity_is_reported() {
    let truth = pose_in_scene(0.13, 0.2);
    let gravity = Some(measured(&truth, 0.0, 1.0));
    for (gravity, down, used) in [
        (None, None, GravityUse::NotProvided),
        (None, Some(down()), GravityUse::NotProvided),
        (gravity, None, GravityUse::UnknownInMap),
        (gravity, Some(down()), GravityUse::Used),
    ] {
        let query = sealed("dcl", common::random_scene(1).features(&truth), gravity);
        let found = found(&query, &map(down)).expect("localized");
        assert_eq!(found.gravity, used);
        assert_eq!(found.state, State::Trusted);
        assert!(found.cam_from_world.translation_error(&truth) < 0.03);
    }
}

/// Without a gravity direction, a map gives the same answer with and without gravity in the query.
#[test]
fn gravity_is_ignored_without_gravity_in_the_map() {
    let truth = pose_in_scene(0.13, 0.2);
    let map = map(None);
    let pose_of = |gravity| {
        found(&sealed("dcl", common::random_scene(1).features(&truth), gravity), &map)
            .expect("localized")
            .cam_from_world
    };
    assert_eq!(pose_of(None), pose_of(Some(measured(&truth, 30.0, 0.5))));
}

/// Few keypoints, shifted by some pixels, as in a dark or occluded image.
fn poor(truth: &CameraFromWorld, seed: usize) -> Features {
    let all = common::random_scene(1).features(truth);
    let selected: Vec<usize> =
        (0..all.keypoints.len()).filter(|i| (i * 7 + seed).is_multiple_of(19)).collect();
    let mut few = Features {
        keypoints: selected.iter().map(|i| all.keypoints[*i]).collect(),
        descriptors: all.descriptors.select(selected.iter().copied()),
        global: None,
    };
    for (i, keypoint) in few.keypoints.iter_mut().enumerate() {
        let angle = (i * 37 + seed) as f64;
        keypoint.pixel.u += 4.0 * angle.sin();
        keypoint.pixel.v += 4.0 * angle.cos();
    }
    few
}

#[test]
fn gravity_improves_poor_images() {
    let map = map(Some(down()));
    for scheme in ["random-lines", "dcl"] {
        let (mut with, mut without) = (0.0, 0.0);
        for seed in 0..12 {
            let truth = pose_in_scene(0.02 * seed as f64, 0.1);
            let tilt = |gravity| {
                let found = found(&sealed(scheme, poor(&truth, seed), gravity), &map).expect("localized");
                let down = Vector3::from(DOWN);
                (found.cam_from_world.rotation() * down).angle(&(truth.rotation() * down)).to_degrees()
            };
            without += tilt(None);
            with += tilt(Some(measured(&truth, 0.0, 0.5)));
        }
        assert!(with < 0.85 * without, "{scheme}: {with} after {without}");
    }
}

#[test]
fn wrong_gravity_makes_no_wrong_pose_trusted() {
    let map = map(Some(down()));
    let mut trusted = 0;
    for scheme in SCHEMES {
        for seed in 0..4 {
            let truth = pose_in_scene(0.02 * seed as f64, 0.1);
            let without = found(&sealed(scheme, poor(&truth, seed), None), &map);
            for degrees in [5.0, 30.0, 120.0] {
                for sd_deg in [0.5, 2.0] {
                    let query = sealed(scheme, poor(&truth, seed), Some(measured(&truth, degrees, sd_deg)));
                    let Some(with) = found(&query, &map).filter(|f| f.state == State::Trusted) else {
                        continue;
                    };
                    let what = format!("{scheme} {seed}: {degrees}° ± {sd_deg}°");
                    let without = without.as_ref().filter(|f| f.state == State::Trusted);
                    let without = without.unwrap_or_else(|| panic!("{what}: trusted only with gravity"));
                    let off = with.cam_from_world.translation_error(&truth);
                    let own = without.cam_from_world.translation_error(&truth);
                    assert!(off < own + 3.0 * without.confidence.center_sd, "{what}: {off} after {own}");
                    trusted += 1;
                }
            }
        }
    }
    assert!(trusted > 12, "only {trusted} poses are trusted");
}
