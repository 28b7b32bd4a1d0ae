//! `veiloc localize --rig`: estimates one pose from the sealed queries of a session.

use std::path::Path;

use serde::Serialize;
use veiloc_localization::{FrameLocalization, LocalizeError, LocalizeOptions, localize_rig};
use veiloc_map::MapFile;
use veiloc_protocol::{Answer, PoseDocument, SealedFrame};

use super::document::{ErrorDocument, ResultDocument, answer_text, reason};
use crate::args::need::Need;
use crate::commands::rig_file;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::ui::Ui;

/// The answer for the sealed queries of a session, whose relative poses the device has measured: `cam_from_world` is the
/// pose of the rig. The rig file is in [formats.md](formats.md#rig-file).
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct RigDocument {
    /// The map, as given.
    map: String,
    /// The rig file, as given.
    rig: String,
    #[serde(flatten)]
    result: ResultDocument,
    /// The frames, in the order of the rig file.
    frames: Vec<FrameDocument>,
}

/// One frame of it.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct FrameDocument {
    /// The sealed query, as the rig file names it.
    query: String,
    /// Pose of this frame's camera; absent without a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    cam_from_world: Option<PoseDocument>,
    /// Number of matches of this frame that agree with the pose of the rig; 0 without a pose.
    inliers: usize,
    /// Number of matches of this frame with the map.
    matches: usize,
    /// Standard deviation of the inliers' residuals, pixels; absent without inliers.
    #[serde(skip_serializing_if = "Option::is_none")]
    noise_px: Option<f64>,
    /// Estimated focal length divided by that of the query, one value for all frames of the same camera; 1 when it was
    /// not estimated; absent when nothing was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    focal_scale: Option<f64>,
    /// Distance of the camera from its odometry, standard deviations over six numbers: 2.4 on average if the stated
    /// deviations are right; 0 for a frame that is fixed to the rig; absent when nothing was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    odometry_deviation: Option<f64>,
}

pub(super) fn run(
    map_path: &Path,
    rig: &Path,
    mut options: LocalizeOptions,
    need: Option<Need>,
    trusted_only: bool,
    json: bool,
    ui: &Ui,
) -> Outcome {
    let map = MapFile::open(map_path)?;
    options.need = Need::in_map(need, &map)?;
    let named = rig_file::read(rig)?;
    let (files, frames): (Vec<String>, Vec<SealedFrame>) =
        named.into_iter().map(|named| (named.file, named.sealed)).unzip();
    let found = match localize_rig(&frames, &map, &options) {
        Err(LocalizeError::Frame { frame, source }) => {
            let file = files.get(frame).map_or("", String::as_str);
            return Err(Failure::refused(format!("{}: frame {frame} ({file}): {source}", rig.display())));
        }
        found => found,
    };
    let (result, frames) = match found {
        Ok(found) => {
            let answer = found.answer(&map);
            let answer = if trusted_only { answer.trusted_only() } else { answer };
            let with_pose = answer.pose.is_some();
            let frames = files.into_iter().zip(&found.frames);
            (Ok(answer), frames.map(|(file, frame)| FrameDocument::of(file, frame, with_pose)).collect())
        }
        Err(error) => {
            (Err(ErrorDocument::of(&error)), files.into_iter().map(FrameDocument::without_pose).collect())
        }
    };
    let document = RigDocument {
        map: map_path.display().to_string(),
        rig: rig.display().to_string(),
        result: ResultDocument::of(&result),
        frames,
    };
    if json {
        ui.json(&document)?;
    } else {
        ui.print(text(&document, &result));
    }
    Ok(match result {
        Ok(answer) if answer.pose.is_none() => Exit::Refused,
        Ok(answer) if answer.trusted() => Exit::Success,
        Ok(_) => Exit::Doubtful,
        Err(_) => Exit::Refused,
    })
}

impl FrameDocument {
    /// `with_pose`: false when the pose is withheld.
    fn of(query: String, frame: &FrameLocalization, with_pose: bool) -> Self {
        Self {
            query,
            cam_from_world: with_pose.then(|| PoseDocument::of(&frame.cam_from_world)),
            inliers: frame.inliers,
            matches: frame.matches,
            noise_px: frame.noise_px,
            focal_scale: Some(frame.focal_scale),
            odometry_deviation: Some(frame.odometry_deviation),
        }
    }

    const fn without_pose(query: String) -> Self {
        Self {
            query,
            cam_from_world: None,
            inliers: 0,
            matches: 0,
            noise_px: None,
            focal_scale: None,
            odometry_deviation: None,
        }
    }
}

/// One line for the rig, and one for each frame.
fn text(document: &RigDocument, result: &Result<Answer, ErrorDocument>) -> String {
    use std::fmt::Write as _;
    let mut text = match (result, reason(result)) {
        (Ok(answer), None) => format!("{}  {}  {}\n", document.rig, answer.state(), answer_text(answer)),
        (Ok(answer), Some(why)) => return format!("{}  {}  {why}\n", document.rig, answer.state()),
        (Err(error), _) => return format!("{}  not-found  {}\n", document.rig, error.message()),
    };
    let width = document.frames.iter().map(|f| f.query.chars().count()).max().unwrap_or(0);
    for frame in &document.frames {
        let deviation = frame.odometry_deviation.unwrap_or(0.0);
        let _ = writeln!(
            text,
            "  {:<width$}  {} of {} matches agree, {deviation:.1} deviations from its odometry",
            frame.query, frame.inliers, frame.matches
        );
    }
    text
}
