//! Figures of a row from the results of single queries, over all seeds and per seed.

use std::collections::{BTreeMap, BTreeSet};

use veiloc_pose::State;

use veiloc_geometry::statistics::median;

use crate::results::document::{LossStage, QueryResult, SchemeSummary, SeedSummary, SentSummary};
use crate::results::metrics::{PoseErrors, Threshold, finite, mean, recall};
use crate::results::uncertainty::{QueryUncertainty, TrustedUncertainty};

/// Summarizes the queries of one row: one scheme and one configuration of the estimator, with any number of seeds.
pub fn summarize(queries: &[&QueryResult], thresholds: &[Threshold]) -> SchemeSummary {
    let seeds: BTreeSet<u64> = queries.iter().map(|q| q.seed).collect();
    let per_seed: Vec<SeedSummary> = seeds
        .iter()
        .map(|&seed| {
            let own: Vec<&QueryResult> = queries.iter().filter(|q| q.seed == seed).copied().collect();
            of_seed(seed, &own, thresholds)
        })
        .collect();
    let all = of_seed(0, queries, thresholds);
    let ratios: Vec<f64> = queries
        .iter()
        .filter(|q| q.is_localized())
        .map(|q| q.inliers as f64 / q.correspondences.max(1) as f64)
        .collect();
    let drawn: Vec<f64> = queries.iter().map(|q| q.hypotheses as f64).filter(|h| *h > 0.0).collect();
    let mut bytes: Vec<usize> = queries.iter().filter_map(|q| q.sealed_bytes).collect();
    bytes.sort_unstable();
    let wrong = |q: &QueryResult| !thresholds.iter().any(|t| q.pose_error().within(t));
    let trusted_wrong =
        queries.iter().filter(|q| q.state == Some(State::Trusted) && q.has_ground_truth && wrong(q)).count();
    let has_trust = queries.iter().any(|q| q.state.is_some());
    let count = |state| has_trust.then(|| queries.iter().filter(|q| q.state == Some(state)).count());
    let trusted = queries.iter().filter(|q| q.state == Some(State::Trusted));
    let uncertainties: Vec<QueryUncertainty> = trusted.filter_map(|q| q.uncertainty).collect();
    let deviations: Vec<f64> =
        queries.iter().filter_map(|q| Some(q.uncertainty?.position_sd.unwrap_or(f64::INFINITY))).collect();
    let first = queries.first();
    SchemeSummary {
        condition: first.and_then(|q| q.condition.clone()),
        scheme: first.map(|q| q.scheme.clone()).unwrap_or_default(),
        score: first.map(|q| q.score.clone()).unwrap_or_default(),
        variant: first.map(|q| q.variant.clone()).unwrap_or_default(),
        queries: queries.len(),
        localized: all.localized,
        trusted: all.trusted,
        trusted_wrong: all.trusted.map(|_| trusted_wrong),
        doubtful: count(State::Doubtful),
        not_found: count(State::NotFound),
        lost: count_by_stage(queries),
        median_rotation_deg: all.median_rotation_deg,
        median_translation: all.median_translation,
        median_position_sd: finite(median(&deviations)),
        recall: all.recall,
        uncertainty: TrustedUncertainty::of(&uncertainties),
        mean_inlier_ratio: finite(mean(&ratios)),
        median_hypotheses: finite(median(&drawn)),
        sealed_bytes: bytes.get(bytes.len() / 2).copied(),
        sent: SentSummary::of(&queries.iter().filter_map(|q| q.sent).collect::<Vec<_>>()),
        median_ms: all.median_ms,
        per_seed: if per_seed.len() > 1 { per_seed } else { Vec::new() },
    }
}

fn count_by_stage(queries: &[&QueryResult]) -> BTreeMap<LossStage, usize> {
    let mut counts = BTreeMap::new();
    for stage in queries.iter().filter_map(|q| q.lost_in) {
        *counts.entry(stage).or_default() += 1;
    }
    counts
}

fn of_seed(seed: u64, queries: &[&QueryResult], thresholds: &[Threshold]) -> SeedSummary {
    let errors: Vec<PoseErrors> =
        queries.iter().filter(|q| q.has_ground_truth).map(|q| q.pose_error()).collect();
    let thresholds = if errors.is_empty() && !queries.is_empty() { &[] } else { thresholds };
    let rotations: Vec<f64> = errors.iter().map(|e| e.rotation_deg).collect();
    let translations: Vec<f64> = errors.iter().map(|e| e.translation).collect();
    let has_trust = queries.iter().any(|q| q.state.is_some());
    SeedSummary {
        seed,
        localized: queries.iter().filter(|q| q.is_localized()).count(),
        trusted: has_trust.then(|| queries.iter().filter(|q| q.state == Some(State::Trusted)).count()),
        median_rotation_deg: finite(median(&rotations)),
        median_translation: finite(median(&translations)),
        recall: thresholds.iter().map(|t| (t.to_string(), recall(&errors, t))).collect(),
        median_ms: median_ms(queries),
    }
}

fn median_ms(queries: &[&QueryResult]) -> BTreeMap<String, f64> {
    let stages: BTreeSet<&String> = queries.iter().flat_map(|q| q.ms.keys()).collect();
    stages
        .into_iter()
        .map(|stage| {
            let times: Vec<f64> = queries.iter().filter_map(|q| q.ms.get(stage).copied()).collect();
            (stage.clone(), median(&times))
        })
        .collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use veiloc_protocol::PoseDocument;

    use crate::results::document::{EstimatorVariant, SentDocument};

    pub(crate) fn query(seed: u64, error: Option<(f64, f64)>) -> QueryResult {
        QueryResult {
            name: "a.jpg".into(),
            condition: None,
            scheme: "dcl".into(),
            score: "likelihood".into(),
            variant: EstimatorVariant {
                recipe: Some("vote".into()),
                prior: true,
                ..EstimatorVariant::default()
            },
            seed,
            cam_from_world: None,
            state: Some(match error {
                Some((rotation, _)) if rotation < 0.5 => State::Trusted,
                Some(_) => State::Doubtful,
                None => State::NotFound,
            }),
            doubts: Vec::new(),
            log_evidence: None,
            focal: None,
            has_ground_truth: true,
            rotation_error_deg: error.map(|e| e.0),
            translation_error: error.map(|e| e.1),
            uncertainty: None,
            lost_in: None,
            inliers: 30,
            correspondences: 60,
            hypotheses: 100,
            failure: None,
            sealed_bytes: Some(1000),
            sent: None,
            ms: [("pose".to_owned(), 5.0 + seed as f64)].into(),
        }
    }

    fn threshold() -> Vec<Threshold> {
        vec!["0.05/5".parse().expect("well written")]
    }

    #[test]
    fn summary_counts_failures_as_infinite() {
        let queries = [query(0, Some((0.1, 0.01))), query(0, None), query(0, None)];
        let s = summarize(&queries.iter().collect::<Vec<_>>(), &threshold());
        assert_eq!((s.queries, s.localized, s.trusted, s.trusted_wrong), (3, 1, Some(1), Some(0)));
        assert_eq!((s.doubtful, s.not_found), (Some(0), Some(2)));
        assert_eq!(s.median_rotation_deg, None);
        assert!((s.recall["0.05/5"] - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(s.mean_inlier_ratio, Some(0.5));
        assert!(s.per_seed.is_empty(), "one seed has no spread");
    }

    #[test]
    fn queries_without_truth_are_counted_but_not_judged() {
        let answered = |trusted| QueryResult {
            has_ground_truth: false,
            cam_from_world: Some(PoseDocument { q: [1.0, 0.0, 0.0, 0.0], t: [0.0; 3] }),
            state: Some(if trusted { State::Trusted } else { State::Doubtful }),
            ..query(0, None)
        };
        let queries = [query(0, Some((0.1, 0.01))), answered(true), answered(false)];
        let s = summarize(&queries.iter().collect::<Vec<_>>(), &threshold());
        assert_eq!((s.queries, s.localized, s.trusted, s.trusted_wrong), (3, 3, Some(2), Some(0)));
        assert_eq!((s.median_translation, s.recall["0.05/5"]), (Some(0.01), 1.0));
        let s = summarize(&queries[1..].iter().collect::<Vec<_>>(), &threshold());
        assert_eq!((s.localized, s.median_translation, s.recall.len()), (2, None, 0));
    }

    #[test]
    fn seeds_are_summarized_separately_and_pooled() {
        let queries = [
            query(7, Some((0.1, 0.01))),
            query(7, Some((0.3, 0.50))),
            query(8, Some((0.2, 0.02))),
            query(8, Some((0.2, 0.04))),
        ];
        let s = summarize(&queries.iter().collect::<Vec<_>>(), &threshold());
        assert_eq!((s.queries, s.trusted_wrong), (4, Some(1)));
        assert_eq!(s.recall["0.05/5"], 0.75);
        let seeds: Vec<_> = s.per_seed.iter().map(|p| (p.seed, p.localized, p.recall["0.05/5"])).collect();
        assert_eq!(seeds, [(7, 2, 0.5), (8, 2, 1.0)]);
        assert_eq!(s.per_seed[1].median_translation, Some(0.03));
        assert_eq!(s.per_seed[0].median_ms["pose"], 12.0);
    }

    #[test]
    fn sent_data_is_averaged_over_all_queries() {
        let with = |sent_rows: usize, error| {
            let sent = SentDocument { sent_rows, sent_bytes: 100 * sent_rows, exposed: sent_rows / 4 };
            QueryResult { sent: Some(sent), ..query(0, error) }
        };
        // Queries without a pose are included; they cost the most.
        let queries = [with(256, Some((0.1, 0.01))), with(1024, None)];
        let sent = summarize(&queries.iter().collect::<Vec<_>>(), &threshold()).sent.expect("they were sent");
        assert_eq!((sent.mean_rows, sent.mean_bytes, sent.mean_exposed), (640.0, 64000.0, 160.0));
        assert_eq!(summarize(&[&query(0, None)], &threshold()).sent, None);
    }

    #[test]
    fn lost_queries_are_counted_by_stage() {
        let lost = |stage| QueryResult { lost_in: Some(stage), ..query(0, None) };
        let queries = [lost(LossStage::Objective), query(0, Some((0.1, 0.01))), lost(LossStage::Objective)];
        let summary = summarize(&queries.iter().collect::<Vec<_>>(), &[]);
        assert_eq!(summary.lost, [(LossStage::Objective, 2)].into());
        let text = crate::results::table(&[summary]);
        assert!(text.contains("beyond every threshold") && text.contains("objective"), "{text}");
        let none = summarize(&[&queries[1]], &[]);
        assert!(none.lost.is_empty() && !crate::results::table(&[none]).contains("beyond every threshold"));
    }

    #[test]
    fn coverage_uses_trusted_poses_only() {
        let with = |rotation: f64, region: f64| {
            let uncertainty = QueryUncertainty {
                position_sd: Some(0.01),
                rotation_sd_deg: Some(0.1),
                center_error_over_sd: Some(2.0 * region),
                center_region: region,
                pose_region: 0.95,
            };
            QueryResult { uncertainty: Some(uncertainty), ..query(0, Some((rotation, 0.01))) }
        };
        // Of the first three, the last is not trusted; the fourth has no pose.
        let queries = [with(0.1, 0.3), with(0.1, 0.7), with(0.9, 0.2), query(0, None)];
        let queries: Vec<&QueryResult> = queries.iter().collect();
        let row = summarize(&queries, &[]).uncertainty.expect("two are trusted");
        assert_eq!((row.coverage["50"], row.center_error_over_sd), (0.5, Some(1.0)));
        assert_eq!(summarize(&queries, &[]).median_position_sd, Some(0.01));
        assert_eq!(summarize(&queries[2..], &[]).uncertainty, None);
    }
}
