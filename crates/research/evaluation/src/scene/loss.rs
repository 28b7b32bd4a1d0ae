//! The stage of the pipeline in which a query was lost.

use std::collections::BTreeSet;

use veiloc_geometry::CameraFromWorld;
use veiloc_localization::{LocalizeOptions, MatchedQuery, match_query};
use veiloc_map::MapFile;
use veiloc_pose::optimize_pose;
use veiloc_protocol::SealedQuery;

use crate::pipeline::SealedBytes;
use crate::pose::true_matches;
use crate::results::LossStage;
use crate::results::metrics::{PoseErrors, Threshold};

/// Fewer keypoints with a true match than this hardly hold a pose: the search asks for ten agreeing ones.
const MIN_TRUE_KEYPOINTS: usize = 15;

/// A match is true within this distance of its keypoint under the true pose, pixels.
const TRUE_RADIUS_PX: f64 = 6.0;

impl LossStage {
    /// The stage in which a query was lost whose pose is within no threshold; `None` when it could not be sealed or
    /// decoded.
    ///
    /// Matches with more images than were retrieved tell retrieval from matching, and the estimator's own optimum near
    /// the true pose tells the search from the objective.
    pub(super) fn of(
        sent: &SealedBytes,
        truth: &CameraFromWorld,
        map: &MapFile,
        options: &LocalizeOptions,
        thresholds: &[Threshold],
    ) -> Option<Self> {
        let query = SealedQuery::decode(&sent.bytes).ok()?;
        let matched = |retrieve: usize| {
            let mut options = options.clone();
            options.retrieve = retrieve;
            match_query(&query, map, &options).ok()
        };
        let true_keypoints = |matched: &MatchedQuery| {
            let problem = &matched.problem;
            let is_true = true_matches(problem, truth, &sent.truth.pixels, TRUE_RADIUS_PX);
            let keypoints = problem.keypoints.iter().zip(is_true).filter_map(|(k, is)| is.then_some(*k));
            keypoints.collect::<BTreeSet<usize>>().len()
        };
        let of_retrieved = matched(options.retrieve)?;
        if true_keypoints(&of_retrieved) < MIN_TRUE_KEYPOINTS {
            let of_all = matched(map.image_count())?;
            let is_held = true_keypoints(&of_all) >= MIN_TRUE_KEYPOINTS;
            return Some(if is_held { Self::Retrieval } else { Self::Matching });
        }
        let optimum = optimize_pose(&of_retrieved.problem, truth, &options.pose);
        let is_right = optimum.is_ok_and(|found| {
            let error = PoseErrors::of(&found.cam_from_world, truth);
            thresholds.iter().any(|threshold| error.within(threshold))
        });
        Some(if is_right { Self::Search } else { Self::Objective })
    }
}
