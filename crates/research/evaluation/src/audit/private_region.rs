//! A private region: keypoints that the map does not have, such as those of a person in the image.
//!
//! A private object is not scattered among the map's keypoints: it is a compact region, and its centre is far from
//! every known position. Errors on keypoints that remained unmatched by chance do not represent it.

use rand::Rng;
use veiloc_geometry::Pixel;

/// Height over width of the region: that of a person from head to hip.
const UPRIGHT: f64 = 2.5;

/// Keypoints in an upright ellipse around a random keypoint that holds this share of all, rounded up: `[N]`.
pub fn person(keypoints: &[Pixel], share: f64, rng: &mut impl Rng) -> Vec<bool> {
    let mut inside = vec![false; keypoints.len()];
    if keypoints.is_empty() {
        return inside;
    }
    let center = keypoints[rng.random_range(0..keypoints.len())];
    let mut order: Vec<(f64, usize)> = keypoints
        .iter()
        .enumerate()
        .map(|(i, p)| ((p.u - center.u).hypot((p.v - center.v) / UPRIGHT), i))
        .collect();
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let count = (share * keypoints.len() as f64).ceil() as usize;
    for (_, i) in order.into_iter().take(count) {
        inside[i] = true;
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn private_region_is_an_ellipse_with_requested_share() {
        let grid: Vec<Pixel> =
            (0..4800).map(|i| Pixel::new(f64::from(i % 80) * 8.0, f64::from(i / 80) * 8.0)).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for share in [0.05, 0.1, 0.3] {
            let inside = person(&grid, share, &mut rng);
            let members: Vec<Pixel> = grid.iter().zip(&inside).filter(|m| *m.1).map(|m| *m.0).collect();
            assert_eq!(members.len(), (share * 4800.0_f64).ceil() as usize);
            // Compact: every keypoint between two members of a row is a member.
            for row in 0..60 {
                let members: Vec<usize> = (0..80).filter(|c| inside[row * 80 + c]).collect();
                let ends = members.first().zip(members.last());
                assert!(ends.is_none_or(|(a, b)| b - a + 1 == members.len()), "row {row} has a gap");
            }
            let extent = |of: fn(&Pixel) -> f64| {
                let (low, high) =
                    members.iter().map(of).fold((f64::MAX, f64::MIN), |m, x| (m.0.min(x), m.1.max(x)));
                high - low
            };
            assert!(extent(|p| p.v) > 1.0 * extent(|p| p.u), "upright");
        }
        assert!(person(&[], 0.5, &mut rng).is_empty());
    }
}
