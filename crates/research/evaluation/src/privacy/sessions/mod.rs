//! `veiloc eval sessions`: what several frames of one place give away, by what their anchors are tied to.
//!
//! Every image of the query list is a frame of one walk. A device seals all of them in one session of
//! [`veiloc_obfuscation::Session`]; a server localizes each from its sealed bytes, and attacks some of them with others
//! of the walk:
//!
//! - **turning**: with those frames of the whole walk that tell most about it ([`veiloc_attacks::multi_view::select_frames`]);
//! - **walking**: with the frames before it;
//! - **resting**: with frames of the same image and new noise of the sensor, a session of their own;
//! - **visiting**: as turning, where every frame is a session of its own, as those of several users are.
//!
//! Poses are the server's own, matches are by descriptors, and nothing but sealed bytes is read; truth judges alone.
//! Attacked are a region like a person, of which the server knows no map point, and the keypoints that the map knows, as
//! if it did not.

mod attack;
mod device;
mod document;
mod frames;
mod motion;
mod seen;
mod table;

use crate::EvalError;
use crate::results::{QueryResult, summarize};
use crate::road::{PlaceMap, PosedQuery, Upright, queries_of_place};
use crate::{SceneEvaluation, walk_of};
use rayon::prelude::*;
use veiloc_features::Progress;
use veiloc_geometry::CameraFromWorld;
use veiloc_mapping::Input;
use veiloc_obfuscation::{SessionAnchors, SessionOptions};
use veiloc_protocol::Scheme;

use crate::privacy::spread::spread;
use attack::{Attacked, attack};
use device::{Gyroscope, Sealed, sealed_in_session};
use frames::{Shown, rested, shown};
use seen::Seen;

pub use document::{FramesFigures, SessionRow, SessionsDocument};
pub use motion::{Motion, MotionError};
pub use table::table;

/// What to evaluate.
#[derive(Debug, Clone)]
pub struct SessionsEvaluation {
    /// The place, its schemes, and how queries are localized; the queries in the order in which they were taken.
    pub place: SceneEvaluation,
    /// What anchors are tied to.
    pub anchors: Vec<SessionAnchors>,
    /// How the frames that are put together were chosen.
    pub motions: Vec<Motion>,
    /// How many frames are put together, the attacked one included.
    pub frames: Vec<usize>,
    /// Standard deviations by which each orientation errs about each axis, degrees.
    pub gyro_deg: Vec<f64>,
    /// Standard deviations by which the orientation drifts about each axis from a frame to the next, degrees.
    pub drift_deg: Vec<f64>,
    /// How many images are attacked, spread evenly over those that have frames enough; `None` for all.
    pub attacked: Option<usize>,
    /// Share of an image's keypoints that the region like a person holds.
    pub private: f64,
    /// Images farther apart than this are not of one walk, map units.
    pub reach: f64,
    /// Standard deviation of the sensor's noise in frames of a camera at rest, grey levels of 255.
    pub sensor_noise: f64,
    /// How sessions are set up, but for the anchors.
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
            return refuse(
                "nothing to evaluate: name anchors, motions and errors of the gyroscope".to_owned(),
            );
        }
        if let Some(n) = self.frames.iter().find(|n| **n < 2) {
            return refuse(format!("several frames are two at least, not {n}"));
        }
        if !(self.private > 0.0 && self.private < 1.0) {
            return refuse(format!("a private region cannot hold {} of the keypoints", self.private));
        }
        let numbers = self.gyro_deg.iter().chain(&self.drift_deg).chain([&self.reach, &self.sensor_noise]);
        if let Some(x) = numbers.into_iter().find(|x| !(x.is_finite() && **x >= 0.0)) {
            return refuse(format!("{x} is no standard deviation and no distance: it must not be below 0"));
        }
        if let Some(scheme) = self.place.schemes.iter().find(|s| !s.hides_positions()) {
            return refuse(format!("{scheme} hides no position, so there is nothing to attack"));
        }
        Ok(())
    }

    /// Errors of orientations that make a difference under these anchors: none where no orientation is used.
    fn errors_of(&self, anchors: SessionAnchors) -> Vec<Gyroscope> {
        let all = self.gyro_deg.iter().flat_map(|gyro_deg| {
            self.drift_deg.iter().map(|drift_deg| Gyroscope { gyro_deg: *gyro_deg, drift_deg: *drift_deg })
        });
        if anchors == SessionAnchors::Image { vec![Gyroscope::EXACT] } else { all.collect() }
    }
}

/// Builds the map, walks the queries in sessions, localizes every frame and attacks some.
///
/// # Errors
/// [`EvalError`] when data is missing, the map cannot be built, or there are too few frames. A frame that is not
/// localized is a result.
pub fn evaluate_sessions(
    evaluation: &SessionsEvaluation,
    progress: &dyn Progress,
) -> Result<SessionsDocument, EvalError> {
    evaluation.check()?;
    let place = &evaluation.place;
    let queries = queries_of_place(
        &place.posed,
        &place.images,
        &place.map_list,
        &place.query_list,
        &place.query_cameras,
    )?;
    let poses: Vec<CameraFromWorld> = queries.iter().map(|q| q.cam_from_world).collect();
    let attacked = attacked(evaluation, &poses)?;
    let upright = Upright::of(&place.posed, &place.map_list, 1.0)?;
    let input = Input::new(&place.posed, &place.images).with_names(&place.map_list);
    let PlaceMap { file: map, summary, .. } =
        &PlaceMap::build(&input, &place.build, true, place.keep_map.as_deref(), None, progress)?;
    progress.start("Extracting queries", queries.len());
    let mut walk: Vec<Shown> = Vec::with_capacity(queries.len());
    for query in &queries {
        walk.push(shown(query, map, evaluation.private, place.seed)?);
        progress.advance(1);
    }
    progress.finish();
    let longest = evaluation.frames.iter().copied().max().unwrap_or(2);
    let mut resting: Vec<Vec<Shown>> = Vec::new();
    if evaluation.motions.contains(&Motion::Resting) {
        progress.start("Extracting frames of a camera at rest", attacked.len());
        for &i in &attacked {
            resting.push(rested(&queries[i], &walk[i], longest, evaluation.sensor_noise, map, place.seed)?);
            progress.advance(1);
        }
        progress.finish();
    }

    let conditions: Vec<(Scheme, SessionAnchors, Gyroscope)> = place
        .schemes
        .iter()
        .flat_map(|s| evaluation.anchors.iter().map(move |a| (*s, *a)))
        .flat_map(|(s, a)| evaluation.errors_of(a).into_iter().map(move |g| (s, a, g)))
        .collect();
    let mut document = SessionsDocument::new(evaluation, summary.clone());
    progress.start("Attacking sessions", conditions.len() * (1 + attacked.len() * evaluation.motions.len()));
    for (scheme, anchors, gyroscope) in conditions {
        let seal = |frames: &[Shown]| {
            sealed_in_session(frames, scheme, anchors, &gyroscope, evaluation, map, &upright)
        };
        let localized =
            |sealed: &[Result<Sealed, String>], shown: &[Shown], of: &[&PosedQuery]| -> Vec<Seen> {
                let frames = sealed.par_iter().zip(shown).zip(of);
                frames
                    .map(|((sealed, shown), query)| {
                        Seen::of(sealed.as_ref(), shown, query, scheme, map, &place.localize)
                    })
                    .collect()
            };
        let of_walk: Vec<&PosedQuery> = queries.iter().collect();
        let (sealed, starts) = seal(&walk);
        let seen = localized(&sealed, &walk, &of_walk);
        let visits = if evaluation.motions.contains(&Motion::Visiting) {
            let alone = walk.iter().flat_map(|frame| seal(std::slice::from_ref(frame)).0);
            localized(&alone.collect::<Vec<_>>(), &walk, &of_walk)
        } else {
            Vec::new()
        };
        let results: Vec<QueryResult> = seen.iter().map(|s| s.result.clone()).collect();
        let summary = summarize(&results.iter().collect::<Vec<_>>(), &place.thresholds);
        document.frames.push(FramesFigures::new(anchors, &gyroscope, starts, &sealed, summary));
        progress.advance(1);
        for motion in &evaluation.motions {
            let mut rows = SessionRow::of(evaluation, scheme, anchors, *motion, &gyroscope);
            for (k, &i) in attacked.iter().enumerate() {
                let all_others = || (0..walk.len()).filter(|j| *j != i).collect::<Vec<_>>();
                let under = (anchors, *motion);
                let tried = match motion {
                    Motion::Resting => {
                        let (sealed, _) = seal(&resting[k]);
                        let still = localized(&sealed, &resting[k], &vec![&queries[i]; sealed.len()]);
                        attack(evaluation, under, &still, 0, &(1..still.len()).collect::<Vec<_>>())?
                    }
                    Motion::Walking => {
                        let before = walk_of(&poses, i, longest, evaluation.reach).unwrap_or_default();
                        // The nearest first.
                        let others: Vec<usize> = before.iter().rev().copied().filter(|j| *j != i).collect();
                        attack(evaluation, under, &seen, i, &others)?
                    }
                    Motion::Turning => attack(evaluation, under, &seen, i, &all_others())?,
                    Motion::Visiting => attack(evaluation, under, &visits, i, &all_others())?,
                };
                rows.iter_mut()
                    .zip(&tried)
                    .for_each(|(row, tried): (&mut SessionRow, &Attacked)| row.add(tried));
                progress.advance(1);
            }
            document.rows.extend(rows.into_iter().map(SessionRow::finished));
        }
    }
    progress.finish();
    Ok(document)
}

/// Which images are attacked: those with frames enough.
fn attacked(evaluation: &SessionsEvaluation, poses: &[CameraFromWorld]) -> Result<Vec<usize>, EvalError> {
    let longest = evaluation.frames.iter().copied().max().unwrap_or(2);
    let has_enough = |i: &usize| {
        evaluation.motions.iter().all(|motion| match motion {
            Motion::Resting => true,
            Motion::Turning | Motion::Visiting => poses.len() >= longest,
            Motion::Walking => walk_of(poses, *i, longest, evaluation.reach).is_some(),
        })
    };
    let able: Vec<usize> = (0..poses.len()).filter(has_enough).collect();
    if able.is_empty() {
        return Err(EvalError::DataSet(format!(
            "no query has {longest} frames: the list has {} images, and those within {} map units of the next are a walk; \
             ask for fewer frames, a longer --reach, or --motion resting alone",
            poses.len(),
            evaluation.reach
        )));
    }
    let count = evaluation.attacked.map(|n| n.max(1));
    Ok(spread(able.len(), count).into_iter().map(|k| able[k]).collect())
}
