//! `veiloc eval sessions`: leakage of several frames of one scene, by the reference frame of their anchors.
//!
//! The images of the query list are the frames of one trajectory. A device seals all of them in one
//! [`veiloc_obfuscation::Session`]; a server localizes each from its sealed bytes, and attacks some of them with
//! other frames of the trajectory:
//!
//! - **turning**: with the most informative frames of the whole trajectory
//!   ([`veiloc_attacks::multi_view::select_frames`]);
//! - **walking**: with the frames before it;
//! - **static**: with frames of the same image with new sensor noise, in a session of their own;
//! - **visiting**: as turning, but every frame has a session of its own, like frames of several users.
//!
//! Poses are estimated by the server, matches are by descriptors, and the attack reads sealed bytes only; the ground
//! truth is used to measure errors. The attacked keypoints are a person-like region without map points, and the
//! keypoints that the map knows, with their positions withheld.

mod attack;
mod device;
mod document;
mod localized_frame;
mod motion;
mod recording;
mod table;

use serde::{Serialize, Serializer};
use veiloc_features::Progress;
use veiloc_obfuscation::{PackUse, SessionAnchors, SessionOptions};
use veiloc_protocol::Scheme;

use crate::pipeline::GravityNoise;
use crate::results::{QueryResult, summarize};
use crate::{EvalError, SceneEvaluation};
use device::SealedSession;
use localized_frame::LocalizedFrame;
use recording::Recording;

pub use attack::{AttackedKeypoints, Method};
pub use document::{FramesFigures, SessionRow, SessionsDocument};
pub use motion::Motion;
pub use table::table;

/// The accelerometer of the devices.
const SESSION_SENSOR: GravityNoise = GravityNoise { sd_deg: 1.0, wrong_by_deg: 0.0 };

/// Inputs and options.
#[derive(Debug, Clone)]
pub struct SessionsEvaluation {
    /// The scene, its schemes, and localization; the queries in the order in which they were taken.
    pub scene: SceneEvaluation,
    /// Reference frames of anchors.
    pub anchors: Vec<SessionAnchors>,
    /// How the frames of an attack are chosen.
    pub motions: Vec<Motion>,
    /// Numbers of frames of an attack, including the attacked one.
    pub frames: Vec<usize>,
    /// Standard deviations of each orientation's error about each axis, degrees.
    pub gyro_deg: Vec<f64>,
    /// Standard deviations of the orientation's drift about each axis from one frame to the next, degrees.
    pub drift_deg: Vec<f64>,
    /// Number of attacked images, spread evenly over those with enough frames; `None` for all.
    pub attacked: Option<usize>,
    /// Share of an image's keypoints in the person-like region.
    pub private: f64,
    /// Images farther apart than this belong to different trajectories, map units.
    pub max_distance: f64,
    /// Standard deviation of the sensor noise in frames of a stationary camera, gray levels of 255.
    pub sensor_noise: f64,
    /// Options of sessions, except the anchors.
    pub session: SessionOptions,
    /// What the device sends with the pack of the map; `None`: all keypoints with their descriptors. Keypoints of the
    /// person-like region are sent as far as the place explains them.
    pub pack: Option<PackUse>,
}

impl SessionsEvaluation {
    fn check(&self) -> Result<(), EvalError> {
        let refuse = |what: String| Err(EvalError::Options(what));
        if self.anchors.is_empty()
            || self.motions.is_empty()
            || self.gyro_deg.is_empty()
            || self.drift_deg.is_empty()
        {
            return refuse("nothing to evaluate: give anchors, motions and gyroscope errors".to_owned());
        }
        if let Some(n) = self.frames.iter().find(|n| **n < 2) {
            return refuse(format!("an attack on several frames needs at least two, not {n}"));
        }
        if !(self.private > 0.0 && self.private < 1.0) {
            return refuse(format!("a private region cannot hold {} of the keypoints", self.private));
        }
        let numbers =
            self.gyro_deg.iter().chain(&self.drift_deg).chain([&self.max_distance, &self.sensor_noise]);
        if let Some(x) = numbers.into_iter().find(|x| !(x.is_finite() && **x >= 0.0)) {
            return refuse(format!("{x} is not a standard deviation or distance: it must not be below 0"));
        }
        if let Some(scheme) = self.scene.schemes.iter().find(|s| !s.hides_positions()) {
            return refuse(format!("{scheme} hides no position, so there is nothing to attack"));
        }
        Ok(())
    }

    /// Schemes, anchors and orientation errors; anchors in the image use no orientation.
    fn conditions(&self) -> Vec<Condition> {
        let mut conditions = Vec::new();
        for &scheme in &self.scene.schemes {
            for &anchors in &self.anchors {
                let exact: &[f64] = &[0.0];
                let is_used = anchors != SessionAnchors::Image;
                for &gyro_deg in if is_used { &self.gyro_deg } else { exact } {
                    for &drift_deg in if is_used { &self.drift_deg } else { exact } {
                        conditions.push(Condition { scheme, anchors, gyro_deg, drift_deg });
                    }
                }
            }
        }
        conditions
    }

    /// Number of frames of the largest attack.
    fn longest(&self) -> usize {
        self.frames.iter().copied().max().unwrap_or(2)
    }
}

/// Scheme, anchors and errors of orientations under which frames are sealed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Condition {
    #[serde(skip)]
    scheme: Scheme,
    /// Reference of the anchors: `image`, `world` or `gravity`.
    #[serde(serialize_with = "as_text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub anchors: SessionAnchors,
    /// Standard deviation of each orientation's error about each axis, degrees.
    pub gyro_deg: f64,
    /// Standard deviation of the orientation's drift from one frame to the next, degrees.
    pub drift_deg: f64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "the signature that serde calls")]
fn as_text<S: Serializer>(anchors: &SessionAnchors, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(anchors)
}

/// The frames of the trajectory under one condition, localized.
struct Sessions<'a> {
    recording: &'a Recording<'a>,
    condition: Condition,
    trajectory: SealedSession,
    /// All of one session.
    frames: Vec<LocalizedFrame>,
    /// Each of its own session; empty if no attack combines them.
    visits: Vec<LocalizedFrame>,
}

impl<'a> Sessions<'a> {
    fn new(recording: &'a Recording<'a>, condition: Condition) -> Self {
        let shown = &recording.trajectory;
        let trajectory = recording.seal(shown, &condition);
        let frames = recording.localize(&trajectory.frames, shown, condition.scheme);
        let mut visits = Vec::new();
        if recording.evaluation.motions.contains(&Motion::Visiting) {
            let seal = |frame| recording.seal(std::slice::from_ref(frame), &condition).frames;
            let alone: Vec<_> = shown.iter().flat_map(seal).collect();
            visits = recording.localize(&alone, shown, condition.scheme);
        }
        Self { recording, condition, trajectory, frames, visits }
    }

    /// Pose results of the single frames.
    fn figures(&self) -> FramesFigures {
        let results: Vec<&QueryResult> = self.frames.iter().map(|frame| &frame.result).collect();
        let summary = summarize(&results, &self.recording.evaluation.scene.thresholds);
        FramesFigures::new(self.condition, &self.trajectory, summary)
    }

    /// Attacks each image with frames of this motion: one row for each target, method and number of frames.
    fn rows(&self, motion: Motion, progress: &dyn Progress) -> Result<Vec<SessionRow>, EvalError> {
        let mut rows = SessionRow::of(&self.recording.evaluation.frames, self.condition, motion);
        for index in 0..self.recording.attacked.len() {
            self.attack(motion, index, &mut rows)?;
            progress.advance(1);
        }
        Ok(rows.into_iter().map(SessionRow::finished).collect())
    }
}

/// Builds the map, seals the queries in sessions, localizes every frame and attacks some.
///
/// # Errors
/// [`EvalError`] when data is missing, the map cannot be built, or there are too few frames. A frame that is not
/// localized is a result.
pub fn evaluate_sessions(
    evaluation: &SessionsEvaluation,
    progress: &dyn Progress,
) -> Result<SessionsDocument, EvalError> {
    evaluation.check()?;
    let recording = Recording::new(evaluation, progress)?;
    let conditions = evaluation.conditions();
    let mut document = SessionsDocument::new(evaluation, recording.map.summary.clone());
    let steps = 1 + recording.attacked.len() * evaluation.motions.len();
    progress.start("Attacking sessions", conditions.len() * steps);
    for condition in conditions {
        let sessions = Sessions::new(&recording, condition);
        document.frames.push(sessions.figures());
        progress.advance(1);
        for motion in &evaluation.motions {
            document.rows.extend(sessions.rows(*motion, progress)?);
        }
    }
    progress.finish();
    Ok(document)
}
