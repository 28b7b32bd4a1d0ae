//! Results of `veiloc eval stress`: the stable JSON document.

use std::collections::BTreeMap;

use serde::Serialize;
use veiloc_obfuscation::SealError;
use veiloc_pose::State;
use veiloc_protocol::Scheme;

use super::condition::StressCondition;
use super::from_truth::{ErrorDocument, TruthStartErrors};
use super::options::StressEvaluation;
use crate::pipeline::{LocalizeResult, PosedQuery};
use crate::results::metrics::finite;
use crate::results::metrics::{PoseErrors, Threshold, median, recall};
use crate::results::state::as_text;
use crate::results::{MapSummary, QueryUncertainty};

/// Queries of a scene as they are (`none`) and under hard conditions.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StressDocument {
    /// Version of this document.
    pub version: u32,
    /// The command, `eval stress`.
    pub command: &'static str,
    /// Name of the scene.
    pub data: String,
    /// Seed of every random choice.
    pub seed: u64,
    /// A pose beyond either bound is wrong: `translation/degrees`.
    pub wrong_beyond: String,
    /// One entry per stress and scheme.
    pub rows: Vec<StressRow>,
    /// One entry per row and query.
    pub queries: Vec<StressQuery>,
    /// The map of all conditions except `sparse-map`.
    pub map: MapSummary,
    /// The map of `sparse-map`; absent when that condition was not selected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sparse_map: Option<SparseMap>,
}

/// The map of few images.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SparseMap {
    /// Step through the map list: every n-th image is in it.
    pub stride: usize,
    /// Facts about it.
    #[serde(flatten)]
    pub map: MapSummary,
}

/// All queries under one stress and scheme.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StressRow {
    /// Obfuscation scheme.
    pub scheme: String,
    /// The condition: `none`, `dark`, `motion`, `half-hidden`, `side-hidden`, `low-resolution`, `sparse-map`,
    /// `few-keypoints` or `focal-N`; `veiloc eval stress --help` explains them.
    pub stress: String,
    /// Standard deviation of the queries' gravity, degrees; absent without gravity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity_sd_deg: Option<f64>,
    /// Number of queries.
    pub queries: usize,
    /// Threshold (`translation/degrees`) to share of queries within it, 0 to 1.
    pub recall: BTreeMap<String, f64>,
    /// Median rotation error over all queries, degrees; null when more than half have no pose.
    pub median_rotation_deg: Option<f64>,
    /// Median translation error over all queries, map units; null when more than half have no pose.
    pub median_translation: Option<f64>,
    /// Median of the answers' `position_sd`, map units, over queries with a pose; null without poses, or if more than half have an unconstrained direction.
    pub median_position_sd: Option<f64>,
    /// Number of queries with a pose within `wrong_beyond`.
    pub correct: usize,
    /// Number of queries with a pose that the estimator trusts.
    pub trusted: usize,
    /// Number of trusted poses that are wrong.
    pub trusted_wrong: usize,
    /// Number of queries with a pose that the estimator doubts.
    pub doubtful: usize,
    /// Number of queries without a pose.
    pub not_found: usize,
    /// Errors of the engine's own optimum from the true pose; absent without `--optimum`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub optimum: Option<TruthSummary>,
    /// Errors of least squares from the true pose on the true matches; absent without `--optimum`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub floor: Option<TruthSummary>,
    /// Number of queries that are wrong or without a pose, although the optimum is right; absent without `--optimum`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub search_failures: Option<usize>,
}

/// Errors of estimates that start from the true pose.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TruthSummary {
    /// As in `rows`.
    pub recall: BTreeMap<String, f64>,
    /// Median rotation error, degrees; null when more than half have no pose.
    pub median_rotation_deg: Option<f64>,
    /// Median translation error, map units; null when more than half have no pose.
    pub median_translation: Option<f64>,
}

/// One query under one stress and scheme.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StressQuery {
    /// Its name in the data.
    pub name: String,
    /// Obfuscation scheme.
    pub scheme: String,
    /// The condition, as in `rows`.
    pub stress: String,
    /// As in `rows`; absent without gravity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity_sd_deg: Option<f64>,
    /// State of the pose according to the estimator: `trusted`, `doubtful` or `not-found`.
    #[serde(serialize_with = "as_text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub state: State,
    /// Errors of the pose.
    #[serde(flatten)]
    pub error: ErrorDocument,
    /// The error relative to the covariance; absent without a pose.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<QueryUncertainty>,
    /// Natural logarithm of the evidence against chance; absent if no pose was estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log_evidence: Option<f64>,
    /// Rows of the query that agree with the pose; 0 without a pose.
    pub inliers: usize,
    /// Rows of the query that were matched; 0 without a pose.
    pub matches: usize,
    /// Reasons to doubt the pose, in words; empty without a pose.
    pub doubts: Vec<String>,
    /// Why there is no pose; absent with a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// Estimates that start from the true pose; absent if not selected.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub from_truth: Option<TruthStartErrors>,
}

impl StressDocument {
    /// An empty document.
    pub(super) fn new(evaluation: &StressEvaluation, data: String) -> Self {
        Self {
            version: 1,
            command: "eval stress",
            data,
            seed: evaluation.scene.seed,
            wrong_beyond: evaluation.wrong_threshold.to_string(),
            rows: Vec::new(),
            queries: Vec::new(),
            map: MapSummary { images: 0, points: 0, bytes: 0, build_seconds: 0.0, regions: None },
            sparse_map: None,
        }
    }
}

impl StressQuery {
    /// The result of a localized query.
    pub(super) fn answered(
        query: &PosedQuery,
        stress: StressCondition,
        scheme: Scheme,
        answer: &LocalizeResult,
        from_truth: Option<TruthStartErrors>,
    ) -> Self {
        let truth = &query.cam_from_world;
        let found = answer.found.as_ref().ok();
        Self {
            name: query.name.clone(),
            scheme: scheme.to_string(),
            stress: stress.to_string(),
            gravity_sd_deg: None,
            state: answer.state(),
            error: found
                .map_or(ErrorDocument::NOT_LOCALIZED, |f| ErrorDocument::of(&f.cam_from_world, truth)),
            uncertainty: found.map(|f| QueryUncertainty::of(&f.cam_from_world, &f.covariance, truth)),
            log_evidence: answer.log_evidence().and_then(finite),
            inliers: found.map_or(0, |f| f.inliers),
            matches: found.map_or(0, |f| f.matches),
            doubts: answer.doubts(),
            failure: answer.found.as_ref().err().map(ToString::to_string),
            from_truth,
        }
    }

    /// The result of a query that could not be sealed.
    pub(super) fn unsealed(
        query: &PosedQuery,
        stress: StressCondition,
        scheme: Scheme,
        error: &SealError,
        from_truth: Option<TruthStartErrors>,
    ) -> Self {
        Self {
            name: query.name.clone(),
            scheme: scheme.to_string(),
            stress: stress.to_string(),
            gravity_sd_deg: None,
            state: State::NotFound,
            error: ErrorDocument::NOT_LOCALIZED,
            uncertainty: None,
            log_evidence: None,
            inliers: 0,
            matches: 0,
            doubts: Vec::new(),
            failure: Some(error.to_string()),
            from_truth,
        }
    }
}

impl StressRow {
    /// The figures of one row; `None` without queries.
    pub(super) fn of(queries: &[StressQuery], evaluation: &StressEvaluation) -> Option<Self> {
        let first = queries.first()?;
        let errors: Vec<PoseErrors> = queries.iter().map(|q| q.error.pose_error()).collect();
        let figures = TruthSummary::of(&errors, &evaluation.scene.thresholds);
        let is_right = |e: &PoseErrors| e.within(&evaluation.wrong_threshold);
        let count = |state| queries.iter().filter(|q| q.state == state).count();
        let of_truth = |which: fn(&TruthStartErrors) -> &ErrorDocument| {
            let errors: Option<Vec<PoseErrors>> =
                queries.iter().map(|q| q.from_truth.as_ref().map(|t| which(t).pose_error())).collect();
            errors
        };
        let optimum = of_truth(|t| &t.optimum);
        let summed = |errors: &Vec<PoseErrors>| TruthSummary::of(errors, &evaluation.scene.thresholds);
        Some(Self {
            scheme: first.scheme.clone(),
            stress: first.stress.clone(),
            gravity_sd_deg: first.gravity_sd_deg,
            queries: queries.len(),
            recall: figures.recall,
            median_rotation_deg: figures.median_rotation_deg,
            median_translation: figures.median_translation,
            median_position_sd: median_sd(queries),
            correct: errors.iter().filter(|e| is_right(e)).count(),
            trusted: count(State::Trusted),
            trusted_wrong: queries
                .iter()
                .filter(|q| q.state == State::Trusted && !is_right(&q.error.pose_error()))
                .count(),
            doubtful: count(State::Doubtful),
            not_found: count(State::NotFound),
            search_failures: optimum
                .as_ref()
                .map(|o| errors.iter().zip(o).filter(|(e, o)| !is_right(e) && is_right(o)).count()),
            optimum: optimum.as_ref().map(summed),
            floor: of_truth(|t| &t.floor).as_ref().map(summed),
        })
    }
}

fn median_sd(queries: &[StressQuery]) -> Option<f64> {
    let uncertainties = queries.iter().filter_map(|q| q.uncertainty);
    let each: Vec<f64> = uncertainties.map(|u| u.position_sd.unwrap_or(f64::INFINITY)).collect();
    if each.is_empty() { None } else { finite(median(&each)) }
}

impl TruthSummary {
    fn of(errors: &[PoseErrors], thresholds: &[Threshold]) -> Self {
        let median_of =
            |of: fn(&PoseErrors) -> f64| finite(median(&errors.iter().map(of).collect::<Vec<_>>()));
        Self {
            recall: thresholds.iter().map(|t| (t.to_string(), recall(errors, t))).collect(),
            median_rotation_deg: median_of(|e| e.rotation_deg),
            median_translation: median_of(|e| e.translation),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::SceneEvaluation;
    use veiloc_map::PosedImages;

    pub(in crate::stress) fn query(
        state: State,
        error: Option<(f64, f64)>,
        optimum: Option<(f64, f64)>,
    ) -> StressQuery {
        let document = |e: Option<(f64, f64)>| ErrorDocument {
            rotation_error_deg: e.map(|e| e.0),
            translation_error: e.map(|e| e.1),
        };
        StressQuery {
            name: "a.jpg".to_owned(),
            scheme: "dcl".to_owned(),
            stress: "dark".to_owned(),
            gravity_sd_deg: None,
            state,
            error: document(error),
            uncertainty: None,
            log_evidence: None,
            inliers: 0,
            matches: 0,
            doubts: Vec::new(),
            failure: None,
            from_truth: Some(TruthStartErrors { optimum: document(optimum), floor: document(optimum) }),
        }
    }

    pub(in crate::stress) fn evaluation() -> StressEvaluation {
        let thresholds = ["0.05/5", "0.25/2"].map(|text| text.parse().expect("well written"));
        let scene =
            SceneEvaluation::of_scene(PosedImages::default(), "images".into(), Vec::new(), Vec::new());
        StressEvaluation::new(SceneEvaluation { thresholds: thresholds.to_vec(), ..scene })
    }

    #[test]
    fn row_counts_states_wrong_poses_and_search_losses() {
        let right = Some((0.1, 0.01));
        let queries = [
            query(State::Trusted, right, right),
            query(State::Trusted, Some((0.1, 0.3)), right), // trusted, wrong, lost
            query(State::Doubtful, Some((5.0, 0.01)), None), // turned too far
            query(State::Doubtful, Some((1.0, 0.2)), right),
            query(State::NotFound, None, Some((3.0, 0.01))),
            query(State::NotFound, None, right), // lost
        ];
        let row = StressRow::of(&queries, &evaluation()).expect("a row");
        assert_eq!((row.trusted, row.doubtful, row.not_found), (2, 2, 2));
        assert_eq!((row.correct, row.trusted_wrong, row.search_failures), (2, 1, Some(2)));
        assert_eq!((row.recall["0.05/5"], row.recall["0.25/2"]), (2.0 / 6.0, 2.0 / 6.0));
        assert_eq!(row.median_translation, Some(0.25));
        assert_eq!(row.optimum.expect("requested").recall["0.05/5"], 5.0 / 6.0);
        let mut not_asked = queries[0].clone();
        not_asked.from_truth = None;
        let row = StressRow::of(&[not_asked], &evaluation()).expect("a row");
        assert_eq!((row.optimum, row.floor, row.search_failures), (None, None, None));
        assert_eq!(StressRow::of(&[], &evaluation()), None);
    }
}
