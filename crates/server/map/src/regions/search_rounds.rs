//! Selects the regions in which a query is searched, and the best of their poses; shared by the gateway of a cluster
//! and the evaluation.

/// Default maximum number of regions in which a query is searched.
pub const DEFAULT_SEARCHED_REGIONS: usize = 3;

/// Regions with at least this share of the images of the best one are searched together with it.
const BESIDE: f64 = 0.75;

/// The regions to search together, and those to search only if none of the first gives a trusted pose; `most` in
/// total.
///
/// `ranked`: regions with their number of retrieved images, best first, from
/// [`RegionIndex::rank`](crate::regions::RegionIndex::rank). A region with nearly as many as the best one may be the
/// right one as well. A region with fewer is mostly a neighbour, whose images are also in the overlap of the best one:
/// searching it at once would usually waste a localization.
pub fn search_rounds(ranked: impl IntoIterator<Item = (usize, usize)>, most: usize) -> Vec<Vec<usize>> {
    let selected: Vec<(usize, usize)> = ranked.into_iter().take(most).collect();
    let threshold = selected.first().map_or(0.0, |(_, held)| *held as f64 * BESIDE);
    let (first, second): (Vec<_>, Vec<_>) =
        selected.into_iter().partition(|(_, held)| *held as f64 >= threshold);
    let numbers = |some: Vec<(usize, usize)>| some.into_iter().map(|(region, _)| region).collect();
    [first, second].into_iter().filter(|some| !some.is_empty()).map(numbers).collect()
}

/// Whether the pose of one region is preferred to another; for each, whether it is trusted, and its evidence.
pub fn is_better_pose((trusted, evidence): (bool, f64), (than_trusted, than_evidence): (bool, f64)) -> bool {
    trusted.cmp(&than_trusted).then(evidence.total_cmp(&than_evidence)).is_gt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_searched_in_the_second_round() {
        for (held, most, expected) in [
            (&[10][..], 3, vec![vec![5]]),
            (&[10, 6, 4, 3], 3, vec![vec![5], vec![6, 7]]),
            (&[8, 7, 6, 5], 3, vec![vec![5, 6, 7]]),
            (&[8, 7, 6, 5], 2, vec![vec![5, 6]]),
            (&[10, 6, 4], 1, vec![vec![5]]),
            (&[], 3, vec![]),
        ] {
            let ranked = held.iter().enumerate().map(|(i, held)| (i + 5, *held));
            assert_eq!(search_rounds(ranked, most), expected, "{held:?} of {most}");
        }
    }

    #[test]
    fn trust_comes_before_evidence() {
        assert!(is_better_pose((true, 20.0), (false, 90.0)) && !is_better_pose((false, 90.0), (true, 20.0)));
        assert!(is_better_pose((true, 30.0), (true, 20.0)) && !is_better_pose((true, 20.0), (true, 20.0)));
        assert!(is_better_pose((false, 3.0), (false, f64::NEG_INFINITY)));
    }
}
