//! Data of a localization report, filled by the caller.

use std::collections::BTreeMap;

use image::RgbImage;

use crate::heat::HeatMap;
use crate::numbers::{LengthUnit, scheme_name};
use crate::page::Card;
use crate::scene::{QueryOutcome, SceneView, SentDrawing};

/// Queries of one or more scenes, localized by one or more methods. Any list may be empty; its section is then left
/// out.
#[derive(Debug, Clone, Default)]
pub struct LocalizationReport {
    /// Heading and browser title.
    pub title: String,
    /// One or two sentences below the heading.
    pub lead: String,
    /// Warnings about the file's content, one sentence each.
    pub notices: Vec<String>,
    /// A few large numbers.
    pub cards: Vec<Card>,
    /// The unit of all lengths.
    pub unit: LengthUnit,
    /// Rows of the table: methods, scene by scene.
    pub methods: Vec<Method>,
    /// Stages of a query in the order of processing: the columns of the times.
    pub stages: Vec<String>,
    /// The result of every query by every method.
    pub outcomes: Vec<QueryOutcome>,
    /// The scenes.
    pub scenes: Vec<SceneView>,
    /// The expected ± over the first scene; empty for a report on queries.
    pub heat: HeatMap,
    /// Drawn queries, worst first.
    pub drawings: Vec<QueryDrawing>,
    /// Name and value of information for a repetition.
    pub facts: Vec<(String, String)>,
}

/// A localization method on a scene.
#[derive(Debug, Clone, Default)]
pub struct Method {
    /// Index of the scene.
    pub scene: usize,
    /// Capture condition of the queries, if the data set distinguishes conditions.
    pub condition: Option<String>,
    /// Obfuscation scheme.
    pub scheme: String,
    /// Display text that distinguishes the method from others with the same scheme; may be empty.
    pub variant: String,
    /// Its figures, if there are any.
    pub figures: Option<MethodFigures>,
}

/// Figures of a method over its queries. An absent figure leaves its cell empty.
#[derive(Debug, Clone, Default)]
pub struct MethodFigures {
    /// Number of queries.
    pub queries: usize,
    /// Number of localized ones.
    pub localized: usize,
    /// Number of trusted poses; absent if trust was not evaluated.
    pub trusted: Option<usize>,
    /// Number of trusted poses outside every threshold.
    pub trusted_wrong: Option<usize>,
    /// Number of doubtful poses.
    pub doubtful: Option<usize>,
    /// Number of queries without a pose.
    pub not_found: Option<usize>,
    /// Median position error.
    pub median_translation: Option<f64>,
    /// Median orientation error, degrees.
    pub median_rotation_deg: Option<f64>,
    /// Share of the queries within each threshold, `translation/degrees`.
    pub recall: BTreeMap<String, f64>,
    /// Mean share of inliers among the matches.
    pub mean_inlier_ratio: Option<f64>,
    /// Bytes of a sealed query.
    pub sealed_bytes: Option<usize>,
    /// Median of the position error over its ±.
    pub error_over_sd: Option<f64>,
    /// Share of the true poses in the 90 % confidence region.
    pub within_90: Option<f64>,
    /// Median time of each stage, ms.
    pub median_ms: BTreeMap<String, f64>,
}

/// A query with its sent rows.
#[derive(Debug, Clone)]
pub struct QueryDrawing {
    /// Index of its scene.
    pub scene: usize,
    /// Its name.
    pub name: String,
    /// The image; never sent.
    pub image: Option<RgbImage>,
    /// Whether lens distortion is removed from the image, as it is from the lines.
    pub is_undistorted: bool,
    /// Sent rows, scheme by scheme.
    pub sent: Vec<SentDrawing>,
}

/// Display name of a method.
pub(super) fn method_name(method: &Method) -> String {
    let name = scheme_name(&method.scheme);
    if method.variant.is_empty() { name } else { format!("{name} · {}", method.variant) }
}
