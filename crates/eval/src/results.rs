//! What `veiloc eval` found: the stable JSON document, and the table for people.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Serialize;
use veiloc_geometry::CameraFromWorld;
use veiloc_query::Scheme;
use veiloc_robust::ScoreKind;

use crate::metrics::{PoseError, Threshold, mean, median, recall};

/// The document that `eval pose --json` and `eval scene --json` print.
#[derive(Debug, Clone, Serialize)]
pub struct Evaluation {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// The command, `eval pose` or `eval scene`.
    pub command: &'static str,
    /// What was evaluated on.
    pub data: Vec<String>,
    /// Seed of every random choice.
    pub seed: u64,
    /// Whether matches were weighed by descriptor ratio, votes and track length.
    pub prior: bool,
    /// Hypotheses of every query; null when the estimator stopped by itself.
    pub fixed_hypotheses: Option<usize>,
    /// One entry per scheme and score.
    pub schemes: Vec<SchemeSummary>,
    /// One entry per scheme, score and query.
    pub queries: Vec<QueryResult>,
    /// Facts about the map, for `eval scene`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map: Option<MapSummary>,
}

/// All queries of one scheme under one score.
#[derive(Debug, Clone, Serialize)]
pub struct SchemeSummary {
    /// Obfuscation scheme.
    pub scheme: String,
    /// Score by which hypotheses were compared.
    pub score: String,
    /// How many queries.
    pub queries: usize,
    /// How many got a pose at all, right or wrong.
    pub localized: usize,
    /// Median over all queries, degrees; null when more than half were not localized.
    pub median_rotation_deg: Option<f64>,
    /// Median over all queries, map units; null when more than half were not localized.
    pub median_translation: Option<f64>,
    /// Threshold (`translation/degrees`) to share of queries within it, 0 to 1.
    pub recall: BTreeMap<String, f64>,
    /// Mean share of correspondences that agree with the estimated pose.
    pub mean_inlier_ratio: Option<f64>,
    /// Bytes of one sealed query, median; absent where nothing is sealed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sealed_bytes: Option<usize>,
    /// Stage to median milliseconds.
    pub median_ms: BTreeMap<String, f64>,
}

/// One query under one scheme.
#[derive(Debug, Clone, Serialize)]
pub struct QueryResult {
    /// Its name in the data.
    pub name: String,
    /// Obfuscation scheme.
    pub scheme: String,
    /// Score by which hypotheses were compared.
    pub score: String,
    /// The estimated pose; absent when not localized.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cam_from_world: Option<PoseDocument>,
    /// Degrees; null when not localized.
    pub rotation_error_deg: Option<f64>,
    /// Map units; null when not localized.
    pub translation_error: Option<f64>,
    /// Correspondences that agree with the pose.
    pub inliers: usize,
    /// Correspondences there were.
    pub correspondences: usize,
    /// Hypotheses drawn.
    pub hypotheses: usize,
    /// Why there is no pose, when there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
    /// Bytes of the sealed query; absent where nothing is sealed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sealed_bytes: Option<usize>,
    /// Stage to milliseconds.
    pub ms: BTreeMap<String, f64>,
}

/// A pose in a document, world to camera.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct PoseDocument {
    /// Hamilton quaternion `w x y z`.
    pub q: [f64; 4],
    /// Translation, map units.
    pub t: [f64; 3],
}

impl PoseDocument {
    /// Of a pose.
    pub fn of(pose: &CameraFromWorld) -> Self {
        let t = pose.translation();
        Self { q: pose.quaternion(), t: [t.x, t.y, t.z] }
    }

    /// The pose again; `None` when the numbers are none.
    pub fn pose(&self) -> Option<CameraFromWorld> {
        CameraFromWorld::from_quaternion(self.q, self.t)
    }
}

/// Facts about the map a scene was localized in.
#[derive(Debug, Clone, Serialize)]
pub struct MapSummary {
    /// Registered images.
    pub images: usize,
    /// Map points.
    pub points: usize,
    /// Bytes of the map file.
    pub bytes: u64,
    /// Seconds to build it, all images together.
    pub build_seconds: f64,
}

impl QueryResult {
    /// A query that has no pose (yet).
    pub(crate) fn unsolved(name: &str, scheme: Scheme, score: ScoreKind) -> Self {
        Self {
            name: name.to_owned(),
            scheme: scheme.to_string(),
            score: score.to_string(),
            cam_from_world: None,
            rotation_error_deg: None,
            translation_error: None,
            inliers: 0,
            correspondences: 0,
            hypotheses: 0,
            failure: None,
            sealed_bytes: None,
            ms: BTreeMap::new(),
        }
    }

    /// With the reason why there is no pose.
    pub(crate) fn because(mut self, error: &impl std::error::Error) -> Self {
        self.failure = Some(error.to_string());
        self
    }

    /// With an estimate, and how far it is from the truth.
    pub(crate) fn found(mut self, estimate: &CameraFromWorld, truth: &CameraFromWorld) -> Self {
        let error = PoseError::of(estimate, truth);
        self.cam_from_world = Some(PoseDocument::of(estimate));
        self.rotation_error_deg = finite(error.rotation_deg);
        self.translation_error = finite(error.translation);
        self
    }

    /// Errors as numbers that compare, infinite when not localized.
    pub fn pose_error(&self) -> PoseError {
        match (self.rotation_error_deg, self.translation_error) {
            (Some(rotation_deg), Some(translation)) => PoseError { rotation_deg, translation },
            _ => PoseError::NOT_LOCALIZED,
        }
    }

    fn is_localized(&self) -> bool {
        self.rotation_error_deg.is_some()
    }
}

/// JSON has no infinity: a number that is not finite becomes null.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// Sums up the queries of one scheme and score.
pub fn summarize(queries: &[&QueryResult], thresholds: &[Threshold]) -> SchemeSummary {
    let errors: Vec<PoseError> = queries.iter().map(|q| q.pose_error()).collect();
    let rotations: Vec<f64> = errors.iter().map(|e| e.rotation_deg).collect();
    let translations: Vec<f64> = errors.iter().map(|e| e.translation).collect();
    let localized: Vec<&&QueryResult> = queries.iter().filter(|q| q.is_localized()).collect();
    let ratios: Vec<f64> =
        localized.iter().map(|q| q.inliers as f64 / q.correspondences.max(1) as f64).collect();
    let stages: std::collections::BTreeSet<&String> = queries.iter().flat_map(|q| q.ms.keys()).collect();
    let median_ms = stages
        .into_iter()
        .map(|stage| {
            let times: Vec<f64> = queries.iter().filter_map(|q| q.ms.get(stage).copied()).collect();
            (stage.clone(), median(&times))
        })
        .collect();
    let mut bytes: Vec<usize> = queries.iter().filter_map(|q| q.sealed_bytes).collect();
    bytes.sort_unstable();
    SchemeSummary {
        scheme: queries.first().map(|q| q.scheme.clone()).unwrap_or_default(),
        score: queries.first().map(|q| q.score.clone()).unwrap_or_default(),
        queries: queries.len(),
        localized: localized.len(),
        median_rotation_deg: finite(median(&rotations)),
        median_translation: finite(median(&translations)),
        recall: thresholds.iter().map(|t| (t.to_string(), recall(&errors, t))).collect(),
        mean_inlier_ratio: finite(mean(&ratios)),
        sealed_bytes: bytes.get(bytes.len() / 2).copied(),
        median_ms,
    }
}

/// Stages in the order a query passes them; the table's columns.
const STAGES: [&str; 6] = ["extract", "seal", "decode", "retrieve", "match", "pose"];

fn stages(summary: &SchemeSummary) -> impl Iterator<Item = (&'static str, f64)> + '_ {
    STAGES.iter().filter_map(|stage| Some((*stage, *summary.median_ms.get(*stage)?)))
}

/// The summaries as a table for people, one row a scheme.
pub fn table(schemes: &[SchemeSummary]) -> String {
    let mut rows = vec![header(schemes)];
    rows.extend(schemes.iter().map(row));
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns)
        .map(|c| rows.iter().filter_map(|r| r.get(c)).map(|cell| cell.chars().count()).max().unwrap_or(0))
        .collect();
    let mut text = String::new();
    for (index, cells) in rows.iter().enumerate() {
        for (column, (cell, width)) in cells.iter().zip(&widths).enumerate() {
            // Names to the left, numbers to the right.
            let padded = if column < 2 { format!("{cell:<width$}") } else { format!("{cell:>width$}") };
            let gap = if column == 0 { "" } else { "  " };
            let _ = write!(text, "{gap}{padded}");
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
        if index == 0 {
            let rule = widths.iter().sum::<usize>() + 2 * widths.len().saturating_sub(1);
            text.push_str(&"─".repeat(rule));
            text.push('\n');
        }
    }
    text
}

fn header(schemes: &[SchemeSummary]) -> Vec<String> {
    let mut cells: Vec<String> =
        ["scheme", "score", "localized", "rot °", "trans"].map(str::to_owned).to_vec();
    if let Some(first) = schemes.first() {
        cells.extend(first.recall.keys().map(|t| format!("≤{t}")));
        cells.push("inliers".to_owned());
        cells.extend(stages(first).map(|(stage, _)| format!("{stage} ms")));
        if first.sealed_bytes.is_some() {
            cells.push("sealed bytes".to_owned());
        }
    }
    cells
}

fn row(s: &SchemeSummary) -> Vec<String> {
    let number = |v: Option<f64>, digits: usize| v.map_or("—".to_owned(), |v| format!("{v:.digits$}"));
    let mut cells = vec![
        s.scheme.clone(),
        s.score.clone(),
        format!("{}/{}", s.localized, s.queries),
        number(s.median_rotation_deg, 3),
        number(s.median_translation, 4),
    ];
    cells.extend(s.recall.values().map(|r| format!("{:.1} %", 100.0 * r)));
    cells.push(s.mean_inlier_ratio.map_or("—".to_owned(), |r| format!("{:.1} %", 100.0 * r)));
    cells.extend(stages(s).map(|(_, ms)| format!("{ms:.1}")));
    cells.extend(s.sealed_bytes.map(|b| b.to_string()));
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    fn query(error: Option<(f64, f64)>) -> QueryResult {
        QueryResult {
            name: "a.jpg".into(),
            scheme: "dcl".into(),
            score: "likelihood".into(),
            cam_from_world: None,
            rotation_error_deg: error.map(|e| e.0),
            translation_error: error.map(|e| e.1),
            inliers: 30,
            correspondences: 60,
            hypotheses: 100,
            failure: None,
            sealed_bytes: Some(1000),
            ms: [("pose".to_owned(), 5.0)].into(),
        }
    }

    #[test]
    fn a_summary_counts_failures_as_infinite() {
        let queries = [query(Some((0.1, 0.01))), query(None), query(None)];
        let refs: Vec<&QueryResult> = queries.iter().collect();
        let s = summarize(&refs, &["0.05/5".parse().expect("well written")]);
        assert_eq!((s.queries, s.localized), (3, 1));
        assert_eq!(s.median_rotation_deg, None);
        assert!((s.recall["0.05/5"] - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(s.mean_inlier_ratio, Some(0.5));
        let text = table(&[s]);
        assert!(text.contains("1/3") && text.contains("33.3 %") && text.contains('—'), "{text}");
        let widths: Vec<usize> = text.lines().map(|l| l.chars().count()).collect();
        assert!(widths.windows(2).all(|w| w[0] == w[1]), "{text}");
    }
}
