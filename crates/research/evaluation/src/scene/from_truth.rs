//! Estimates that start from the true pose, which only an evaluation knows: what a search loses.

use std::time::Instant;

use veiloc_geometry::CameraFromWorld;
use veiloc_localization::match_query;
use veiloc_map::MapFile;
use veiloc_pose::{PoseProblem, optimize_pose, refine_pose};
use veiloc_protocol::{Scheme, SealedQuery};

use super::options::SceneEvaluation;
use crate::pipeline::SealedBytes;
use crate::pose::true_matches;
use crate::results::{EstimatorVariant, QueryResult, QueryUncertainty};

/// Names of the two estimates, as of [`Estimator`](crate::pose::Estimator).
pub const FROM_TRUTH: [&str; 2] = ["optimum", "floor"];

/// The estimator's own optimum over all matches, which is the result of a perfect search, and the floor: least squares
/// on the true matches, those within `radius_px` of their keypoint.
pub(super) fn from_truth(
    sent: Result<&SealedBytes, &dyn std::error::Error>,
    name: &str,
    truth: &CameraFromWorld,
    map: &MapFile,
    scheme: Scheme,
    evaluation: &SceneEvaluation,
    radius_px: f64,
) -> [QueryResult; 2] {
    let options = &*evaluation.with_retrieved(evaluation.localize(), name, map);
    let score = evaluation.estimators[0].score();
    let matched = sent.map_err(ToString::to_string).and_then(|sent| {
        let query = SealedQuery::decode(&sent.bytes).map_err(|error| error.to_string())?;
        let problem = match_query(&query, map, options).map_err(|error| error.to_string())?.problem;
        let is_true = true_matches(&problem, truth, &sent.truth.pixels, radius_px);
        Ok((problem, is_true))
    });
    FROM_TRUTH.map(|recipe| {
        let is_floor = recipe == FROM_TRUTH[1];
        let mut result = QueryResult::unsolved(name, scheme, score);
        let prior = options.use_prior && !is_floor;
        result.variant =
            EstimatorVariant { recipe: Some(recipe.to_owned()), prior, ..EstimatorVariant::default() };
        if is_floor {
            "least-squares".clone_into(&mut result.score);
        }
        let started = Instant::now();
        let estimate = |(problem, is_true): &(PoseProblem, Vec<bool>)| {
            if is_floor {
                refine_pose(problem, truth, is_true, &options.pose)
            } else {
                optimize_pose(problem, truth, &options.pose)
            }
        };
        match matched.as_ref().map(estimate) {
            Ok(Ok(estimate)) => {
                result = result.found(&estimate.cam_from_world, truth);
                result.uncertainty =
                    Some(QueryUncertainty::of(&estimate.cam_from_world, &estimate.covariance, truth));
                result.inliers = estimate.inlier_count;
                result.correspondences = matched.as_ref().map_or(0, |(problem, _)| problem.points.len());
            }
            Ok(Err(error)) => result = result.because(&error),
            Err(error) => result.failure = Some(error.clone()),
        }
        result.ms.insert("pose".to_owned(), started.elapsed().as_secs_f64() * 1e3);
        result
    })
}
