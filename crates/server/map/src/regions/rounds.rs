//! Which regions a query is asked in, and which of their poses is told: the same for a gateway of many machines and for an
//! evaluation on one.

/// Regions that a query is asked in at most, unless somebody says otherwise.
pub const ASKED: usize = 3;

/// Regions that share at least this part of what the best one holds are asked together with it.
const BESIDE: f64 = 0.75;

/// The regions to ask together, and those to ask when none of the first gives a pose that is trusted; `most` in all.
///
/// `ranked` are regions with how many of the images they hold that retrieval gives, best first, as
/// [`Index::rank`](crate::regions::Index::rank) has them. A region that holds nearly as much as the best one may be the right one as
/// well. One that holds less is mostly a neighbour, whose images are in the best one's margin too: asked at once it would cost
/// a localization for nothing.
pub fn rounds(ranked: impl IntoIterator<Item = (usize, usize)>, most: usize) -> Vec<Vec<usize>> {
    let asked: Vec<(usize, usize)> = ranked.into_iter().take(most).collect();
    let enough = asked.first().map_or(0.0, |(_, held)| *held as f64 * BESIDE);
    let (first, second): (Vec<_>, Vec<_>) = asked.into_iter().partition(|(_, held)| *held as f64 >= enough);
    let numbers = |some: Vec<(usize, usize)>| some.into_iter().map(|(region, _)| region).collect();
    [first, second].into_iter().filter(|some| !some.is_empty()).map(numbers).collect()
}

/// Whether one region's pose is told in the place of another's; of each, whether it is trusted, and its evidence.
pub fn is_better((trusted, evidence): (bool, f64), (than_trusted, than_evidence): (bool, f64)) -> bool {
    trusted.cmp(&than_trusted).then(evidence.total_cmp(&than_evidence)).is_gt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_wait_for_the_second_round() {
        for (held, most, expected) in [
            (&[10][..], 3, vec![vec![5]]),
            (&[10, 6, 4, 3], 3, vec![vec![5], vec![6, 7]]),
            (&[8, 7, 6, 5], 3, vec![vec![5, 6, 7]]),
            (&[8, 7, 6, 5], 2, vec![vec![5, 6]]),
            (&[10, 6, 4], 1, vec![vec![5]]),
            (&[], 3, vec![]),
        ] {
            let ranked = held.iter().enumerate().map(|(i, held)| (i + 5, *held));
            assert_eq!(rounds(ranked, most), expected, "{held:?} of {most}");
        }
    }

    #[test]
    fn trust_comes_before_evidence() {
        assert!(is_better((true, 20.0), (false, 90.0)) && !is_better((false, 90.0), (true, 20.0)));
        assert!(is_better((true, 30.0), (true, 20.0)) && !is_better((true, 20.0), (true, 20.0)));
        assert!(is_better((false, 3.0), (false, f64::NEG_INFINITY)));
    }
}
