//! The images beside a core that a region takes along.

use std::collections::BTreeMap;

use super::covisibility::Covisibility;

/// Up to `most` images that are not in the core and share most with it, in rising order.
///
/// An image at the border of a core has part of what it sees on the other side. So an image beside the core is worth the
/// share of all that images of the core share with others which they share with it, summed over the core: it is taken for
/// those that need it. Images that share nothing with the core are not taken, be there room or not.
pub(super) fn beside(shared: &Covisibility, core: &[u32], most: usize) -> Vec<u32> {
    let mut worth: BTreeMap<u32, f64> = BTreeMap::new();
    for image in core {
        let sum = shared.sum(*image) as f64;
        for (other, count) in
            shared.neighbours(*image).filter(|(other, _)| core.binary_search(other).is_err())
        {
            *worth.entry(other).or_default() += f64::from(count) / sum;
        }
    }
    let mut best: Vec<(u32, f64)> = worth.into_iter().collect();
    best.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    best.truncate(most);
    let mut beside: Vec<u32> = best.into_iter().map(|(image, _)| image).collect();
    beside.sort_unstable();
    beside
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_shares_most_with_those_at_the_border_comes_along() {
        // Image 0 shares everything with 1; image 1 most of what it sees with 2, and a little with 3. Nobody sees 4.
        let shared =
            Covisibility::of_lists(vec![vec![(1, 900)], vec![(2, 90), (3, 10)], vec![], vec![], vec![]]);
        assert_eq!(beside(&shared, &[0, 1], 1), [2]);
        assert_eq!(beside(&shared, &[0, 1], 9), [2, 3]);
        assert_eq!(beside(&shared, &[0, 1], 0), [] as [u32; 0]);
        assert_eq!(beside(&shared, &[4], 9), [] as [u32; 0]);
        assert_eq!(beside(&shared, &[2], 9), [1]);
    }
}
