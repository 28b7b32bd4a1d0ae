//! Numbers of correspondences per anchor.

use veiloc_geometry::Anchor;

use crate::likelihood::matches::Matches;

impl Matches<'_> {
    /// The anchor with most correspondences, the first of equals.
    pub fn richest_anchor(&self) -> Anchor {
        let counts = self.count_by_anchor();
        Anchor::first(Anchor::MAX_COUNT).rev().max_by_key(|a| counts[a.index()]).unwrap_or(Anchor::FIRST)
    }

    /// How many anchors have correspondences.
    pub fn anchors_seen(&self) -> usize {
        self.count_by_anchor().iter().filter(|count| **count > 0).count()
    }

    fn count_by_anchor(&self) -> [usize; Anchor::MAX_COUNT] {
        let mut counts = [0; Anchor::MAX_COUNT];
        self.anchor.iter().for_each(|a| counts[a.index()] += 1);
        counts
    }
}
