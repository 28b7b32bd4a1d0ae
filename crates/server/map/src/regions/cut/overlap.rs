//! Selects the overlap of a region.

use std::collections::BTreeMap;

use super::covisibility::Covisibility;

/// Up to `max` images outside of the core that share most with it, in ascending order.
///
/// An image at the border of a core observes points that also images outside observe. The score of an outside image
/// is the sum over the core of the share of an image's shared points that it shares with this image: it is chosen for
/// the images that need it. Images without shared points are not chosen.
pub(super) fn beside(shared: &Covisibility, core: &[u32], max: usize) -> Vec<u32> {
    let mut score: BTreeMap<u32, f64> = BTreeMap::new();
    for image in core {
        let sum = shared.sum(*image) as f64;
        for (other, count) in
            shared.neighbours(*image).filter(|(other, _)| core.binary_search(other).is_err())
        {
            *score.entry(other).or_default() += f64::from(count) / sum;
        }
    }
    let mut best: Vec<(u32, f64)> = score.into_iter().collect();
    best.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    best.truncate(max);
    let mut beside: Vec<u32> = best.into_iter().map(|(image, _)| image).collect();
    beside.sort_unstable();
    beside
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlap_has_the_images_that_share_most() {
        // Image 0 shares everything with 1; image 1 most of it with 2, and a little with 3. No image shares points
        // with 4.
        let shared =
            Covisibility::of_lists(vec![vec![(1, 900)], vec![(2, 90), (3, 10)], vec![], vec![], vec![]]);
        assert_eq!(beside(&shared, &[0, 1], 1), [2]);
        assert_eq!(beside(&shared, &[0, 1], 9), [2, 3]);
        assert_eq!(beside(&shared, &[0, 1], 0), [] as [u32; 0]);
        assert_eq!(beside(&shared, &[4], 9), [] as [u32; 0]);
        assert_eq!(beside(&shared, &[2], 9), [1]);
    }
}
