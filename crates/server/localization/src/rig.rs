//! Localizes a rig: the sealed queries of a session with their relative poses give one pose.

use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::{CameraFromWorld, RigFromWorld};
use veiloc_map::MapFile;
use veiloc_pose::{Confidence, RigFrame, State, estimate_rig_pose};
use veiloc_protocol::{GravityUse, Scheme, SealedFrame};

use crate::calibrated::{CalibratedEstimate, RawEstimate};
use crate::error::LocalizeError;
use crate::localizer::{LocalizeOptions, MatchedQuery, StageTimes, count_distinct, gravity_use, match_query};

/// Result of localizing a rig.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RigLocalization {
    /// The pose of the rig in the map.
    pub rig_from_world: RigFromWorld,
    /// Its covariance in the chart of [`RigFromWorld::perturbed`]: radians, then map units; calibrated by the
    /// self-test of the map for the scheme of the first frame, as for a single query.
    pub covariance: [[f64; 6]; 6],
    /// Whether to trust the pose, with the doubts.
    pub confidence: Confidence,
    /// Trusted or doubtful; never [`State::NotFound`], which is [`LocalizeError::NoPose`].
    pub state: State,
    /// Frames, `[F]`, in input order.
    pub frames: Vec<FrameLocalization>,
    /// Use of the gravity directions of the queries.
    pub gravity: GravityUse,
    /// Number of hypotheses, of all frames together.
    pub hypotheses: usize,
    /// Duration of each stage, of all frames together.
    pub times: StageTimes,
}

/// One frame of a localized rig.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct FrameLocalization {
    /// Pose of its camera: that of the odometry, corrected by the matches within the uncertainty of the odometry.
    pub cam_from_world: CameraFromWorld,
    /// Inlier rows of the query.
    pub inliers: usize,
    /// Matched rows of the query.
    pub matches: usize,
    /// Inlier pairs of a row and a map point.
    pub inlier_pairs: usize,
    /// Pairs of a row and a map point.
    pub pairs: usize,
    /// Standard deviation of inlier residuals, pixels; `None` without inliers.
    pub noise_px: Option<f64>,
    /// Estimated over given focal length, the same for all frames of one camera; 1 if it was not estimated.
    pub focal_scale: f64,
    /// Deviation from the pose of the odometry, in its standard deviations.
    pub odometry_deviation: f64,
}

impl RigLocalization {
    /// Number of frames with inliers.
    pub fn inlier_frame_count(&self) -> usize {
        self.frames.iter().filter(|frame| frame.inliers > 0).count()
    }

    /// Standard deviation of inlier residuals of all frames, pixels; `None` without inliers.
    pub fn noise_px(&self) -> Option<f64> {
        let shown = self.frames.iter().filter_map(|frame| Some((frame.noise_px?, frame.inlier_pairs as f64)));
        let (squares, count) =
            shown.fold((0.0, 0.0), |(s, n), (noise, pairs)| (s + noise * noise * pairs, n + pairs));
        (count > 0.0).then(|| (squares / count).sqrt())
    }

    /// [`FrameLocalization::focal_scale`] if it is equal for all frames; `None` otherwise.
    pub fn focal_scale(&self) -> Option<f64> {
        let first = self.frames.first()?.focal_scale;
        self.frames.iter().all(|frame| frame.focal_scale == first).then_some(first)
    }
}

/// Localizes the rig from all sealed queries of a session.
///
/// # Errors
/// [`LocalizeError`]: a query was sealed for another map ([`LocalizeError::Frame`]), the map is empty, or the matches
/// of all frames together support no pose.
pub fn localize_rig(
    frames: &[SealedFrame],
    map: &MapFile,
    options: &LocalizeOptions,
) -> Result<RigLocalization, LocalizeError> {
    let mut matched: Vec<MatchedQuery> = Vec::with_capacity(frames.len());
    for (frame, sealed) in frames.iter().enumerate() {
        matched.push(match_query(&sealed.query, map, options).map_err(|source| match source {
            LocalizeError::EmptyMap => LocalizeError::EmptyMap,
            LocalizeError::Stopped => LocalizeError::Stopped,
            source => LocalizeError::Frame { frame, source: Box::new(source) },
        })?);
    }
    // The position prior belongs to the device, so it must count once, not per frame.
    for later in matched.iter_mut().skip(1) {
        later.problem.position = None;
    }
    let matched_at = Instant::now();
    let correspondences = matched.iter().map(|a| a.problem.points.len()).sum();
    let rig: Vec<RigFrame> = frames
        .iter()
        .zip(&matched)
        .map(|(sealed, matched)| RigFrame {
            problem: matched.problem.clone(),
            cam_from_rig: sealed.cam_from_rig,
            rotation_sd_deg: sealed.rotation_sd_deg,
            translation_sd: sealed.translation_sd,
        })
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let estimate = estimate_rig_pose(&rig, &options.pose, &mut rng)
        .map_err(|source| LocalizeError::of_pose(source, correspondences))?;
    let own = RawEstimate {
        covariance: &estimate.covariance,
        by_matches: &estimate.covariance_by_matches,
        camera: &estimate.camera_covariance,
        confidence: estimate.confidence,
        gravity_test: None,
    };
    let scheme = frames.first().map_or_else(Scheme::default, |frame| frame.query.scheme());
    let CalibratedEstimate { covariance, confidence, state } =
        own.calibrate(map, scheme, correspondences, options.need)?;
    let localized_frames = estimate.frames.iter().zip(&matched).map(|(found, matched)| FrameLocalization {
        cam_from_world: found.cam_from_world,
        inliers: found.inlier_keypoints,
        matches: count_distinct(matched.rows.iter().copied()),
        inlier_pairs: inlier_pairs(matched, &found.inliers),
        pairs: matched.rows.len(),
        noise_px: found.noise_px,
        focal_scale: found.focal_scale,
        odometry_deviation: found.odometry_deviation,
    });
    Ok(RigLocalization {
        rig_from_world: estimate.rig_from_world,
        covariance,
        confidence,
        state,
        frames: localized_frames.collect(),
        gravity: gravity_use(frames.iter().map(|frame| &frame.query), map),
        hypotheses: estimate.hypotheses,
        times: StageTimes {
            retrieve_ms: matched.iter().map(|a| a.retrieve_ms).sum(),
            match_ms: matched.iter().map(|a| a.match_ms).sum(),
            pose_ms: matched_at.elapsed().as_secs_f64() * 1e3,
        },
    })
}

/// Number of distinct matches among inlier correspondences.
fn inlier_pairs(matched: &MatchedQuery, inliers: &[bool]) -> usize {
    count_distinct(matched.match_of.iter().zip(inliers).filter_map(|(m, agrees)| agrees.then_some(*m)))
}
