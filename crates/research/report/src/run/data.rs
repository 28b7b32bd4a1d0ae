//! What a page on a run shows: plain data, filled by whoever localized.

use image::RgbImage;
use veiloc_evaluation::results::SchemeSummary;
use veiloc_geometry::{CameraFromWorld, Pixel};
use veiloc_pose::State;
use veiloc_protocol::Observations;

use crate::card::Card;

/// A run: queries of one place or several, localized in several ways. Any list may be empty; its section is then left out.
#[derive(Debug, Clone, Default)]
pub struct RunReport {
    /// Heading and browser title.
    pub title: String,
    /// One or two sentences under it.
    pub lead: String,
    /// What a reader must know of this file, a sentence each.
    pub remarks: Vec<String>,
    /// A few large numbers.
    pub cards: Vec<Card>,
    /// Rows of the table: the ways in which queries were localized, place by place.
    pub rows: Vec<RunRow>,
    /// What became of every query in every row.
    pub outcomes: Vec<QueryOutcome>,
    /// Curves and bars over all queries.
    pub figures: Vec<RunFigure>,
    /// The places.
    pub places: Vec<PlaceView>,
    /// Queries that are drawn; shown worst first.
    pub drawings: Vec<QueryDrawing>,
    /// Name and value of facts for whoever repeats the run.
    pub details: Vec<(String, String)>,
}

/// A way in which the queries of a place were localized.
#[derive(Debug, Clone, Default)]
pub struct RunRow {
    /// Index of the place.
    pub place: usize,
    /// What the queries were taken under, where the data tells them apart.
    pub condition: Option<String>,
    /// Obfuscation scheme.
    pub scheme: String,
    /// What else tells the row from others, for people; empty when the scheme does.
    pub beside: String,
    /// Its figures; absent where nothing is summed up.
    pub summary: Option<SchemeSummary>,
}

/// What became of a query in a row.
#[derive(Debug, Clone, Default)]
pub struct QueryOutcome {
    /// Index of the row.
    pub row: usize,
    /// Its name.
    pub name: String,
    /// True pose, where it is known.
    pub truth: Option<CameraFromWorld>,
    /// Estimated pose.
    pub estimate: Option<CameraFromWorld>,
    /// What the estimator says the pose is worth, where it was asked.
    pub state: Option<State>,
    /// Error of the position, map units.
    pub position_error: Option<f64>,
    /// Error of the orientation, degrees.
    pub rotation_error_deg: Option<f64>,
    /// The ± of the position: the standard deviation in its least certain direction, map units.
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

/// A drawing over all queries.
#[derive(Debug, Clone)]
pub struct RunFigure {
    /// What it shows, a sentence.
    pub caption: String,
    /// As `plots` draws it.
    pub svg: String,
}

/// A place: its points and the cameras of its map.
#[derive(Debug, Clone, Default)]
pub struct PlaceView {
    /// Its name; empty when there is only one.
    pub name: String,
    /// Map points, map units (metres).
    pub points: Vec<[f64; 3]>,
    /// Poses of the images in the map.
    pub mapping: Vec<CameraFromWorld>,
    /// Direction of the map that points up. Default: what is up in the images of the map, on the whole.
    pub up: Option<[f64; 3]>,
}

/// A query with what was sent of it.
#[derive(Debug, Clone)]
pub struct QueryDrawing {
    /// Index of its place.
    pub place: usize,
    /// Its name.
    pub name: String,
    /// The image in the camera that lines are of; never sent.
    pub image: Option<RgbImage>,
    /// What was sent, scheme by scheme.
    pub sent: Vec<SentDrawing>,
}

/// What was sent of a query under a scheme, and what the server made of it.
#[derive(Debug, Clone)]
pub struct SentDrawing {
    /// Obfuscation scheme.
    pub scheme: String,
    /// What was sent.
    pub sent: Observations,
    /// Size of the camera's image, pixels.
    pub size: (u32, u32),
    /// What became of each row, `[sent]`.
    pub rows: Vec<RowState>,
    /// Where the map points of agreeing rows appear under the estimated pose, pixels: what a server knows that has the pose.
    pub projected: Vec<Pixel>,
}

/// What became of a row of a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RowState {
    /// No map point looks like it.
    #[default]
    Unmatched,
    /// It was matched, and the pose does not agree.
    Disagrees,
    /// It was matched, and the pose agrees.
    Agrees,
}
