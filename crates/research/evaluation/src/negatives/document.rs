//! Results of `veiloc eval negatives`: rows and queries of its JSON document.

use std::collections::BTreeMap;

use serde::Serialize;
use veiloc_obfuscation::SealError;
use veiloc_pose::State;
use veiloc_protocol::Scheme;

use super::camera::CameraSource;
use crate::pipeline::LocalizeResult;
use crate::results::metrics::finite;
use crate::results::state::as_text;

/// Results of out-of-map images.
#[derive(Debug, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct NegativesResult {
    /// One entry per scheme.
    pub rows: Vec<NegativeRow>,
    /// One entry per image and scheme.
    pub queries: Vec<NegativeQuery>,
    /// Images that could not be read or have another size than their camera: name and cause. They are not counted.
    #[serde(skip)]
    pub unread: Vec<(String, SealError)>,
}

/// All images under one scheme.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct NegativeRow {
    /// Obfuscation scheme.
    pub scheme: String,
    /// Number of negative queries: the sum of the three below.
    pub negatives: usize,
    /// Queries with a pose that the estimator trusts: each is a false positive.
    pub trusted: usize,
    /// Queries with a pose that the estimator doubts.
    pub doubtful: usize,
    /// Queries without a pose.
    pub not_found: usize,
    /// Those of `not_found` that could not be sealed: too few keypoints.
    pub unusable: usize,
    /// Number of queries by camera source: `given`, `exif`, `assumed`.
    pub cameras: BTreeMap<&'static str, usize>,
    /// Percentage (`50`, `90`, `99`, `100`) to this quantile of the log evidence, nats; queries without a pose are below
    /// all others, and the value is null if the quantile falls on them.
    pub log_evidence: BTreeMap<String, Option<f64>>,
}

/// One image under one scheme.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct NegativeQuery {
    /// Path below the folder, or the name in the list.
    pub name: String,
    /// Obfuscation scheme.
    pub scheme: String,
    /// Source of its camera.
    pub camera: CameraSource,
    /// State of the pose according to the estimator: `trusted`, `doubtful` or `not-found`; the pose is wrong in any case.
    #[serde(serialize_with = "as_text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub state: State,
    /// Whether it could be sealed.
    pub sealed: bool,
    /// Natural logarithm of the evidence against chance; absent if no pose was estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log_evidence: Option<f64>,
    /// Camera centre of the pose, map units; absent without a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub center: Option<[f64; 3]>,
    /// Rows of the query that agree with the pose; 0 without a pose.
    pub inliers: usize,
    /// Rows of the query that were matched; 0 without a pose.
    pub matches: usize,
    /// Reasons to doubt the pose, in words; empty without a pose.
    pub doubts: Vec<String>,
    /// Why there is no pose; absent with a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
}

impl NegativeQuery {
    /// The result of a localized query.
    pub(super) fn answered(
        name: &str,
        scheme: Scheme,
        camera: CameraSource,
        answer: &LocalizeResult,
    ) -> Self {
        let found = answer.found.as_ref().ok();
        Self {
            name: name.to_owned(),
            scheme: scheme.to_string(),
            camera,
            state: answer.state(),
            sealed: true,
            log_evidence: answer.log_evidence().and_then(finite),
            center: found.map(|f| f.cam_from_world.center().coords.into()),
            inliers: found.map_or(0, |f| f.inliers),
            matches: found.map_or(0, |f| f.matches),
            doubts: answer.doubts(),
            failure: answer.found.as_ref().err().map(ToString::to_string),
        }
    }

    /// The result of an image that could not be sealed.
    pub(super) fn unusable(name: &str, scheme: Scheme, camera: CameraSource, error: &SealError) -> Self {
        Self {
            name: name.to_owned(),
            scheme: scheme.to_string(),
            camera,
            state: State::NotFound,
            sealed: false,
            log_evidence: None,
            center: None,
            inliers: 0,
            matches: 0,
            doubts: Vec::new(),
            failure: Some(error.to_string()),
        }
    }
}

impl NegativeRow {
    /// Percentages of [`Self::log_evidence`]; the last is the largest of all.
    pub(super) const QUANTILES: [u32; 4] = [50, 90, 99, 100];

    /// The queries of one scheme.
    pub(super) fn of(scheme: Scheme, own: &[&NegativeQuery]) -> Self {
        let count = |state| own.iter().filter(|q| q.state == state).count();
        let of_source = |source| own.iter().filter(|q| q.camera == source).count();
        let mut evidence: Vec<f64> =
            own.iter().map(|q| q.log_evidence.unwrap_or(f64::NEG_INFINITY)).collect();
        evidence.sort_by(f64::total_cmp);
        let quantile = |percent: u32| {
            let rank = (evidence.len() * percent as usize).div_ceil(100).max(1);
            evidence.get(rank - 1).copied().and_then(finite)
        };
        Self {
            negatives: own.len(),
            trusted: count(State::Trusted),
            doubtful: count(State::Doubtful),
            not_found: count(State::NotFound),
            unusable: own.iter().filter(|q| !q.sealed).count(),
            cameras: CameraSource::ALL.map(|source| (source.name(), of_source(source))).into(),
            log_evidence: Self::QUANTILES.map(|p| (p.to_string(), quantile(p))).into(),
            scheme: scheme.to_string(),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::negatives) fn negative(scheme: &str, evidence: Option<f64>) -> NegativeQuery {
        let state = match evidence {
            Some(e) if e > 60.0 => State::Trusted,
            Some(_) => State::Doubtful,
            None => State::NotFound,
        };
        NegativeQuery {
            name: "fur.jpg".to_owned(),
            scheme: scheme.to_owned(),
            camera: CameraSource::Assumed,
            state,
            sealed: true,
            log_evidence: evidence,
            center: None,
            inliers: 30,
            matches: 200,
            doubts: Vec::new(),
            failure: None,
        }
    }

    #[test]
    fn row_counts_all_states() {
        let mut queries: Vec<NegativeQuery> = (0..7).map(|i| negative("dcl", Some(f64::from(i)))).collect();
        queries.push(negative("dcl", Some(107.0)));
        queries.extend([negative("dcl", None), negative("dcl", None)]);
        queries[8].sealed = false;
        queries[0].camera = CameraSource::Given;
        let row = NegativeRow::of(Scheme::default(), &queries.iter().collect::<Vec<_>>());
        assert_eq!((row.negatives, row.trusted, row.doubtful, row.not_found, row.unusable), (10, 1, 7, 2, 1));
        assert_eq!((row.cameras["given"], row.cameras["assumed"]), (1, 9));
        let evidence = |p: &str| row.log_evidence[p];
        assert_eq!((evidence("50"), evidence("90"), evidence("100")), (Some(2.0), Some(6.0), Some(107.0)));
    }

    #[test]
    fn quantiles_without_pose_are_null() {
        let queries = [negative("dcl", None), negative("dcl", None), negative("dcl", Some(12.0))];
        let row = NegativeRow::of(Scheme::default(), &queries.iter().collect::<Vec<_>>());
        assert_eq!((row.log_evidence["50"], row.log_evidence["100"]), (None, Some(12.0)));
        let none = NegativeRow::of(Scheme::Points, &[]);
        assert_eq!((none.negatives, none.log_evidence["100"]), (0, None));
    }
}
