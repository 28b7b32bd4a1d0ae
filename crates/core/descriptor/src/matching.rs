//! Matches between two sets of descriptors: nearest neighbours that pass the usual checks.

use crate::{
    DescriptorView,
    neighbours::{TwoNearest, both_ways, two_nearest},
};

/// A pair of matching descriptors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Row in the query.
    pub query: u32,
    /// Row in the database.
    pub database: u32,
    /// Euclidean distance in code units (RootSIFT codes are 512 times the unit vector).
    pub distance: f32,
    /// Distance to the nearest over distance to the second nearest, in \[0, 1\]; 1 (no information) when there is no
    /// second or both are zero.
    pub ratio: f32,
}

/// Conditions on matches.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MatchOptions {
    /// Keep a pair only when each is the nearest of the other. Default true: a map point belongs to one keypoint, and
    /// without it frequent descriptors have many wrong matches.
    pub mutual: bool,
    /// Keep a pair only when its [`Match::ratio`] is at most this. Default `None`: the pose estimator weights matches
    /// by their ratio and rejects them itself. 0.8 is a common value. NaN keeps nothing.
    pub max_ratio: Option<f32>,
}

impl Default for MatchOptions {
    fn default() -> Self {
        Self { mutual: true, max_ratio: None }
    }
}

impl MatchOptions {
    /// These options with another [`MatchOptions::mutual`].
    pub const fn with_mutual(mut self, mutual: bool) -> Self {
        self.mutual = mutual;
        self
    }

    /// These options with another [`MatchOptions::max_ratio`].
    pub const fn with_max_ratio(mut self, max_ratio: Option<f32>) -> Self {
        self.max_ratio = max_ratio;
        self
    }
}

/// Matches each query descriptor to at most one database descriptor, sorted by query.
///
/// Of equally near descriptors the lowest index wins, in both directions. Both directions are computed in one pass over
/// the pairs. Descriptors of different kinds never match. Results do not depend on the number of threads.
pub fn match_descriptors(
    query: DescriptorView<'_>,
    database: DescriptorView<'_>,
    options: &MatchOptions,
) -> Vec<Match> {
    if query.kind() != database.kind() {
        return Vec::new();
    }
    let found = if options.mutual {
        let both = both_ways(query, database);
        let is_mutual = |index: usize, two: &TwoNearest| {
            both.of_database
                .nearest(two.nearest.index as usize)
                .is_some_and(|(query, _)| query as usize == index)
        };
        let found = both.of_query.into_iter().enumerate();
        found.map(|(index, two)| two.filter(|two| is_mutual(index, two))).collect()
    } else {
        two_nearest(query, database)
    };
    found
        .into_iter()
        .zip(0..)
        .filter_map(|(two, query)| Some(to_match(query, &two?)))
        .filter(|m| options.max_ratio.is_none_or(|max| m.ratio <= max))
        .collect()
}

fn to_match(query: u32, two: &TwoNearest) -> Match {
    let nearest = f64::from(two.nearest.distance);
    let ratio = match two.second {
        Some(second) if second > 0 => (nearest / f64::from(second)).sqrt(),
        _ => 1.0,
    };
    Match { query, database: two.nearest.index, distance: nearest.sqrt() as f32, ratio: ratio as f32 }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{DescriptorKind, Descriptors, test_data::random_descriptors};

    /// Rows with the given first component and zeros.
    fn line(values: &[u8]) -> Descriptors {
        let mut rows = Descriptors::empty(DescriptorKind::ROOT_SIFT);
        for &value in values {
            let mut row = [0; 128];
            row[0] = value;
            rows.push(&row).unwrap();
        }
        rows
    }

    fn pairs(query: &[u8], database: &[u8], options: &MatchOptions) -> Vec<(u32, u32)> {
        let found = match_descriptors(line(query).view(), line(database).view(), options);
        found.iter().map(|m| (m.query, m.database)).collect()
    }

    #[test]
    fn mutual_pairs_only() {
        // 12 is nearer to 10 than 15 is, so 15 is dropped.
        assert_eq!(pairs(&[15, 12, 200], &[10, 190], &MatchOptions::default()), [(1, 0), (2, 1)]);
        let one_way = MatchOptions::default().with_mutual(false);
        assert_eq!(pairs(&[15, 12, 200], &[10, 190], &one_way), [(0, 0), (1, 0), (2, 1)]);
    }

    #[test]
    fn equal_distances_go_to_the_lowest_index() {
        assert_eq!(pairs(&[5, 5], &[7, 7, 7], &MatchOptions::default()), [(0, 0)]);
        assert_eq!(pairs(&[10], &[12, 8], &MatchOptions::default()), [(0, 0)]);
    }

    #[test]
    fn distance_and_ratio() {
        let found = match_descriptors(line(&[10]).view(), line(&[13, 22]).view(), &MatchOptions::default());
        assert_eq!(found, [Match { query: 0, database: 0, distance: 3.0, ratio: 0.25 }]);
    }

    #[test]
    fn undefined_ratio_is_one() {
        let one = |database: &[u8]| {
            match_descriptors(line(&[10]).view(), line(database).view(), &MatchOptions::default())[0].ratio
        };
        assert_eq!(one(&[13]), 1.0);
        assert_eq!(one(&[10, 10]), 1.0);
        let strict = MatchOptions::default().with_max_ratio(Some(0.8));
        assert_eq!(pairs(&[10], &[13], &strict), []);
        assert_eq!(pairs(&[10], &[13, 14], &strict), [(0, 0)]);
        assert_eq!(pairs(&[10], &[13, 14], &strict.with_max_ratio(Some(f32::NAN))), []);
    }

    #[test]
    fn empty_sets_have_no_matches() {
        assert_eq!(pairs(&[], &[], &MatchOptions::default()), []);
        assert_eq!(pairs(&[1], &[], &MatchOptions::default()), []);
        assert_eq!(pairs(&[], &[1], &MatchOptions::default()), []);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn swapping_the_sides_swaps_mutual_pairs(n in 0_usize..200, m in 0_usize..200, seed: u64) {
            let (a, b) = (random_descriptors(n, seed), random_descriptors(m, seed.wrapping_add(1)));
            let forth = match_descriptors(a.view(), b.view(), &MatchOptions::default());
            let back = match_descriptors(b.view(), a.view(), &MatchOptions::default());
            let forth: Vec<_> = forth.iter().map(|m| (m.query, m.database)).collect();
            let mut back: Vec<_> = back.iter().map(|m| (m.database, m.query)).collect();
            back.sort_unstable();
            prop_assert_eq!(forth, back);
        }

        #[test]
        fn lower_ratio_gives_a_subset(n in 0_usize..100, m in 0_usize..100, seed: u64, max in 0.0_f32..1.0) {
            let (a, b) = (random_descriptors(n, seed), random_descriptors(m, !seed));
            let options = MatchOptions::default().with_mutual(false);
            let all = match_descriptors(a.view(), b.view(), &options);
            let some = match_descriptors(a.view(), b.view(), &options.with_max_ratio(Some(max)));
            prop_assert_eq!(all.len(), if m == 0 { 0 } else { n });
            prop_assert!(all.iter().all(|m| (0.0..=1.0).contains(&m.ratio)));
            let expected: Vec<_> = all.into_iter().filter(|m| m.ratio <= max).collect();
            prop_assert_eq!(some, expected);
        }
    }
}
