//! Neighbours predicted from descriptors, and transfer from a server's map.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    AttackError, DecodedDescriptors, ErrorSummary, KnownImage, NeighbourLists, NeighbourPredictor,
    Observation, errors_px, lift, prior_only, transfer,
};
use veiloc_geometry::{Pencils, Pixel};

const DIMENSION: usize = 16;

/// Keypoints whose descriptors vary with the position like a random smooth texture, plus independent noise.
fn image(seed: u64, signal: f64) -> (Vec<Pixel>, Vec<u8>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let waves: Vec<[f64; 3]> = (0..DIMENSION)
        .map(|_| {
            let (angle, phase) =
                (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(0.0..std::f64::consts::TAU));
            [0.02 * f64::cos(angle), 0.02 * f64::sin(angle), phase]
        })
        .collect();
    let keypoints: Vec<Pixel> =
        (0..600).map(|_| Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0))).collect();
    let mut bytes = Vec::new();
    for p in &keypoints {
        for [a, b, phase] in &waves {
            let texture = (a * p.u + b * p.v + phase).sin();
            let value = 128.0 + 40.0 * signal * texture + rng.random_range(-40.0..40.0);
            bytes.push(value as u8);
        }
    }
    (keypoints, bytes)
}

fn known((keypoints, bytes): (Vec<Pixel>, Vec<u8>)) -> KnownImage {
    let descriptors = DecodedDescriptors::new(&bytes, DIMENSION).expect("whole descriptors");
    KnownImage::new(keypoints, descriptors, 640, 480).expect("one each")
}

#[test]
fn neighbours_are_predicted_from_smooth_texture_and_not_from_noise() {
    let precision = |signal: f64| {
        let training: Vec<KnownImage> = (0..4).map(|s| known(image(s, signal))).collect();
        let predictor = NeighbourPredictor::fit(&training, 20).expect("something to learn");
        let (keypoints, bytes) = image(99, signal);
        let victim = DecodedDescriptors::new(&bytes, DIMENSION).expect("whole");
        let predicted = predictor.predict(&victim, 20).expect("the same dimension");
        for i in 0..keypoints.len() {
            assert_eq!(predicted.of(i).len(), 20);
            assert!(!predicted.of(i).contains(&(i as u32)));
        }
        assert_eq!(predicted, predictor.predict(&victim, 20).expect("again"));
        predicted.precision(&NeighbourLists::nearest(&keypoints, 20))
    };
    let chance = 20.0 / 599.0;
    let (texture, noise) = (precision(1.0), precision(0.0));
    assert!(texture > 6.0 * chance, "{texture}, chance {chance}");
    assert!((noise / chance - 1.0).abs() < 0.3, "{noise}, chance {chance}");
}

#[test]
fn map_image_of_the_same_scene_gives_positions_and_neighbours() {
    let (keypoints, bytes) = image(5, 1.0);
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    // The map image shows the same points shifted by 12 px, in another order and with noise.
    let mut order: Vec<usize> = (0..keypoints.len()).collect();
    for i in (1..order.len()).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
    let shifted: Vec<Pixel> =
        order.iter().map(|&i| Pixel::new(keypoints[i].u + 12.0, keypoints[i].v)).collect();
    let noisy: Vec<u8> = order
        .iter()
        .flat_map(|&i| bytes[i * DIMENSION..(i + 1) * DIMENSION].to_vec())
        .map(|b| b.saturating_add(rng.random_range(0..4)))
        .collect();
    let map = [known(image(6, 1.0)), known((shifted, noisy))];
    let query = DecodedDescriptors::new(&bytes, DIMENSION).expect("whole");
    let found = transfer(&query, &map, (640, 480), 1, 20).expect("the same dimension");
    let sent = lift::dual_convergent(&keypoints, &Pencils::paper(640, 480));
    let median = |answers: Vec<Pixel>| ErrorSummary::of(&errors_px(answers, &keypoints)).median_px;
    let (attack, prior) = (median(found.projected(&sent, 640, 480)), median(prior_only(&sent, 640, 480)));
    assert!(attack < 12.0 && prior > 50.0, "{attack}, prior {prior}");
    let precision = found.neighbours.precision(&NeighbourLists::nearest(&keypoints, 20));
    assert!(precision > 0.9, "{precision}");

    let without = transfer(&query, &[], (640, 480), 3, 20).expect("an empty map is a map");
    assert!(without.positions.iter().all(Option::is_none));
    assert_eq!(without.projected(&sent, 640, 480), prior_only(&sent, 640, 480));
}

#[test]
fn positions_are_projected_on_the_nearer_line_and_known_ones_kept() {
    let (keypoints, bytes) = image(5, 1.0);
    let query = DecodedDescriptors::new(&bytes, DIMENSION).expect("whole");
    let map = [known((keypoints.clone(), bytes))];
    let found = transfer(&query, &map, (640, 480), 1, 5).expect("the same dimension");
    let either: Vec<Observation> =
        keypoints.iter().map(|p| Observation::permuted(Pixel::new(p.u, (p.v + 200.0) % 480.0))).collect();
    let permuted: Vec<Observation> =
        keypoints.iter().map(|p| Observation::Known(Pixel::new(p.v, p.u))).collect();
    for (p, answer) in keypoints.iter().zip(found.projected(&either, 640, 480)) {
        assert!(p.distance(&answer) < 1e-9, "{p:?} {answer:?}");
    }
    for (p, answer) in keypoints.iter().zip(found.projected(&permuted, 640, 480)) {
        assert_eq!(answer, Pixel::new(p.v, p.u));
    }
}

#[test]
fn mismatched_dimensions_are_refused() {
    assert!(matches!(DecodedDescriptors::new(&[1, 2, 3], 2), Err(AttackError::Descriptors { .. })));
    assert!(matches!(DecodedDescriptors::new(&[1], 0), Err(AttackError::Descriptors { .. })));
    let two = DecodedDescriptors::new(&[1, 2, 3, 4], 2).expect("two of dimension 2");
    let count = KnownImage::new(vec![Pixel::new(1.0, 1.0)], two.clone(), 9, 9);
    assert!(matches!(count, Err(AttackError::DescriptorCount { keypoints: 1, descriptors: 2 })));
    assert_eq!(NeighbourPredictor::fit(&[], 20), Err(AttackError::NothingToLearn));
    let one =
        KnownImage::new(vec![Pixel::new(1.0, 1.0)], DecodedDescriptors::new(&[1, 2], 2).expect("one"), 9, 9);
    assert_eq!(NeighbourPredictor::fit(&[one.expect("one")], 20), Err(AttackError::NothingToLearn));
    let predictor = NeighbourPredictor::fit(&[known(image(0, 1.0))], 20).expect("something to learn");
    let dimensions = AttackError::Dimensions { expected: DIMENSION, found: 2 };
    assert_eq!(predictor.predict(&two, 20), Err(dimensions));
    let map = [known(image(0, 1.0))];
    assert!(matches!(transfer(&two, &map, (9, 9), 1, 20), Err(AttackError::Dimensions { .. })));
}
