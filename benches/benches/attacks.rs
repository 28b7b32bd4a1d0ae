//! The geometry-recovery attack on one image: 2000 keypoints with 20 neighbours each. The reference for the closed form
//! is a direct implementation of Eq. 3: one small least-squares problem per keypoint, solved by SVD.
#![allow(missing_docs, reason = "a bench has no public interface")]

use divan::Bencher;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use veiloc_attacks::{ClosedFormOptions, NeighbourLists, Observation, closed_form, lift, prior_only};
use veiloc_geometry::nalgebra::{DMatrix, DVector};
use veiloc_geometry::{Pencils, Pixel};

fn main() {
    divan::main();
}

const SCHEMES: [&str; 3] = ["random-lines", "coordinate-permutation", "dcl"];

fn image() -> (Vec<Pixel>, NeighbourLists) {
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
        "dcl" => lift::dual_convergent(keypoints, &Pencils::paper(640, 480)),
        _ => lift::coordinate_permutation(keypoints, &mut rng),
    }
}

#[divan::bench(args = SCHEMES)]
fn recovery_closed_form(bencher: Bencher, scheme: &str) {
    let (keypoints, lists) = image();
    let sent = sent(scheme, &keypoints);
    bencher.bench(|| closed_form(&sent, &lists, 640, 480, &ClosedFormOptions::default()));
}

/// Eq. 3 as a linear system: the neighbours' lines, and the keypoint's own line with a large weight, as a constraint.
fn by_least_squares(sent: &[Observation], lists: &NeighbourLists) -> Vec<Pixel> {
    const HEAVY: f64 = 1e4;
    (0..sent.len())
        .into_par_iter()
        .map(|i| {
            let own = sent[i].lines()[0].map(|line| (line, HEAVY));
            let around =
                lists.of(i).iter().filter_map(|&j| sent[j as usize].lines()[0]).map(|line| (line, 1.0));
            let rows: Vec<[f64; 3]> = own
                .into_iter()
                .chain(around)
                .map(|(line, weight)| {
                    let at = |u: f64, v: f64| line.signed_distance(Pixel::new(u, v));
                    let c = at(0.0, 0.0);
                    [weight * (at(1.0, 0.0) - c), weight * (at(0.0, 1.0) - c), -weight * c]
                })
                .collect();
            let a = DMatrix::from_fn(rows.len(), 2, |r, c| rows[r][c]);
            let b = DVector::from_fn(rows.len(), |r, _| rows[r][2]);
            let x = a.svd(true, true).solve(&b, 1e-12).unwrap_or_else(|_| DVector::zeros(2));
            Pixel::new(x[0], x[1])
        })
        .collect()
}

#[divan::bench(args = ["random-lines", "dcl"])]
fn recovery_least_squares(bencher: Bencher, scheme: &str) {
    let (keypoints, lists) = image();
    let sent = sent(scheme, &keypoints);
    // Both must solve the same problem: most results agree to 0.1 px.
    let ours = closed_form(&sent, &lists, 640, 480, &ClosedFormOptions::default()).expect("lists fit");
    let same =
        by_least_squares(&sent, &lists).iter().zip(&ours).filter(|(a, b)| a.distance(&b.pixel) < 0.1).count();
    assert!(same > 1800, "{same} of 2000 answers agree");
    bencher.bench(|| by_least_squares(&sent, &lists));
}

#[divan::bench(args = SCHEMES)]
fn prior_only_baseline(bencher: Bencher, scheme: &str) {
    let (keypoints, _) = image();
    let sent = sent(scheme, &keypoints);
    bencher.bench(|| prior_only(&sent, 640, 480));
}

#[divan::bench]
fn oracle_neighbours(bencher: Bencher) {
    let (keypoints, _) = image();
    bencher.bench(|| NeighbourLists::nearest(&keypoints, 20));
}
