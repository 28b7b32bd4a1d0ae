//! `veiloc eval rig`: several consecutive images localized together, with odometry simulated from their true poses.
//!
//! Every query of the list is the newest image of a sequence with the images before it. Sequences of different
//! lengths are evaluated on the same queries, so that their figures can be compared: queries whose trajectory is too
//! short for the longest sequence are left out.

mod trajectory;

use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::{Features, Progress};
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_localization::localize_rig;
use veiloc_map::MapFile;
use veiloc_pose::ScoreKind;
use veiloc_protocol::{Scheme, SealedFrame, SealedQuery};

use crate::error::EvalError;
use crate::pipeline::{PosedQuery, SceneMap, seal_query};
use crate::results::{EstimatorVariant, EvaluationDocument, QueryResult, QueryUncertainty, summarize};
use crate::scene::{SceneEvaluation, folder_name};
use crate::stress::sparse::subsampled;
use crate::stress::{StressCondition, sealed_under, shown_under};
use trajectory::odometry;
pub use trajectory::sequence_of;

/// Inputs and options.
#[derive(Debug, Clone)]
pub struct RigEvaluation {
    /// The scene, split into map and queries; the queries in the order in which they were taken.
    pub scene: SceneEvaluation,
    /// Numbers of images of a sequence, one row of the table each.
    pub frames: Vec<usize>,
    /// Standard deviation of the odometry's rotation about each axis per step, degrees.
    pub rotation_sd_deg: f64,
    /// Standard deviation of the odometry's translation along each axis per step, map units.
    pub translation_sd: f64,
    /// Images farther apart than this belong to different trajectories, map units.
    pub max_distance: f64,
    /// Condition of all queries.
    pub stress: StressCondition,
}

impl RigEvaluation {
    fn check(&self) -> Result<(), EvalError> {
        let refuse = |what: String| Err(EvalError::Options(what));
        if self.frames.is_empty() || self.frames.contains(&0) {
            return refuse("a sequence has at least one image".to_owned());
        }
        for (what, value) in [
            ("the rotation noise", self.rotation_sd_deg),
            ("the translation noise", self.translation_sd),
            ("the maximum distance", self.max_distance),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return refuse(format!("{what} is {value}; it must not be below 0"));
            }
        }
        Ok(())
    }
}

/// Builds the map, and localizes every query under every scheme with the number of images of each row.
///
/// # Errors
/// [`EvalError`] when data is missing, no trajectory is long enough, or the map cannot be built. A sequence without a
/// pose is a result.
pub fn evaluate_rig(
    evaluation: &RigEvaluation,
    progress: &dyn Progress,
) -> Result<EvaluationDocument, EvalError> {
    evaluation.check()?;
    let scene = &evaluation.scene;
    let queries = scene.queries()?;
    let poses: Vec<CameraFromWorld> = queries.iter().map(|q| q.cam_from_world).collect();
    let longest = evaluation.frames.iter().copied().max().unwrap_or(1);
    let newest: Vec<usize> = (0..queries.len())
        .filter(|&i| sequence_of(&poses, i, longest, evaluation.max_distance).is_some())
        .collect();
    if newest.is_empty() {
        return Err(EvalError::DataSet(format!(
            "no {longest} queries of the list follow each other within {} map units; list them in the order in which \
             they were taken, or use shorter sequences",
            evaluation.max_distance
        )));
    }
    let names = match evaluation.stress {
        StressCondition::SparseMap => subsampled(&scene.map_list),
        _ => scene.map_list.clone(),
    };
    let input = scene.map_input(&names);
    let SceneMap { file: map, summary, .. } =
        &SceneMap::build(&input, &scene.build, true, scene.keep_map.as_deref(), None, progress)?;
    progress.start("Extracting queries", queries.len());
    let mut shown: Vec<(Features, Intrinsics)> = Vec::with_capacity(queries.len());
    for query in &queries {
        shown.push(shown_under(evaluation.stress, query, map, &scene.build, scene.seed)?);
        progress.advance(1);
    }
    progress.finish();
    let mut rows: Vec<Vec<QueryResult>> = Vec::new();
    progress.start("Localizing sequences", newest.len() * evaluation.frames.len() * scene.schemes.len());
    for scheme in &scene.schemes {
        let sealed: Vec<Result<SealedQuery, String>> = queries
            .iter()
            .zip(&shown)
            .map(|(query, (features, camera))| {
                let options = sealed_under(evaluation.stress, *scheme, &scene.build);
                let sent = seal_query(features, camera, map.profile(), &options, &query.name, scene.seed);
                SealedQuery::decode(&sent.map_err(|e| e.to_string())?.bytes).map_err(|e| e.to_string())
            })
            .collect();
        for &frames in &evaluation.frames {
            let row = newest.iter().map(|&i| {
                let images = sequence_of(&poses, i, frames, evaluation.max_distance).unwrap_or_default();
                let result = localize_sequence(evaluation, map, &queries, &sealed, &images, *scheme);
                progress.advance(1);
                result
            });
            rows.push(row.collect());
        }
    }
    progress.finish();
    Ok(EvaluationDocument {
        version: 1,
        command: "eval rig",
        data: vec![folder_name(&scene.images)],
        seed: scene.seed,
        prior: scene.localize().use_prior,
        fixed_hypotheses: scene.localize().pose.fixed_hypotheses,
        schemes: rows
            .iter()
            .map(|row| summarize(&row.iter().collect::<Vec<_>>(), &scene.thresholds))
            .collect(),
        queries: rows.into_iter().flatten().collect(),
        negatives: Vec::new(),
        map: Some(summary.clone()),
    })
}

/// Localizes one sequence, whose last image is the newest: returns the error of that image's pose.
fn localize_sequence(
    evaluation: &RigEvaluation,
    map: &MapFile,
    queries: &[PosedQuery],
    sealed: &[Result<SealedQuery, String>],
    images: &[usize],
    scheme: Scheme,
) -> QueryResult {
    let scene = &evaluation.scene;
    let newest = &queries[images[images.len() - 1]];
    let mut result = QueryResult::unsolved(&newest.name, scheme, ScoreKind::default());
    result.seed = scene.seed;
    result.variant = EstimatorVariant {
        recipe: Some(format!("{} frame{}", images.len(), if images.len() == 1 { "" } else { "s" })),
        prior: scene.localize().use_prior,
        fixed_hypotheses: scene.localize().pose.fixed_hypotheses,
        ..EstimatorVariant::default()
    };
    let truth: Vec<CameraFromWorld> = images.iter().map(|&i| queries[i].cam_from_world).collect();
    // All schemes get the same odometry.
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(scene.seed, &[&newest.name, "odometry"]));
    let measured = odometry(&truth, [evaluation.rotation_sd_deg, evaluation.translation_sd], &mut rng);
    let mut frames = Vec::with_capacity(images.len());
    for (&i, step) in images.iter().zip(measured) {
        // Images that cannot be sealed are skipped; the others still determine the pose of the newest image.
        let query = match &sealed[i] {
            Ok(query) => query,
            Err(error) => {
                result.failure = Some(error.clone());
                continue;
            }
        };
        frames.push(SealedFrame {
            query: query.clone(),
            cam_from_rig: step.cam_from_rig,
            rotation_sd_deg: step.rotation_sd_deg,
            translation_sd: step.translation_sd,
        });
    }
    if frames.is_empty() {
        return result;
    }
    result.failure = None;
    let started = Instant::now();
    match localize_rig(&frames, map, scene.localize()) {
        Ok(found) => {
            // The rig's frame is the newest image's camera.
            let rig = &found.rig_from_world;
            let estimate = &CameraFromWorld::new(*rig.rotation(), *rig.translation());
            result = result.found(estimate, &newest.cam_from_world);
            let truth = &newest.cam_from_world;
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
