//! Data of a localization report, filled by the caller.

use image::RgbImage;
use veiloc_evaluation::results::SchemeSummary;
use veiloc_geometry::{CameraFromWorld, Pixel};
use veiloc_pose::State;
use veiloc_protocol::Observations;

use crate::heat::HeatMap;
use crate::numbers::LengthUnit;
use crate::page::Card;

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
    pub summary: Option<SchemeSummary>,
}

/// The result of a query by one method.
#[derive(Debug, Clone, Default)]
pub struct QueryOutcome {
    /// Index of the method.
    pub method: usize,
    /// Its name.
    pub name: String,
    /// True pose, if known.
    pub truth: Option<CameraFromWorld>,
    /// Estimated pose.
    pub estimate: Option<CameraFromWorld>,
    /// State of the pose according to the estimator, if evaluated.
    pub state: Option<State>,
    /// Error of the position.
    pub position_error: Option<f64>,
    /// Error of the orientation, degrees.
    pub rotation_error_deg: Option<f64>,
    /// The ± of the position: the standard deviation in its least certain direction.
    pub position_sd: Option<f64>,
    /// The same of the orientation, degrees.
    pub rotation_sd_deg: Option<f64>,
    /// Matches that agree with the pose.
    pub inliers: usize,
    /// Number of matches.
    pub matches: usize,
    /// Bytes that were sent.
    pub bytes: Option<usize>,
    /// Milliseconds of all stages.
    pub ms: Option<f64>,
    /// Reasons to doubt the pose, or why there is none.
    pub remark: Option<String>,
}

/// A scene: its points and the cameras of its map.
#[derive(Debug, Clone, Default)]
pub struct SceneView {
    /// Its name; empty when there is only one.
    pub name: String,
    /// Map points.
    pub points: Vec<[f64; 3]>,
    /// Poses of the images in the map.
    pub cameras: Vec<CameraFromWorld>,
    /// Up direction in the map. Default: the mean up direction of the map's images.
    pub up: Option<[f64; 3]>,
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

/// The rows of a query sent under a scheme, with the server's matches.
#[derive(Debug, Clone)]
pub struct SentDrawing {
    /// Obfuscation scheme.
    pub scheme: String,
    /// The sent rows.
    pub sent: Observations,
    /// Size of the camera's image, pixels.
    pub size: (u32, u32),
    /// The match of each row, `[sent]`.
    pub rows: Vec<MatchState>,
    /// Projections of the inliers' map points under the estimated pose, pixels: known to a server that has the pose.
    pub projected: Vec<Pixel>,
}

/// The match of a row of a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MatchState {
    /// No match.
    #[default]
    Unmatched,
    /// A match that does not agree with the pose.
    Outlier,
    /// A match that agrees with the pose.
    Inlier,
}
