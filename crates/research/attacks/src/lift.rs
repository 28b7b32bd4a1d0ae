//! Textbook obfuscation: exact lines, no dither, no quantization, no wire.
//!
//! For tests and benches, where the true keypoint must lie exactly on the line. Audits attack what a device sends,
//! with dither and quantization: the obfuscation crate makes it, and [`Observation::of_sent`] reads it.

use std::f64::consts::PI;

use rand::Rng;
use rand::seq::SliceRandom;
use veiloc_geometry::{Pencils, Pixel, PixelLine};

use crate::observation::Observation;

/// One line through each keypoint, in a direction drawn uniformly (paper's reference: Speciale et al., ICCV 2019).
pub fn random_lines(keypoints: &[Pixel], rng: &mut impl Rng) -> Vec<Observation> {
    keypoints.iter().map(|&p| Observation::Line(PixelLine::through(p, rng.random_range(0.0..PI)))).collect()
}

/// Keypoints paired at random; the two of a pair swap one coordinate, chosen by a coin (the paper's reference: Pan et
/// al., 2023). Each keypoint then lies on the vertical or on the horizontal line through its sent position. With an
/// odd count the last keypoint swaps with an already used one, and is sent with one coordinate of that one.
pub fn coordinate_permutation(keypoints: &[Pixel], rng: &mut impl Rng) -> Vec<Observation> {
    let mut order: Vec<usize> = (0..keypoints.len()).collect();
    order.shuffle(rng);
    let mut sent = keypoints.to_vec();
    for pair in order.chunks(2) {
        let a = pair[0];
        let b = pair.get(1).copied().unwrap_or(order[0]);
        let swap_u = rng.random::<bool>();
        let mixed = |own: Pixel, other: Pixel| {
            if swap_u { Pixel::new(other.u, own.v) } else { Pixel::new(own.u, other.v) }
        };
        sent[a] = mixed(keypoints[a], keypoints[b]);
        if pair.len() == 2 {
            sent[b] = mixed(keypoints[b], keypoints[a]);
        }
    }
    sent.into_iter().map(Observation::permuted).collect()
}

/// Dual Convergent Lines: each keypoint joined to the anchor of its side.
pub fn dual_convergent(keypoints: &[Pixel], anchors: &Pencils) -> Vec<Observation> {
    keypoints
        .iter()
        .map(|&p| {
            let anchor = anchors.anchor_of(p);
            Observation::anchored(anchors, anchor, anchors.angle_of(anchor, p))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn keypoints_lie_on_their_lines() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for n in [0, 1, 2, 101] {
            let points: Vec<Pixel> = (0..n)
                .map(|_| Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)))
                .collect();
            let dcl = dual_convergent(&points, &Pencils::paper(640, 480));
            let schemes = [random_lines(&points, &mut rng), coordinate_permutation(&points, &mut rng), dcl];
            for sent in schemes {
                assert_eq!(sent.len(), n);
                assert!(sent.iter().zip(&points).all(|(o, &p)| o.distance(p) < 1e-9));
            }
        }
    }
}
