//! The geometry-recovery attack on one picture: 2000 keypoints, 20 neighbours each.
#![allow(missing_docs, reason = "a bench has no readers of its interface")]

use divan::Bencher;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{ClosedFormOptions, NeighbourLists, Observation, closed_form, lift, prior_only};
use veiloc_geometry::{DualAnchors, Pixel};

fn main() {
    divan::main();
}

const SCHEMES: [&str; 3] = ["random-lines", "coordinate-permutation", "dcl"];

fn picture() -> (Vec<Pixel>, NeighbourLists) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let keypoints: Vec<Pixel> =
        (0..2000).map(|_| Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0))).collect();
    let lists = NeighbourLists::nearest(&keypoints, 20);
    (keypoints, lists)
}

fn sent(scheme: &str, keypoints: &[Pixel]) -> Vec<Observation> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    match scheme {
        "random-lines" => lift::random_lines(keypoints, &mut rng),
        "dcl" => lift::dual_convergent(keypoints, &DualAnchors::vertical(640, 480)),
        _ => lift::coordinate_permutation(keypoints, &mut rng),
    }
}

#[divan::bench(args = SCHEMES)]
fn recovery_closed_form(bencher: Bencher, scheme: &str) {
    let (keypoints, lists) = picture();
    let sent = sent(scheme, &keypoints);
    bencher.bench(|| closed_form(&sent, &lists, 640, 480, &ClosedFormOptions::default()));
}

#[divan::bench(args = SCHEMES)]
fn guess_prior_only(bencher: Bencher, scheme: &str) {
    let (keypoints, _) = picture();
    let sent = sent(scheme, &keypoints);
    bencher.bench(|| prior_only(&sent, 640, 480));
}

#[divan::bench]
fn neighbours_of_an_oracle(bencher: Bencher) {
    let (keypoints, _) = picture();
    bencher.bench(|| NeighbourLists::nearest(&keypoints, 20));
}
