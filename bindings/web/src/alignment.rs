//! The map in the AR world of WebXR.

use serde::{Deserialize, Serialize};
use veiloc_ar::{Accuracy, Alignment, AlignmentOptions, Axes, CameraFromAr, UnitError, check_unit};
use veiloc_protocol::{
    Answer, AnswerDoubt, AnswerPose, AnswerTimes, GravityUse, MapCoordinates, PoseDocument,
};

use crate::error::WebError;
use crate::message;
use crate::request::Pose;

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct AddReply {
    /// What the answer did.
    update: &'static str,
    state: &'static str,
    used: usize,
    contradicting: usize,
    /// `unknown`, `agrees` or `differs`.
    distances: &'static str,
    distance_ratio: Option<f64>,
}

#[derive(Serialize)]
struct PoseReply {
    /// `None` before the first trusted answer.
    pose: Option<Pose>,
}

#[derive(Serialize)]
struct CameraReply {
    pose: Option<Pose>,
    accuracy: Option<AccuracyReply>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct AccuracyReply {
    horizontal: f64,
    vertical: f64,
    yaw_deg: f64,
}

/// What an alignment reads of an answer's JSON.
#[derive(Deserialize)]
struct AnswerFields {
    cam_from_world: Option<PoseDocument>,
    /// `None` where the matches leave a direction free.
    covariance: Option<[[Option<f64>; 6]; 6]>,
    metres_per_unit: Option<f64>,
    doubts: Vec<AnswerDoubt>,
}

fn answer_of(json: &[u8]) -> Result<Answer, WebError> {
    let fields: AnswerFields = serde_json::from_slice(json).map_err(|e| WebError::Option {
        name: "answer",
        reason: format!("not an answer of `localize`: {e}"),
    })?;
    let pose = fields.cam_from_world.zip(fields.covariance).map(|(pose, covariance)| AnswerPose {
        rotation: pose.q,
        translation: pose.t,
        covariance: covariance.map(|row| row.map(|c| c.unwrap_or(f64::INFINITY))),
    });
    let map = MapCoordinates { metres_per_unit: fields.metres_per_unit, down: None };
    Ok(Answer {
        pose,
        doubts: fields.doubts,
        map,
        log_evidence: 0.0,
        margin: 0.0,
        fit: None,
        gravity: GravityUse::default(),
        inliers: 0,
        matches: 0,
        hypotheses: 0,
        times: AnswerTimes::default(),
    })
}

/// An alignment without answers.
///
/// # Errors
/// [`WebError::Option`] for a unit that is not above 0.
pub fn begin(metres_per_unit: Option<f64>) -> Result<Alignment, WebError> {
    let mut options = AlignmentOptions::default();
    if let Some(metres) = metres_per_unit {
        let wrong = |e: UnitError| WebError::Option { name: "metresPerUnit", reason: e.to_string() };
        options = options.with_metres_per_unit(check_unit(metres).map_err(wrong)?);
    }
    Ok(Alignment::new(options))
}

/// Takes an answer, JSON.
///
/// # Errors
/// [`WebError`] for a pose that is no rotation, and for bytes that are no answer; nothing has changed.
pub fn add(alignment: &mut Alignment, pose: Pose, answer: &[u8]) -> Result<Vec<u8>, WebError> {
    let answer = answer_of(answer)?;
    let update = alignment.add(&answer, &camera(pose)?);
    let (aligned, ratio) = (alignment.aligned(), alignment.distance_ratio());
    let reply = AddReply {
        update: update.name(),
        state: alignment.state().name(),
        used: aligned.map_or(0, |aligned| aligned.used),
        contradicting: aligned.map_or(0, |aligned| aligned.contradicting),
        distances: ratio.map_or("unknown", |ratio| ratio.verdict().name()),
        distance_ratio: ratio.map(|ratio| ratio.median),
    };
    Ok(message::write(&reply, &[]))
}

/// Takes the pose of the camera between answers.
///
/// # Errors
/// [`WebError::Pose`].
pub fn moved(alignment: &mut Alignment, pose: Pose) -> Result<(), WebError> {
    alignment.moved(&camera(pose)?);
    Ok(())
}

/// The pose in the AR world of content in the map.
///
/// # Errors
/// [`WebError::Pose`].
pub fn world_from_anchor(alignment: &Alignment, anchor: Pose) -> Result<Vec<u8>, WebError> {
    let pose = match alignment.aligned() {
        Some(_) => Some(alignment.world_from_anchor(Axes::OpenGl, &anchor.into()).ok_or(WebError::Pose)?),
        None => None,
    };
    Ok(message::write(&PoseReply { pose: pose.map(Pose::from) }, &[]))
}

/// Where the camera is in the map, with COLMAP's axes of the camera.
///
/// # Errors
/// [`WebError::Pose`].
pub fn camera_in_map(alignment: &Alignment, pose: Pose) -> Result<Vec<u8>, WebError> {
    let cam_from_ar = camera(pose)?;
    let pose = alignment.cam_from_map(&cam_from_ar).map(|cam_from_map| {
        let map_from_cam = cam_from_map.inverse();
        let [w, x, y, z] = map_from_cam.quaternion();
        Pose { position: (*map_from_cam.translation()).into(), orientation: [x, y, z, w] }
    });
    let accuracy = alignment
        .accuracy(&cam_from_ar)
        .map(|Accuracy { horizontal, vertical, yaw_deg }| AccuracyReply { horizontal, vertical, yaw_deg });
    Ok(message::write(&CameraReply { pose, accuracy }, &[]))
}

fn camera(pose: Pose) -> Result<CameraFromAr, WebError> {
    Axes::OpenGl.cam_from_ar(&pose.into()).ok_or(WebError::Pose)
}
