//! Places that look alike: images of the second one are retrieved too, and the pose is doubtful.

use super::common;

use common::{open, seal};
use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_localization::retrieval::{retrieve, retrieve_with_other_places};
use veiloc_localization::{LocalizeOptions, localize};
use veiloc_pose::State;
use veiloc_testing::{pose_in_scene, with_copy};

/// Position of the copy relative to the original, map units.
const AWAY: Vector3<f64> = Vector3::new(20.0, 5.0, 0.0);

#[test]
fn images_of_a_place_that_looks_alike_are_retrieved_and_make_the_pose_doubtful() {
    let scene = common::random_scene(1);
    let (plain, twin) = (scene.map(10), with_copy(&scene.map(10), 3, AWAY));
    twin.validate().expect("a map");
    // Beside the last images, so that the copies of the first ones are not among the four most similar.
    let truth = pose_in_scene(0.35, 0.1);
    let mut settings = LocalizeOptions::default();
    settings.retrieve = 4;
    for scheme in ["points", "random-lines", "dcl"] {
        let rng = &mut ChaCha20Rng::seed_from_u64(3);
        let query = seal(&scene, scene.features(&truth), scheme, rng);
        let found = localize(&query, &open(&plain), &settings).expect("localized");
        assert_eq!(
            (found.state, found.retrieved.len()),
            (State::Trusted, 4),
            "{scheme}: {:?}",
            found.confidence
        );

        let map = open(&twin);
        let is_copy = |image: usize| image >= 10;
        let nearest = retrieve(query.global().expect("of rows"), (&map).into(), 4);
        assert!(nearest.iter().all(|image| !is_copy(image.image)), "{scheme}: {nearest:?}");
        let places = retrieve_with_other_places(query.global().expect("of rows"), (&map).into(), 4);
        assert_eq!(places[..4], nearest, "{scheme}");
        assert!(
            places.len() > 4 && places[4..].iter().all(|image| is_copy(image.image)),
            "{scheme}: {places:?}"
        );

        let found = localize(&query, &map, &settings).expect("localized");
        assert!(found.cam_from_world.translation_error(&truth) < 0.1, "{scheme}");
        assert_eq!(found.state, State::Doubtful, "{scheme}: {:?}", found.confidence);
        let rival = found.rival.expect("a pose in the copy").cam_from_world.center().coords;
        assert!((rival - truth.center().coords - AWAY).norm() < 1.0, "{scheme}: {rival}");
    }
}
