//! Pose errors under a layout relative to those of points, on the same queries.

use crate::results::metrics::{finite, median};
use crate::stress::StressQuery;
use serde::Serialize;
use veiloc_pose::State;
use veiloc_protocol::Scheme;

/// Poses of one layout under one condition, relative to those of points. A query without a pose counts as infinite
/// error.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ConditionFigures {
    /// The condition, as in `eval stress`.
    pub stress: String,
    /// Ratio of the median position errors, layout over points; null when more than half of either have no pose.
    pub error_over_points: Option<f64>,
    /// The same for the 90 % quantile; null when more than a tenth of either have no pose.
    pub tail_over_points: Option<f64>,
    /// Ratio of the median orientation errors; null as the first.
    pub rotation_over_points: Option<f64>,
    /// Median error of the position, map units; null when more than half have no pose.
    pub median_translation: Option<f64>,
    /// Number of queries, counted once per seed.
    pub queries: usize,
    /// Number of queries with a trusted pose.
    pub trusted: usize,
    /// The same for points.
    pub trusted_points: usize,
}

/// Poses of one layout.
pub(super) struct Accuracy {
    pub(super) conditions: Vec<ConditionFigures>,
}

impl Accuracy {
    /// Results of one scheme among all queries; conditions in order of appearance.
    pub(super) fn of(queries: &[StressQuery], scheme: Scheme) -> Self {
        let mut stresses: Vec<&str> = Vec::new();
        for query in queries {
            if !stresses.contains(&query.stress.as_str()) {
                stresses.push(&query.stress);
            }
        }
        let (own, points) = (scheme.to_string(), Scheme::Points.to_string());
        let pick = |stress: &str, scheme: &str| {
            queries.iter().filter(|q| q.stress == stress && q.scheme == scheme).collect::<Vec<_>>()
        };
        let condition = |stress: &&str| condition(stress, &pick(stress, &own), &pick(stress, &points));
        Self { conditions: stresses.iter().map(condition).collect() }
    }

    /// The geometric mean over conditions; `None` when one of them has no value.
    pub(super) fn mean(&self, which: fn(&ConditionFigures) -> Option<f64>) -> Option<f64> {
        let logs: Option<Vec<f64>> = self.conditions.iter().map(|c| which(c).map(f64::ln)).collect();
        logs.filter(|l| !l.is_empty()).and_then(|l| finite((l.iter().sum::<f64>() / l.len() as f64).exp()))
    }
}

fn condition(stress: &str, own: &[&StressQuery], points: &[&StressQuery]) -> ConditionFigures {
    let errors = |queries: &[&StressQuery], of: fn(&StressQuery) -> Option<f64>| -> Vec<f64> {
        queries.iter().map(|q| of(q).unwrap_or(f64::INFINITY)).collect()
    };
    let position = |q: &StressQuery| q.error.translation_error;
    let rotation = |q: &StressQuery| q.error.rotation_error_deg;
    let ratio = |of: fn(&StressQuery) -> Option<f64>, figure: fn(&[f64]) -> f64| {
        finite(figure(&errors(own, of)) / figure(&errors(points, of)))
    };
    let trusted = |queries: &[&StressQuery]| queries.iter().filter(|q| q.state == State::Trusted).count();
    ConditionFigures {
        stress: stress.to_owned(),
        error_over_points: ratio(position, median),
        tail_over_points: ratio(position, tail),
        rotation_over_points: ratio(rotation, median),
        median_translation: finite(median(&errors(own, position))),
        queries: own.len(),
        trusted: trusted(own),
        trusted_points: trusted(points),
    }
}

/// The smallest value that at least 90 % of all values do not exceed; NaN without values.
fn tail(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (0.9 * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stress::ErrorDocument;

    fn query(scheme: &str, stress: &str, error: Option<f64>) -> StressQuery {
        StressQuery {
            name: "a".to_owned(),
            scheme: scheme.to_owned(),
            stress: stress.to_owned(),
            gravity_sd_deg: None,
            state: if error.is_some() { State::Trusted } else { State::NotFound },
            error: ErrorDocument { rotation_error_deg: error.map(|e| 10.0 * e), translation_error: error },
            uncertainty: None,
            log_evidence: None,
            inliers: 0,
            matches: 0,
            doubts: Vec::new(),
            failure: None,
            from_truth: None,
        }
    }

    /// Ten queries of each; the layout has twice the error, four times in the sparse map, and loses queries there.
    #[test]
    fn ratios_use_the_same_queries_and_lost_ones_are_infinite() {
        let mut queries = Vec::new();
        for i in 1..=10 {
            let error = f64::from(i);
            queries.push(query("points", "none", Some(error)));
            queries.push(query("dcl", "none", Some(if i == 9 { 27.0 } else { 2.0 * error })));
            queries.push(query("points", "sparse-map", Some(error)));
            queries.push(query("dcl", "sparse-map", (i < 9).then_some(4.0 * error)));
        }
        let found = Accuracy::of(&queries, Scheme::default());
        let [plain, sparse] = &found.conditions[..] else { panic!("two conditions") };
        assert_eq!((plain.stress.as_str(), plain.error_over_points), ("none", Some(2.0)));
        // Of ten values the ninth: 20, the tenth, is below 27, the ninth.
        assert_eq!((plain.tail_over_points, plain.rotation_over_points), (Some(20.0 / 9.0), Some(2.0)));
        assert_eq!((sparse.error_over_points, sparse.tail_over_points), (Some(4.0), None));
        assert_eq!((sparse.queries, sparse.trusted, sparse.trusted_points), (10, 8, 10));
        let mean = found.mean(|c| c.error_over_points).expect("both have one");
        assert!((mean - 8.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(found.mean(|c| c.tail_over_points), None);
        assert_eq!(Accuracy::of(&[], Scheme::default()).mean(|c| c.error_over_points), None);
    }
}
