//! What a report on localization shows: plain data, filled by the caller that localized.

use image::RgbImage;
use veiloc_evaluation::results::SchemeSummary;
use veiloc_evaluation::results::tables::TableData;
use veiloc_geometry::{CameraFromWorld, Pixel};
use veiloc_pose::State;
use veiloc_protocol::Observations;

use crate::numbers::LengthUnit;
use crate::page::Card;

/// Queries of one scene or several, localized by one method or several. Any list may be empty; its section is then left out.
#[derive(Debug, Clone, Default)]
pub struct LocalizationReport {
    /// Heading and browser title.
    pub title: String,
    /// One or two sentences under it.
    pub lead: String,
    /// What a reader must know of this file, a sentence each.
    pub notices: Vec<String>,
    /// A few large numbers.
    pub cards: Vec<Card>,
    /// The unit of all lengths.
    pub unit: LengthUnit,
    /// Rows of the table: how queries were localized, scene by scene.
    pub methods: Vec<Method>,
    /// The result of every query by every method.
    pub outcomes: Vec<QueryOutcome>,
    /// The evaluation's document, for curves of errors.
    pub data: Option<TableData>,
    /// The scenes.
    pub scenes: Vec<SceneView>,
    /// Queries that are drawn; shown worst first.
    pub drawings: Vec<QueryDrawing>,
    /// Name and value of what a repetition needs.
    pub facts: Vec<(String, String)>,
}

/// How the queries of a scene were localized.
#[derive(Debug, Clone, Default)]
pub struct Method {
    /// Index of the scene.
    pub scene: usize,
    /// Capture condition of the queries, where the data set tells conditions apart.
    pub condition: Option<String>,
    /// Obfuscation scheme.
    pub scheme: String,
    /// What else tells the method from others, for people; empty when the scheme does.
    pub variant: String,
    /// Its figures; absent where nothing is summed up.
    pub summary: Option<SchemeSummary>,
}

/// The result of a query by one method.
#[derive(Debug, Clone, Default)]
pub struct QueryOutcome {
    /// Index of the method.
    pub method: usize,
    /// Its name.
    pub name: String,
    /// True pose, where it is known.
    pub truth: Option<CameraFromWorld>,
    /// Estimated pose.
    pub estimate: Option<CameraFromWorld>,
    /// Whether the estimator trusts the pose, where it was asked.
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
    /// Matches there were.
    pub matches: usize,
    /// Bytes that were sent.
    pub bytes: Option<usize>,
    /// Milliseconds of all stages.
    pub ms: Option<f64>,
    /// What speaks against the pose, or why there is none.
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
    /// Direction of the map that points up. Default: the mean of what is up in the images of the map.
    pub up: Option<[f64; 3]>,
}

/// A query, and what was sent of it.
#[derive(Debug, Clone)]
pub struct QueryDrawing {
    /// Index of its scene.
    pub scene: usize,
    /// Its name.
    pub name: String,
    /// The image; never sent.
    pub image: Option<RgbImage>,
    /// Whether the distortion of the lens is removed from the image, as it is from the lines.
    pub is_undistorted: bool,
    /// What was sent, scheme by scheme.
    pub sent: Vec<SentDrawing>,
}

/// What was sent of a query under a scheme, and what the server matched.
#[derive(Debug, Clone)]
pub struct SentDrawing {
    /// Obfuscation scheme.
    pub scheme: String,
    /// What was sent.
    pub sent: Observations,
    /// Size of the camera's image, pixels.
    pub size: (u32, u32),
    /// The match of each row, `[sent]`.
    pub rows: Vec<MatchState>,
    /// Where the map points of inliers appear under the estimated pose, pixels: known to a server that has the pose.
    pub projected: Vec<Pixel>,
}

/// The match of a row of a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MatchState {
    /// None.
    #[default]
    Unmatched,
    /// One that does not agree with the pose.
    Outlier,
    /// One that agrees with the pose.
    Inlier,
}
