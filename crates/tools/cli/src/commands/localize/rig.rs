//! `veiloc localize --rig`: estimates one pose from the sealed queries of a session.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use veiloc_evaluation::results::PoseDocument;
use veiloc_geometry::CameraFromWorld;
use veiloc_localization::{LocalizeError, LocalizeOptions, RigLocalization, localize_rig};
use veiloc_map::MapFile;
use veiloc_pose::State;
use veiloc_protocol::SealedFrame;

use super::document::{ConfidenceDocument, ErrorDocument, NoPoseKind, name_of, not_localized};
use crate::args::need::Need;
use crate::commands::rig_file;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::position::{position, unit_of};
use crate::output::ui::Ui;

/// One pose for the sealed queries of a session, whose relative poses the device has measured.
/// The rig file is in [formats.md](formats.md#rig-file).
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct RigDocument {
    /// 1.
    version: u32,
    /// The map, as given.
    map: String,
    /// Whether map units are metres; false if not known.
    is_metric: bool,
    /// The rig file, as given.
    rig: String,
    /// State of the pose: `trusted`, `doubtful` or `not-found`.
    state: &'static str,
    /// The pose, map to rig; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    rig_from_world: Option<PoseDocument>,
    /// Origin of the rig in the map, map units; absent without a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    center: Option<[f64; 3]>,
    /// Standard deviation of `center` in its least certain direction, map units; null when a direction is
    /// unconstrained; absent without a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    position_sd: Option<f64>,
    /// Covariance of the pose about the rig's axes, see *Covariance*; absent without a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<[[f64; 6]; 6]>,
    /// Whether the pose is trusted; false without a pose.
    trusted: bool,
    /// Reasons to doubt the pose, for people.
    doubts: Vec<String>,
    /// Evidence for and against the pose; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    confidence: Option<ConfidenceDocument>,
    /// The frames, in the order of the rig file.
    frames: Vec<FrameDocument>,
    /// Number of hypotheses, of all frames together.
    hypotheses: usize,
    /// Milliseconds of the stages `retrieve`, `match` and `pose`, all frames together.
    ms: BTreeMap<&'static str, f64>,
    /// Why there is no pose; absent with a pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<ErrorDocument>,
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
    let document = match localize_rig(&frames, &map, &options) {
        Ok(found) if trusted_only && found.state != State::Trusted => {
            withheld(localized_rig(map_path, rig, &files, &found))
        }
        Ok(found) => localized_rig(map_path, rig, &files, &found),
        Err(LocalizeError::Frame { frame, source }) => {
            let file = files.get(frame).map_or("", String::as_str);
            return Err(Failure::refused(format!("{}: frame {frame} ({file}): {source}", rig.display())));
        }
        Err(error) => {
            let kind = match error {
                LocalizeError::EmptyMap => NoPoseKind::EmptyMap,
                _ => NoPoseKind::NoPose,
            };
            failed_rig(map_path, rig, &files, not_localized(kind, &error))
        }
    };
    let document = RigDocument { is_metric: map.is_metric(), ..document };
    if json {
        ui.json(&document)?;
    } else {
        ui.print(text(&document));
    }
    Ok(match (document.rig_from_world.is_some(), document.trusted) {
        (true, true) => Exit::Success,
        (true, false) => Exit::Doubtful,
        (false, _) => Exit::Refused,
    })
}

fn localized_rig(map: &Path, rig: &Path, files: &[String], found: &RigLocalization) -> RigDocument {
    let c = found.rig_from_world.center().coords;
    // The JSON pose type is a quaternion and a translation, independent of the frame.
    let pose = CameraFromWorld::new(*found.rig_from_world.rotation(), *found.rig_from_world.translation());
    let frames = files.iter().zip(&found.frames).map(|(file, frame)| FrameDocument {
        query: file.clone(),
        cam_from_world: Some(PoseDocument::of(&frame.cam_from_world)),
        inliers: frame.inliers,
        matches: frame.matches,
        noise_px: frame.noise_px,
        focal_scale: Some(frame.focal_scale),
        odometry_deviation: Some(frame.odometry_deviation),
    });
    RigDocument {
        state: name_of(found.state),
        rig_from_world: Some(PoseDocument::of(&pose)),
        center: Some([c.x, c.y, c.z]),
        position_sd: Some(found.confidence.center_sd),
        covariance: Some(found.covariance),
        trusted: found.confidence.is_trusted(),
        doubts: found.confidence.doubts().iter().map(ToString::to_string).collect(),
        confidence: Some(ConfidenceDocument::of(&found.confidence)),
        frames: frames.collect(),
        hypotheses: found.hypotheses,
        ms: [
            ("retrieve", found.times.retrieve_ms),
            ("match", found.times.match_ms),
            ("pose", found.times.pose_ms),
        ]
        .into(),
        ..empty(map, rig)
    }
}

/// Removes the poses and all statements on them, except the reasons for doubt.
fn withheld(document: RigDocument) -> RigDocument {
    let message = format!(
        "its pose is withheld: {}; take images in another part of the scene",
        document.doubts.join("; ")
    );
    let frames = document.frames.into_iter().map(|frame| FrameDocument { cam_from_world: None, ..frame });
    RigDocument {
        rig_from_world: None,
        center: None,
        position_sd: None,
        covariance: None,
        frames: frames.collect(),
        error: Some(ErrorDocument::NotLocalized { kind: NoPoseKind::Withheld, message }),
        ..document
    }
}

fn failed_rig(map: &Path, rig: &Path, files: &[String], error: ErrorDocument) -> RigDocument {
    let frame = |file: &String| FrameDocument {
        query: file.clone(),
        cam_from_world: None,
        inliers: 0,
        matches: 0,
        noise_px: None,
        focal_scale: None,
        odometry_deviation: None,
    };
    RigDocument { frames: files.iter().map(frame).collect(), error: Some(error), ..empty(map, rig) }
}

fn empty(map: &Path, rig: &Path) -> RigDocument {
    RigDocument {
        version: 1,
        map: map.display().to_string(),
        is_metric: false,
        rig: rig.display().to_string(),
        state: name_of(State::NotFound),
        rig_from_world: None,
        center: None,
        position_sd: None,
        covariance: None,
        trusted: false,
        doubts: Vec::new(),
        confidence: None,
        frames: Vec::new(),
        hypotheses: 0,
        ms: BTreeMap::new(),
        error: None,
    }
}

/// One line for the rig, and one for each frame.
fn text(document: &RigDocument) -> String {
    use std::fmt::Write as _;
    let state = document.state;
    let mut text = match (&document.center, &document.error) {
        (Some(center), _) => {
            let sd = document.position_sd.unwrap_or(f64::INFINITY);
            let total: f64 = document.ms.values().sum();
            let doubts =
                if document.trusted { String::new() } else { format!("  {}", document.doubts.join("; ")) };
            format!(
                "{}  {state}  {} {}  {total:.0} ms{doubts}\n",
                document.rig,
                position(*center, sd),
                unit_of(document.is_metric)
            )
        }
        (None, error) => {
            let why = error.as_ref().map_or("not localized", ErrorDocument::message);
            return format!("{}  {state}  {why}\n", document.rig);
        }
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
