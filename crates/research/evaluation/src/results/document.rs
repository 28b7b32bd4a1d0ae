//! Results of `veiloc eval pose` and `veiloc eval scene`: the stable JSON document.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use veiloc_geometry::CameraFromWorld;
use veiloc_localization::answer_doubts;
use veiloc_pose::{Confidence, ScoreKind, State};
use veiloc_protocol::{AnswerDoubt, PoseDocument, Scheme};

use crate::results::metrics::{PoseErrors, finite};
use crate::results::state::{as_text_if_any, from_text_if_any};
use crate::results::uncertainty::{QueryUncertainty, TrustedUncertainty};

/// Also of `eval pose`.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EvaluationDocument {
    /// Version of this document.
    pub version: u32,
    /// The command: `eval scene` or `eval pose`.
    pub command: &'static str,
    /// Names of the evaluated data.
    pub data: Vec<String>,
    /// Seed of every random choice; the first of them when there were several.
    pub seed: u64,
    /// Whether matches of any row were weighted by descriptor ratio, votes and track length.
    pub prior: bool,
    /// Hypotheses per query; null if the estimator stopped adaptively, or if the rows differ.
    pub fixed_hypotheses: Option<usize>,
    /// One entry per row of the table: condition, scheme and configuration of the estimator.
    pub schemes: Vec<SchemeSummary>,
    /// One entry per row, seed and query.
    pub queries: Vec<QueryResult>,
    /// Facts about the map; absent in `eval pose`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map: Option<MapSummary>,
    /// The map of conditions with `sparse-map`; absent without them.
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

/// Configuration of the estimator, beside scheme and score.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EstimatorVariant {
    /// Name of the estimator; in `eval scene --optimum` also `optimum` and `floor`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recipe: Option<String>,
    /// Whether matches were weighted by their prior.
    pub prior: bool,
    /// Hypotheses per query; null if the estimator stopped adaptively or did not search.
    pub fixed_hypotheses: Option<usize>,
    /// Gravity of the estimator in `eval pose`: `none`, `file` or its error in degrees; absent when none was selected and
    /// the data has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity: Option<String>,
}

/// All queries of one row.
#[derive(Debug, Clone, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SchemeSummary {
    /// Condition of the queries: that of `eval scene --conditions`, or `day` and `night` of Aachen; absent for queries as
    /// they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// Obfuscation scheme.
    pub scheme: String,
    /// Score by which hypotheses were compared.
    pub score: String,
    /// Configuration of the estimator.
    #[serde(flatten)]
    pub variant: EstimatorVariant,
    /// Number of queries; each counts once per seed.
    pub queries: usize,
    /// Number of queries with a pose, right or wrong.
    pub localized: usize,
    /// Number of queries with a pose that the estimator trusts; absent if trust was not evaluated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trusted: Option<usize>,
    /// Number of trusted poses outside every threshold, or of out-of-map images; absent if trust was not evaluated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trusted_wrong: Option<usize>,
    /// Number of queries with a pose that the estimator doubts; absent if trust was not evaluated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub doubtful: Option<usize>,
    /// Number of queries without a pose, or with a pose no better than chance; absent if trust was not evaluated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_found: Option<usize>,
    /// Stage to number of queries that were lost in it; absent if no query was lost, or its stage was not evaluated.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub lost: BTreeMap<LossStage, usize>,
    /// Median rotation error over all queries with ground truth, degrees; null when more than half were not localized.
    pub median_rotation_deg: Option<f64>,
    /// Median translation error over all queries with ground truth, map units; null when more than half were not
    /// localized.
    pub median_translation: Option<f64>,
    /// Median of the queries' `position_sd`, map units; absent if more than half of the poses have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub median_position_sd: Option<f64>,
    /// Threshold (`translation/degrees`) to share of the queries with ground truth within it, 0 to 1; empty without such
    /// queries.
    pub recall: BTreeMap<String, f64>,
    /// Coverage of the covariances of trusted poses; absent without trusted poses.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<TrustedUncertainty>,
    /// Mean share of correspondences that agree with the estimated pose, over localized queries; null without any.
    pub mean_inlier_ratio: Option<f64>,
    /// Median number of hypotheses; null without any.
    pub median_hypotheses: Option<f64>,
    /// Bytes of one sealed query, median; absent if nothing is sealed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sealed_bytes: Option<usize>,
    /// Data sent per query; absent if nothing is sealed.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub sent: Option<SentSummary>,
    /// Stage to median milliseconds.
    pub median_ms: BTreeMap<String, f64>,
    /// The same figures per seed; absent for one seed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub per_seed: Vec<SeedSummary>,
}

/// All queries of one row under one seed; fields as in [`SchemeSummary`].
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SeedSummary {
    /// The seed.
    pub seed: u64,
    /// Number of queries with a pose, right or wrong.
    pub localized: usize,
    /// Number of queries with a trusted pose; null if trust was not evaluated.
    pub trusted: Option<usize>,
    /// Median rotation error, degrees; null when more than half were not localized.
    pub median_rotation_deg: Option<f64>,
    /// Median translation error, map units; null when more than half were not localized.
    pub median_translation: Option<f64>,
    /// Threshold to share of queries within it, 0 to 1.
    pub recall: BTreeMap<String, f64>,
    /// Stage to median milliseconds.
    pub median_ms: BTreeMap<String, f64>,
}

/// One query under one row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct QueryResult {
    /// Its name in the data.
    pub name: String,
    /// As in `schemes`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// Obfuscation scheme.
    pub scheme: String,
    /// Score by which hypotheses were compared.
    pub score: String,
    /// Configuration of the estimator.
    #[serde(flatten)]
    pub variant: EstimatorVariant,
    /// Seed of this run.
    pub seed: u64,
    /// The estimated pose; absent when not localized.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cam_from_world: Option<PoseDocument>,
    /// State of the pose according to the estimator: `trusted`, `doubtful` or `not-found`; absent if it was not evaluated.
    #[serde(
        default,
        serialize_with = "as_text_if_any",
        deserialize_with = "from_text_if_any",
        skip_serializing_if = "Option::is_none"
    )]
    #[cfg_attr(feature = "schema", schemars(with = "Option<String>"))]
    pub state: Option<State>,
    /// Why the pose is not trusted; absent when it is, or without a pose.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub doubts: Vec<AnswerDoubt>,
    /// Natural logarithm of the evidence against chance; absent if no pose was estimated, or if trust was not evaluated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_evidence: Option<f64>,
    /// How well the focal length of an out-of-map image is known: `calibrated`, `exif` or `unknown`; absent for other
    /// queries.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal: Option<String>,
    /// Whether the true pose is known. If not, as for out-of-map images, the query has no errors and counts only in the
    /// numbers of queries and states. Absent when true.
    #[serde(default = "yes", skip_serializing_if = "is_true")]
    pub has_ground_truth: bool,
    /// Rotation error, degrees; null when not localized or without ground truth.
    pub rotation_error_deg: Option<f64>,
    /// Translation error, map units; null when not localized or without ground truth.
    pub translation_error: Option<f64>,
    /// The error relative to the covariance; absent without a pose or covariance.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<QueryUncertainty>,
    /// In which stage the query was lost; absent when its pose is within a threshold, and without ground truth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost_in: Option<LossStage>,
    /// Number of correspondences that agree with the pose.
    pub inliers: usize,
    /// Number of correspondences.
    pub correspondences: usize,
    /// Number of hypotheses.
    pub hypotheses: usize,
    /// Why there is no pose; absent with a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// Bytes of the complete sealed query; absent if nothing is sealed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sealed_bytes: Option<usize>,
    /// Data sent for it; absent if nothing is sealed.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub sent: Option<SentDocument>,
    /// Stage to milliseconds; with `--progressive` those of the last step, and `steps` for all steps before it.
    pub ms: BTreeMap<String, f64>,
}

/// The stage in which a query was lost whose pose is within no threshold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum LossStage {
    /// The retrieved images hold fewer than 15 keypoints with a true match, and all images of the map hold more.
    Retrieval,
    /// All images of the map together hold fewer than 15 keypoints with a true match.
    Matching,
    /// The estimator's optimum near the true pose is right, but the search did not find it.
    Search,
    /// The estimator prefers another pose to the true one.
    Objective,
}

impl LossStage {
    /// All of them, in the order of processing.
    pub const ALL: [Self; 4] = [Self::Retrieval, Self::Matching, Self::Search, Self::Objective];
}

/// Data sent for one query.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SentDocument {
    /// Number of distinct rows that the server has received, including decoys; absent if nothing is sealed.
    pub sent_rows: usize,
    /// Bytes of all messages together; absent if nothing is sealed.
    pub sent_bytes: usize,
    /// Number of rows that agree with the pose: a server that knows the pose knows their positions in the image. 0
    /// without a pose; absent if nothing is sealed.
    pub exposed: usize,
}

/// Data sent for the queries of a row.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SentSummary {
    /// Mean of `sent_rows` over all queries; absent if nothing is sealed.
    pub mean_rows: f64,
    /// Mean of `sent_bytes` over all queries; absent if nothing is sealed.
    pub mean_bytes: f64,
    /// Mean of `exposed` over all queries; absent if nothing is sealed.
    pub mean_exposed: f64,
}

impl SentSummary {
    /// Means over these queries; `None` without queries.
    pub fn of(each: &[SentDocument]) -> Option<Self> {
        let mean = |of: fn(&SentDocument) -> usize| {
            each.iter().map(|sent| of(sent) as f64).sum::<f64>() / each.len() as f64
        };
        (!each.is_empty()).then(|| Self {
            mean_rows: mean(|sent| sent.sent_rows),
            mean_bytes: mean(|sent| sent.sent_bytes),
            mean_exposed: mean(|sent| sent.exposed),
        })
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands out references")]
const fn is_true(is: &bool) -> bool {
    *is
}

const fn yes() -> bool {
    true
}

/// Facts about the map of a scene.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MapSummary {
    /// Number of registered images.
    pub images: usize,
    /// Number of map points.
    pub points: usize,
    /// Bytes of the map file.
    pub bytes: u64,
    /// Seconds to build it; 0 for a map that was built before.
    pub build_seconds: f64,
    /// The regions of the map; absent without `--regions`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub regions: Option<RegionsSummary>,
}

/// Facts about the regions of a map; each query of a scene is localized in up to three of them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RegionsSummary {
    /// Number of regions.
    pub count: usize,
    /// Number of images of all regions; an image in several regions counts several times.
    pub images_total: u64,
    /// Bytes of all their map files.
    pub bytes: u64,
    /// Bytes of the largest region.
    pub largest_bytes: u64,
    /// Bytes of the index.
    pub index_bytes: u64,
}

impl QueryResult {
    /// A query without a pose.
    pub fn unsolved(name: &str, scheme: Scheme, score: ScoreKind) -> Self {
        Self {
            name: name.to_owned(),
            condition: None,
            scheme: scheme.to_string(),
            score: score.to_string(),
            variant: EstimatorVariant::default(),
            seed: 0,
            cam_from_world: None,
            state: None,
            doubts: Vec::new(),
            log_evidence: None,
            focal: None,
            has_ground_truth: true,
            rotation_error_deg: None,
            translation_error: None,
            uncertainty: None,
            lost_in: None,
            inliers: 0,
            correspondences: 0,
            hypotheses: 0,
            failure: None,
            sealed_bytes: None,
            sent: None,
            ms: BTreeMap::new(),
        }
    }

    /// Sets the reason for a missing pose.
    pub fn because(mut self, error: &impl std::error::Error) -> Self {
        self.failure = Some(error.to_string());
        self
    }

    /// Sets an estimate and its error.
    pub fn found(mut self, estimate: &CameraFromWorld, truth: &CameraFromWorld) -> Self {
        let error = PoseErrors::of(estimate, truth);
        self.cam_from_world = Some(PoseDocument::of(estimate));
        self.rotation_error_deg = finite(error.rotation_deg);
        self.translation_error = finite(error.translation);
        self
    }

    /// Sets what the estimator says about its pose.
    pub(crate) fn judged(mut self, state: State, confidence: &Confidence) -> Self {
        self.state = Some(state);
        self.log_evidence = finite(confidence.log_evidence);
        self.doubts = answer_doubts(confidence);
        self
    }

    /// Sets an estimate without a known true pose.
    pub fn answered(mut self, estimate: &CameraFromWorld) -> Self {
        self.cam_from_world = Some(PoseDocument::of(estimate));
        self
    }

    /// Errors as comparable numbers, infinite without a pose.
    pub fn pose_error(&self) -> PoseErrors {
        match (self.rotation_error_deg, self.translation_error) {
            (Some(rotation_deg), Some(translation)) => PoseErrors { rotation_deg, translation },
            _ => PoseErrors::NOT_LOCALIZED,
        }
    }

    pub(crate) fn is_localized(&self) -> bool {
        self.rotation_error_deg.is_some() || (!self.has_ground_truth && self.cam_from_world.is_some())
    }
}
