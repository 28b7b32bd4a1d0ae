//! `veiloc eval sessions`: leakage of several frames of one scene, by the reference frame of their anchors.
//!
//! The images of the query list are the frames of one trajectory. A device seals all of them in one
//! [`veiloc_obfuscation::Session`]; a server localizes each from its sealed bytes, and attacks some of them with
//! other frames of the trajectory:
//!
//! - **turning**: with the most informative frames of the whole trajectory
//!   ([`veiloc_attacks::multi_view::select_frames`]);
//! - **walking**: with the frames before it;
//! - **resting**: with frames of the same image with new sensor noise, in a session of their own;
//! - **visiting**: as turning, but every frame has a session of its own, like frames of several users.
//!
//! Poses are estimated by the server, matches are by descriptors, and the attack reads sealed bytes only; the ground
//! truth is used to measure errors. The attacked keypoints are a person-like region without map points, and the
//! keypoints that the map knows, with their positions withheld.

mod attack;
mod device;
mod document;
mod frames;
mod localized_frame;
mod motion;
mod table;

use crate::EvalError;
use crate::pipeline::{GravityNoise, PosedQuery, SceneMap, SimulatedGravity};
use crate::results::{QueryResult, summarize};
use crate::{SceneEvaluation, sequence_of};
use rayon::prelude::*;
use veiloc_features::Progress;
use veiloc_geometry::CameraFromWorld;
use veiloc_obfuscation::{SessionAnchors, SessionOptions};
use veiloc_protocol::Scheme;

use crate::attack_evaluation::spread::spread;
use attack::{AttackErrors, attack};
use device::{Gyroscope, Sealed, sealed_in_session};
use frames::{DeviceFrame, device_frame, stationary_frames};
use localized_frame::LocalizedFrame;

pub use document::{FramesFigures, SessionRow, SessionsDocument};
pub use motion::{Motion, MotionError};
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

    /// Orientation errors that matter for these anchors: none if no orientation is used.
    fn errors_of(&self, anchors: SessionAnchors) -> Vec<Gyroscope> {
        let all = self.gyro_deg.iter().flat_map(|gyro_deg| {
            self.drift_deg.iter().map(|drift_deg| Gyroscope { gyro_deg: *gyro_deg, drift_deg: *drift_deg })
        });
        if anchors == SessionAnchors::Image { vec![Gyroscope::EXACT] } else { all.collect() }
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
    let scene = &evaluation.scene;
    let queries = scene.queries()?;
    let poses: Vec<CameraFromWorld> = queries.iter().map(|q| q.cam_from_world).collect();
    let attacked = attacked(evaluation, &poses)?;
    let gravity_source = SimulatedGravity::of(&scene.posed, &scene.map_list, SESSION_SENSOR)?;
    let input = scene.map_input(&scene.map_list);
    let SceneMap { file: map, summary, .. } =
        &SceneMap::build(&input, &scene.build, true, scene.keep_map.as_deref(), None, progress)?;
    progress.start("Extracting queries", queries.len());
    let mut trajectory: Vec<DeviceFrame> = Vec::with_capacity(queries.len());
    for query in &queries {
        trajectory.push(device_frame(query, map, evaluation.private, scene.seed)?);
        progress.advance(1);
    }
    progress.finish();
    let longest = evaluation.frames.iter().copied().max().unwrap_or(2);
    let mut resting: Vec<Vec<DeviceFrame>> = Vec::new();
    if evaluation.motions.contains(&Motion::Resting) {
        progress.start("Extracting frames of a stationary camera", attacked.len());
        for &i in &attacked {
            resting.push(stationary_frames(
                &queries[i],
                &trajectory[i],
                longest,
                evaluation.sensor_noise,
                map,
                scene.seed,
            )?);
            progress.advance(1);
        }
        progress.finish();
    }

    let conditions: Vec<(Scheme, SessionAnchors, Gyroscope)> = scene
        .schemes
        .iter()
        .flat_map(|s| evaluation.anchors.iter().map(move |a| (*s, *a)))
        .flat_map(|(s, a)| evaluation.errors_of(a).into_iter().map(move |g| (s, a, g)))
        .collect();
    let mut document = SessionsDocument::new(evaluation, summary.clone());
    progress.start("Attacking sessions", conditions.len() * (1 + attacked.len() * evaluation.motions.len()));
    for (scheme, anchors, gyroscope) in conditions {
        let seal = |frames: &[DeviceFrame]| {
            sealed_in_session(frames, scheme, anchors, &gyroscope, evaluation, map, &gravity_source)
        };
        let localized = |sealed: &[Result<Sealed, String>],
                         shown: &[DeviceFrame],
                         of: &[&PosedQuery]|
         -> Vec<LocalizedFrame> {
            let frames = sealed.par_iter().zip(shown).zip(of);
            frames
                .map(|((sealed, shown), query)| {
                    LocalizedFrame::of(sealed.as_ref(), shown, query, scheme, map, scene.localize())
                })
                .collect()
        };
        let of_trajectory: Vec<&PosedQuery> = queries.iter().collect();
        let (sealed, starts) = seal(&trajectory);
        let localized_frames = localized(&sealed, &trajectory, &of_trajectory);
        let visits = if evaluation.motions.contains(&Motion::Visiting) {
            let alone = trajectory.iter().flat_map(|frame| seal(std::slice::from_ref(frame)).0);
            localized(&alone.collect::<Vec<_>>(), &trajectory, &of_trajectory)
        } else {
            Vec::new()
        };
        let results: Vec<QueryResult> = localized_frames.iter().map(|s| s.result.clone()).collect();
        let summary = summarize(&results.iter().collect::<Vec<_>>(), &scene.thresholds);
        document.frames.push(FramesFigures::new(anchors, &gyroscope, starts, &sealed, summary));
        progress.advance(1);
        for motion in &evaluation.motions {
            let mut rows = SessionRow::of(evaluation, scheme, anchors, *motion, &gyroscope);
            for (k, &i) in attacked.iter().enumerate() {
                let all_others = || (0..trajectory.len()).filter(|j| *j != i).collect::<Vec<_>>();
                let under = (anchors, *motion);
                let tried = match motion {
                    Motion::Resting => {
                        let (sealed, _) = seal(&resting[k]);
                        let still = localized(&sealed, &resting[k], &vec![&queries[i]; sealed.len()]);
                        attack(evaluation, under, &still, 0, &(1..still.len()).collect::<Vec<_>>())?
                    }
                    Motion::Walking => {
                        let before =
                            sequence_of(&poses, i, longest, evaluation.max_distance).unwrap_or_default();
                        // The nearest first.
                        let others: Vec<usize> = before.iter().rev().copied().filter(|j| *j != i).collect();
                        attack(evaluation, under, &localized_frames, i, &others)?
                    }
                    Motion::Turning => attack(evaluation, under, &localized_frames, i, &all_others())?,
                    Motion::Visiting => attack(evaluation, under, &visits, i, &all_others())?,
                };
                rows.iter_mut()
                    .zip(&tried)
                    .for_each(|(row, tried): (&mut SessionRow, &AttackErrors)| row.add(tried));
                progress.advance(1);
            }
            document.rows.extend(rows.into_iter().map(SessionRow::finished));
        }
    }
    progress.finish();
    Ok(document)
}

/// The attacked images: those with enough frames.
fn attacked(evaluation: &SessionsEvaluation, poses: &[CameraFromWorld]) -> Result<Vec<usize>, EvalError> {
    let longest = evaluation.frames.iter().copied().max().unwrap_or(2);
    let has_enough = |i: &usize| {
        evaluation.motions.iter().all(|motion| match motion {
            Motion::Resting => true,
            Motion::Turning | Motion::Visiting => poses.len() >= longest,
            Motion::Walking => sequence_of(poses, *i, longest, evaluation.max_distance).is_some(),
        })
    };
    let able: Vec<usize> = (0..poses.len()).filter(has_enough).collect();
    if able.is_empty() {
        return Err(EvalError::DataSet(format!(
            "no query has {longest} frames: the list has {} images, and those within {} map units of the next are a trajectory; \
             use fewer frames, a longer --max-distance, or only --motion resting",
            poses.len(),
            evaluation.max_distance
        )));
    }
    let count = evaluation.attacked.map(|n| n.max(1));
    Ok(spread(able.len(), count).into_iter().map(|k| able[k]).collect())
}
