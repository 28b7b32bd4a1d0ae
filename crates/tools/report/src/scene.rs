//! What drawings show: a scene, its localized queries, and the rows that a query sent.

use veiloc_geometry::{CameraFromWorld, Pixel, PlanePoint};
use veiloc_localization::Localization;
use veiloc_map::{MapFile, PointId};
use veiloc_pose::State;
use veiloc_protocol::{Observations, SealedQuery};

/// Maximum number of map points in a drawing; more only increase the file.
const MAX_POINTS: usize = 24_000;

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

/// The queries of one method.
pub(crate) struct SpaceRow<'a> {
    /// Name of the method.
    pub(crate) name: String,
    pub(crate) outcomes: Vec<&'a QueryOutcome>,
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

impl SceneView {
    /// A view of a map, with a subset of its points if there are many.
    pub fn of_map(name: &str, map: &MapFile) -> Self {
        let step = map.point_count().div_ceil(MAX_POINTS).max(1);
        let points = (0..map.point_count()).step_by(step);
        Self {
            name: name.to_owned(),
            points: points.map(|i| map.point(PointId(i as u32)).coords.into()).collect(),
            cameras: map.images().map(|image| *image.cam_from_world()).collect(),
            up: map.down().map(|down| down.in_world().map(|x| -x)),
        }
    }
}

impl SentDrawing {
    /// The drawing of a sealed query, with its pose if there is one.
    pub fn of(query: &SealedQuery, found: Option<&Localization>, map: &MapFile) -> Self {
        let camera = query.camera();
        let mut rows = vec![MatchState::Unmatched; query.len()];
        let mut projected = Vec::new();
        for pair in found.map_or(&[][..], |found| &found.matched) {
            let Some(state) = rows.get_mut(pair.row) else { continue };
            match (pair.agrees, *state) {
                (true, _) => *state = MatchState::Inlier,
                (false, MatchState::Unmatched) => *state = MatchState::Outlier,
                _ => {}
            }
            let seen = found.map(|found| found.cam_from_world.transform(&map.point(pair.point)));
            if let Some(seen) = seen.filter(|seen| pair.agrees && seen.depth() > 0.0) {
                let at = seen.coords / seen.depth();
                projected.push(camera.project(PlanePoint::new(at.x, at.y)));
            }
        }
        Self {
            scheme: query.scheme().to_string(),
            sent: query.observations(),
            size: (camera.width, camera.height),
            rows,
            projected,
        }
    }
}
