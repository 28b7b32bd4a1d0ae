//! Several consecutive images localized together, with odometry simulated from their true poses.
//!
//! Every query of the list is the newest image of a sequence with the images before it. Sequences of different
//! lengths are evaluated on the same queries, so that their figures can be compared: queries whose trajectory is too
//! short for the longest sequence are left out.

use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::Progress;
use veiloc_geometry::CameraFromWorld;
use veiloc_localization::localize_rig;
use veiloc_map::MapFile;
use veiloc_obfuscation::Extracted;
use veiloc_pose::ScoreKind;
use veiloc_protocol::{Scheme, SealedFrame, SealedQuery};

use super::case::{Case, Maps};
use super::condition::Condition;
use super::each;
use super::one_query::{extracted, sealer_of};
use super::options::SceneEvaluation;
use super::sequence::{odometry, sequence_of};
use crate::error::EvalError;
use crate::pipeline::{EvaluatedQuery, PosedQuery, seal_query};
use crate::results::{QueryResult, QueryUncertainty};

/// The queries of a scene in the order in which they were taken, and those that have enough others before or after
/// them.
pub(super) struct Sequences {
    queries: Vec<PosedQuery>,
    poses: Vec<CameraFromWorld>,
    newest: Vec<usize>,
}

impl Sequences {
    /// The sequences of the conditions; refused if no trajectory is long enough for the longest.
    pub(super) fn of(evaluation: &SceneEvaluation) -> Result<Self, EvalError> {
        let queries = evaluation.queries()?;
        let poses: Vec<CameraFromWorld> = queries.iter().map(|query| query.cam_from_world).collect();
        let lengths = evaluation.conditions.iter().filter_map(|condition| condition.frames);
        let longest = lengths.max().map_or(0, |frames| frames.get());
        let distance = evaluation.odometry.max_distance;
        let is_long = |newest: &usize| sequence_of(&poses, *newest, longest, distance).is_some();
        let newest: Vec<usize> = (0..queries.len()).filter(is_long).collect();
        if longest > 0 && newest.is_empty() {
            return Err(EvalError::DataSet(format!(
                "no {longest} queries of the list follow each other within {distance} map units; list them in the \
                 order in which they were taken, or use shorter sequences"
            )));
        }
        Ok(Self { queries, poses, newest })
    }

    /// The results of every newest query under conditions that differ in the number of images only,
    /// `[queries][conditions][schemes]`.
    pub(super) fn localize(
        &self,
        maps: &Maps<'_>,
        cases: &[&Case],
        evaluation: &SceneEvaluation,
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<Vec<QueryResult>>>, EvalError> {
        let sealed = each(evaluation.jobs, &self.queries, |query| seal(maps, query, cases[0], evaluation))?;
        progress.start("Localizing images together", self.newest.len());
        let map = maps.under(&cases[0].condition).whole();
        let results = each(evaluation.jobs, &self.newest, |newest| {
            let of_case = |case: &&Case| {
                let frames = case.condition.frames.map_or(1, |frames| frames.get());
                let distance = evaluation.odometry.max_distance;
                let images = sequence_of(&self.poses, *newest, frames, distance).unwrap_or_default();
                let schemes = evaluation.schemes.iter().enumerate();
                let rows = schemes.map(|(at, scheme)| {
                    let own: Vec<_> = images.iter().map(|&i| (&self.queries[i], &sealed[i][at])).collect();
                    localize_sequence(&own, map, &case.condition, *scheme, evaluation)
                });
                rows.collect()
            };
            progress.advance(1);
            Ok(cases.iter().map(of_case).collect())
        })?;
        progress.finish();
        Ok(results)
    }
}

/// A query sealed under every scheme.
fn seal(
    maps: &Maps<'_>,
    query: &PosedQuery,
    case: &Case,
    evaluation: &SceneEvaluation,
) -> Result<Vec<Result<SealedQuery, String>>, EvalError> {
    let served = maps.under(&case.condition);
    let profile = served.whole().profile();
    let mask = evaluation.mask_of(&query.name);
    let shown = EvaluatedQuery::from(query.clone());
    let shown = extracted(&shown, case.condition.image, mask.as_deref(), profile, evaluation)?;
    // One device took all images, so the error of its camera is the same for all.
    let camera = case.assumed_camera(&shown.camera, "the device", evaluation.seed)?;
    let sealed = |scheme: &Scheme| {
        let extracted = Extracted::new(shown.features.clone(), camera);
        let sent = sealer_of(served, case, *scheme, evaluation)
            .and_then(|sealer| seal_query(&sealer, extracted, &query.name, evaluation.seed));
        SealedQuery::decode(&sent.map_err(|e| e.to_string())?.bytes).map_err(|e| e.to_string())
    };
    Ok(evaluation.schemes.iter().map(sealed).collect())
}

/// Localizes one sequence, whose last image is the newest: returns the error of that image's pose.
fn localize_sequence(
    images: &[(&PosedQuery, &Result<SealedQuery, String>)],
    map: &MapFile,
    condition: &Condition,
    scheme: Scheme,
    evaluation: &SceneEvaluation,
) -> QueryResult {
    let newest = images[images.len() - 1].0;
    let mut result = QueryResult::unsolved(&newest.name, scheme, ScoreKind::default());
    result.condition = condition.name();
    result.seed = evaluation.seed;
    result.variant = evaluation.estimators[0].variant();
    let truth: Vec<CameraFromWorld> = images.iter().map(|(query, _)| query.cam_from_world).collect();
    // All schemes and conditions get the same odometry.
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(evaluation.seed, &[&newest.name, "odometry"]));
    let sd = [evaluation.odometry.rotation_sd_deg, evaluation.odometry.translation_sd];
    let mut frames = Vec::with_capacity(images.len());
    for ((_, sealed), step) in images.iter().zip(odometry(&truth, sd, &mut rng)) {
        // Images that cannot be sealed are skipped; the others still determine the pose of the newest image.
        match sealed {
            Ok(query) => frames.push(SealedFrame {
                query: query.clone(),
                cam_from_rig: step.cam_from_rig,
                rotation_sd_deg: step.rotation_sd_deg,
                translation_sd: step.translation_sd,
            }),
            Err(error) => result.failure = Some(error.clone()),
        }
    }
    if frames.is_empty() {
        return result;
    }
    result.failure = None;
    let started = Instant::now();
    match localize_rig(&frames, map, evaluation.localize()) {
        Ok(found) => {
            // The rig's frame is the newest image's camera.
            let rig = &found.rig_from_world;
            let estimate = &CameraFromWorld::new(*rig.rotation(), *rig.translation());
            let truth = &newest.cam_from_world;
            result = result.found(estimate, truth);
            result.uncertainty = Some(QueryUncertainty::of(estimate, &found.covariance, truth));
            result.inliers = found.frames.iter().map(|f| f.inlier_pairs).sum();
            result.correspondences = found.frames.iter().map(|f| f.pairs).sum();
            result.hypotheses = found.hypotheses;
            result = result.judged(found.state, &found.confidence);
            result.ms.insert("retrieve".to_owned(), found.times.retrieve_ms);
            result.ms.insert("match".to_owned(), found.times.match_ms);
            result.ms.insert("pose".to_owned(), found.times.pose_ms);
        }
        Err(error) => {
            result = result.because(&error);
            result.ms.insert("pose".to_owned(), started.elapsed().as_secs_f64() * 1e3);
        }
    }
    result
}
