//! Results as the stable JSON document.

use std::collections::BTreeMap;

use crate::results::metrics::finite;
use serde::Serialize;
use veiloc_protocol::{DclLayout, Scheme};

use super::accuracy::{Accuracy, ConditionFigures};
use super::privacy::{AdversaryFigures, Privacy};

/// Ratios are over all queries and seeds, with the figures of points on the same queries as denominator; a query without a
/// pose has an infinite error. `veiloc eval layouts --help` lists the adversaries; one without the required resources is
/// left out.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LayoutsDocument {
    /// Version of this document.
    pub version: u32,
    /// `eval layouts`.
    pub command: &'static str,
    /// The scene.
    pub data: String,
    /// Number of queries with pose estimates.
    pub queries: usize,
    /// Number of attacked queries.
    pub attacked: usize,
    /// Number of map images.
    pub map_images: usize,
    /// Neighbours per keypoint.
    pub k: usize,
    /// First seed.
    pub seed: u64,
    /// Number of seeds of the pose estimates.
    pub seeds: u64,
    /// One entry per layout.
    pub rows: Vec<LayoutRow>,
}

/// One layout.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LayoutRow {
    /// The scheme with this layout; the paper's is `dcl:paper`.
    pub layout: String,
    /// Median position error relative to points, geometric mean over `conditions`; null when one has no value.
    pub error_over_points: Option<f64>,
    /// The same for the 90 % quantile.
    pub tail_over_points: Option<f64>,
    /// The same for the median orientation error.
    pub rotation_over_points: Option<f64>,
    /// Mean error of the prior-only baseline on all queries, pixels; null without keypoints.
    pub prior_mean_px: Option<f64>,
    /// Share of the `k` true nearest neighbours in another pencil, 0 to 1; null without keypoints.
    pub other_pencil_neighbours: Option<f64>,
    /// Adversary to gain of its best attack over the prior-only baseline, bits per keypoint.
    pub bits: BTreeMap<&'static str, f64>,
    /// Whether the baseline's error is at least that under the paper's layout, and no realistic adversary gains more
    /// than 0.05 bits ([`TOLERANCE_BITS`]) above its gain there, with negative gains counted as zero; null when the paper's layout
    /// was not evaluated.
    pub protects_as_paper: Option<bool>,
    /// The same adversaries with details.
    pub adversaries: Vec<AdversaryFigures>,
    /// Poses under each condition.
    pub conditions: Vec<ConditionFigures>,
}

/// Accepted additional gain of an adversary over the paper's layout, bits.
pub const TOLERANCE_BITS: f64 = 0.05;

impl LayoutRow {
    pub(super) fn of(layout: DclLayout, accuracy: Accuracy, privacy: &Privacy) -> Self {
        let scheme = Scheme::Dcl(layout).to_string();
        let adversaries = privacy.adversaries(&scheme).to_vec();
        Self {
            layout: super::name(layout),
            error_over_points: accuracy.mean(|c| c.error_over_points),
            tail_over_points: accuracy.mean(|c| c.tail_over_points),
            rotation_over_points: accuracy.mean(|c| c.rotation_over_points),
            prior_mean_px: finite(privacy.prior_error(&scheme)),
            other_pencil_neighbours: finite(privacy.other_pencil(&scheme)),
            bits: adversaries.iter().map(|a| (a.adversary, a.bits)).collect(),
            protects_as_paper: None,
            adversaries,
            conditions: accuracy.conditions,
        }
    }

    /// Gain of the strongest realistic adversary, bits; `None` without one.
    pub fn worst_realistic(&self) -> Option<f64> {
        self.adversaries.iter().filter(|a| a.realistic).map(|a| a.bits).max_by(f64::total_cmp)
    }

    /// Whether it protects at least as well as another row.
    fn protects_as(&self, other: &Self) -> bool {
        let prior = self.prior_mean_px.zip(other.prior_mean_px).is_some_and(|(own, least)| own >= least);
        // An adversary with a negative gain would use the prior-only baseline instead.
        let gain = |bits: f64| bits.max(0.0);
        let holds = |a: &AdversaryFigures| {
            other.bits.get(a.adversary).is_some_and(|b| gain(a.bits) <= gain(*b) + TOLERANCE_BITS)
        };
        prior && self.adversaries.iter().filter(|a| a.realistic).all(holds)
    }
}

impl LayoutsDocument {
    /// Compares every row with the paper's layout.
    pub(super) fn compare(&mut self) {
        let Some(paper) = self.rows.iter().find(|row| row.layout == super::PAPER).cloned() else { return };
        for row in &mut self.rows {
            row.protects_as_paper = Some(row.protects_as(&paper));
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::privacy::layouts) fn row(
        layout: &str,
        error: f64,
        prior: f64,
        bits: [f64; 2],
    ) -> LayoutRow {
        let figures = |adversary, realistic, bits| AdversaryFigures {
            adversary,
            realistic,
            attack: "graph".to_owned(),
            frames: None,
            bits,
            mean_px: 50.0,
            median_px: 40.0,
        };
        let adversaries =
            vec![figures("outsider-statistic", true, bits[0]), figures("true-neighbours", false, bits[1])];
        LayoutRow {
            layout: layout.to_owned(),
            error_over_points: Some(error),
            tail_over_points: None,
            rotation_over_points: Some(error),
            prior_mean_px: Some(prior),
            other_pencil_neighbours: Some(0.02),
            bits: adversaries.iter().map(|a| (a.adversary, a.bits)).collect(),
            protects_as_paper: None,
            adversaries,
            conditions: Vec::new(),
        }
    }

    pub(in crate::privacy::layouts) fn document(rows: Vec<LayoutRow>) -> LayoutsDocument {
        LayoutsDocument {
            version: 1,
            command: "eval layouts",
            data: "a".to_owned(),
            queries: 3,
            attacked: 1,
            map_images: 5,
            k: 20,
            seed: 0,
            seeds: 1,
            rows,
        }
    }

    #[test]
    fn layout_protects_as_paper_by_prior_and_realistic_adversaries() {
        let paper = || row(super::super::PAPER, 2.8, 80.0, [-0.1, 4.0]);
        let mut all = document(vec![
            paper(),
            row("a", 1.4, 80.0, [0.04, 6.0]),
            row("b", 1.4, 79.9, [-0.1, 4.0]),
            row("c", 1.4, 90.0, [0.06, 4.0]),
        ]);
        all.compare();
        let results: Vec<_> = all.rows.iter().map(|r| r.protects_as_paper).collect();
        assert_eq!(results, [Some(true), Some(true), Some(false), Some(false)]);
        assert_eq!(all.rows[1].worst_realistic(), Some(0.04));
        let mut alone = document(vec![row("a", 1.4, 80.0, [0.0, 6.0])]);
        alone.compare();
        assert_eq!(alone.rows[0].protects_as_paper, None);
    }
}
