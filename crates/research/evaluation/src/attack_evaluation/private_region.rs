//! A private region: keypoints that the map does not have, such as those of a person in the image.
//!
//! A private object is not scattered among the map's keypoints: it is a compact region, and its centre is far from
//! every known position. Errors on keypoints that remained unmatched by chance do not represent it.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::{FeatureError, Mask};
use veiloc_geometry::Pixel;

/// Height over width of the region: that of a person from head to hip.
const UPRIGHT: f64 = 2.5;

/// Keypoints in an upright ellipse around a random keypoint that holds this share of all, rounded up: `[N]`.
/// The region depends on seed and name of the image.
pub(super) fn person(keypoints: &[Pixel], share: f64, seed: u64, image: &str) -> Vec<bool> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[image, "private region"]));
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

/// Keypoints at hidden pixels of a mask, `[N]`.
///
/// # Errors
/// [`FeatureError::MaskSize`] when the mask's size is not `size`, the image's.
pub(super) fn masked(keypoints: &[Pixel], size: [u32; 2], mask: &Mask) -> Result<Vec<bool>, FeatureError> {
    let (mask_size, image) = ((mask.width(), mask.height()), size.into());
    if mask_size != image {
        return Err(FeatureError::MaskSize { file: None, mask: mask_size, image });
    }
    let hides = |p: &Pixel| p.u >= 0.0 && p.v >= 0.0 && mask.hides(p.u as u32, p.v as u32);
    Ok(keypoints.iter().map(hides).collect())
}

/// Half heights of the regions of [`rotated`], relative to the image's height.
const HALF_HEIGHTS: [f64; 2] = [0.12, 0.36];
/// Cells of the grid on which their share of the image is counted.
const CELLS: [usize; 2] = [64, 48];

/// Keypoints in random upright ellipses that cover this share of the image, `[N]`: a device that knows neither the map
/// nor what is private sends their descriptors rotated, as those of decoys. So the map is missing there too.
pub(super) fn rotated(keypoints: &[Pixel], size: [u32; 2], share: f64, rng: &mut impl Rng) -> Vec<bool> {
    let mut inside = vec![false; keypoints.len()];
    let [width, height] = size.map(f64::from);
    let mut free: Vec<Pixel> = (0..CELLS[0] * CELLS[1])
        .map(|i| {
            let (x, y) = ((i % CELLS[0]) as f64 + 0.5, (i / CELLS[0]) as f64 + 0.5);
            Pixel::new(x * width / CELLS[0] as f64, y * height / CELLS[1] as f64)
        })
        .collect();
    let left = (1.0 - share.clamp(0.0, 0.9)) * free.len() as f64;
    while free.len() as f64 > left {
        let center = [rng.random_range(0.0..width), rng.random_range(0.0..height)];
        let tall = rng.random_range(HALF_HEIGHTS[0]..HALF_HEIGHTS[1]) * height;
        let is_in = |p: &Pixel| ((p.u - center[0]) * UPRIGHT).hypot(p.v - center[1]) <= tall;
        free.retain(|p| !is_in(p));
        for (inside, p) in inside.iter_mut().zip(keypoints) {
            *inside |= is_in(p);
        }
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn private_region_is_an_ellipse_with_requested_share() {
        let grid: Vec<Pixel> =
            (0..4800).map(|i| Pixel::new(f64::from(i % 80) * 8.0, f64::from(i / 80) * 8.0)).collect();
        for share in [0.05, 0.1, 0.3] {
            let inside = person(&grid, share, 2, "image");
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
        assert!(person(&[], 0.5, 2, "image").is_empty());
    }

    #[test]
    fn keypoints_at_hidden_pixels_are_private() {
        let mask = Mask::new(8, 6, |column, row| column == 3 && row >= 2).expect("some are hidden");
        let at = [[3.0, 2.0], [3.99, 5.99], [4.0, 2.0], [3.5, 1.99], [-0.5, 3.0], [9.0, 3.0]];
        let keypoints = at.map(|[u, v]| Pixel::new(u, v));
        let inside = masked(&keypoints, [8, 6], &mask).expect("of one size");
        assert_eq!(inside, [true, true, false, false, false, false]);
        let refused = masked(&keypoints, [8, 7], &mask).expect_err("another size");
        assert!(matches!(refused, FeatureError::MaskSize { image: (8, 7), .. }), "{refused}");
    }

    #[test]
    fn rotated_regions_cover_the_requested_share() {
        let grid: Vec<Pixel> = (0..4800)
            .map(|i| Pixel::new((f64::from(i % 80) + 0.5) * 8.0, (f64::from(i / 80) + 0.5) * 8.0))
            .collect();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for share in [0.0, 0.2, 0.5] {
            let inside = rotated(&grid, [640, 480], share, &mut rng);
            let covered = inside.iter().filter(|inside| **inside).count() as f64 / 4800.0;
            // The last region may exceed it: the largest has a sixth of the image.
            assert!((share - 0.01..share + 0.18).contains(&covered), "{share}: {covered}");
            assert!(share > 0.0 || covered == 0.0);
        }
    }
}
