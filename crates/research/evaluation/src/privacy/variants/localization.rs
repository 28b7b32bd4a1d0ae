//! The judge of localization: the pose that the engine finds from what one image sends.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_pose::{PoseOptions, estimate_pose};

use super::data::Query;
use super::sent::Sent;
use crate::pose::pose_problem;
use crate::results::QueryResult;
use veiloc_datasets::problem_files::Problem;
use veiloc_datasets::problem_files::seed_for;

/// Estimates the pose from the matches whose keypoints were sent.
pub(super) fn localize(
    query: &Query,
    sent: &Sent,
    use_prior: bool,
    options: &PoseOptions,
    seed: u64,
) -> QueryResult {
    let problem = matches_sent(query, &sent.kept);
    let (pose_problem, _) = pose_problem(&problem, &sent.observed, use_prior);
    let blank = QueryResult::unsolved(&problem.name, sent.scheme, options.score.unwrap_or_default());
    let mut result = QueryResult { seed, correspondences: pose_problem.points.len(), ..blank };
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &[&problem.name, "pose"]));
    match estimate_pose(&pose_problem, options, &mut rng) {
        Ok(estimate) => {
            result = result.found(&estimate.cam_from_world, &problem.cam_from_world);
            result.inliers = estimate.inlier_count;
            result.hypotheses = estimate.hypotheses;
            result.trusted = Some(estimate.confidence.is_trusted());
            result
        }
        Err(error) => result.because(&error),
    }
}

/// The problem as it is when only these keypoints of the image are sent, its matches named by their row.
///
/// A match is there when a keypoint at its position was sent: one of several orientations is enough.
fn matches_sent(query: &Query, kept: &[usize]) -> Problem {
    let all = &query.problem;
    let row_of: Vec<Option<usize>> =
        query.rows_of.iter().map(|rows| rows.iter().find_map(|row| kept.binary_search(row).ok())).collect();
    let there: Vec<usize> =
        (0..all.points.len()).filter(|m| row_of[all.keypoint_of_match[*m]].is_some()).collect();
    let counts = |of: &Option<Vec<u32>>| of.as_ref().map(|v| there.iter().map(|m| v[*m]).collect());
    Problem {
        keypoints: kept.iter().map(|row| query.image.keypoints[*row]).collect(),
        keypoint_of_match: there.iter().filter_map(|m| row_of[all.keypoint_of_match[*m]]).collect(),
        points: there.iter().map(|m| all.points[*m]).collect(),
        ratio: all.ratio.as_ref().map(|v| there.iter().map(|m| v[*m]).collect()),
        votes: counts(&all.votes),
        track_length: counts(&all.track_length),
        seen_from: all.seen_from.as_ref().map(|v| there.iter().map(|m| v[*m]).collect()),
        gravity: None,
        ..all.clone()
    }
}
