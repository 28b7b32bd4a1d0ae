//! The sealed queries of a session and their relative poses to one pose of the device.

use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::{CameraFromWorld, RigFromWorld};
use veiloc_map::MapFile;
use veiloc_pose::{Confidence, RigFrame, State, estimate_rig_pose};
use veiloc_protocol::{Scheme, SealedFrame};

use crate::error::LocalizeError;
use crate::localizer::{LocalizeOptions, MatchedQuery, StageTimes, distinct, match_query};
use crate::verdict::{Own, Verdict};

/// Where the rig was.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RigLocalization {
    /// The pose of the rig in the map.
    pub rig_from_world: RigFromWorld,
    /// Its covariance in the chart of [`RigFromWorld::perturbed`]: radians, then map units; calibrated by the map's
    /// self-test of the first frame's scheme, as that of a single query is.
    pub covariance: [[f64; 6]; 6],
    /// Whether to trust the pose, and why not.
    pub confidence: Confidence,
    /// Whether the pose is trusted or doubted; never [`State::NotFound`], which is [`LocalizeError::NoPose`].
    pub state: State,
    /// Each frame, `[F]`, in the order given.
    pub frames: Vec<FrameLocalization>,
    /// Hypotheses drawn, of all frames together.
    pub hypotheses: usize,
    /// Time of each stage, of all frames together.
    pub times: StageTimes,
}

/// One frame of a localized rig.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct FrameLocalization {
    /// The pose of its camera: where the odometry puts it, moved as far as its matches ask and the odometry allows.
    pub cam_from_world: CameraFromWorld,
    /// Rows of the query that agree with it.
    pub inliers: usize,
    /// Rows of the query that were matched.
    pub matches: usize,
    /// Pairs of a row and a map point that agree.
    pub inlier_pairs: usize,
    /// Pairs of a row and a map point.
    pub pairs: usize,
    /// Standard deviation that the agreeing rows show, pixels; `None` where none agree.
    pub noise_px: Option<f64>,
    /// Estimated focal length over the given one, the same for all frames of one camera; 1 when it was not estimated.
    pub focal_scale: f64,
    /// How far the camera is from where the odometry puts it, in standard deviations of that.
    pub odometry_deviation: f64,
}

impl RigLocalization {
    /// Frames of which something agrees with the joint pose.
    pub fn frames_that_agree(&self) -> usize {
        self.frames.iter().filter(|frame| frame.inliers > 0).count()
    }

    /// Standard deviation that the agreeing rows of all frames show, pixels; `None` where none agree.
    pub fn noise_px(&self) -> Option<f64> {
        let shown = self.frames.iter().filter_map(|frame| Some((frame.noise_px?, frame.inlier_pairs as f64)));
        let (squares, count) =
            shown.fold((0.0, 0.0), |(s, n), (noise, pairs)| (s + noise * noise * pairs, n + pairs));
        (count > 0.0).then(|| (squares / count).sqrt())
    }

    /// [`FrameLocalization::focal_scale`] where that is one for all frames; `None` where cameras differ in it.
    pub fn focal_scale(&self) -> Option<f64> {
        let first = self.frames.first()?.focal_scale;
        self.frames.iter().all(|frame| frame.focal_scale == first).then_some(first)
    }
}

/// Estimates where the device was from all sealed queries of a session.
///
/// # Errors
/// [`LocalizeError`]: a query was sealed for another map (told by [`LocalizeError::Frame`]), the map is empty, or no pose is
/// supported by the matches of all frames together.
pub fn localize_rig(
    frames: &[SealedFrame],
    map: &MapFile,
    options: &LocalizeOptions,
) -> Result<RigLocalization, LocalizeError> {
    let mut asked: Vec<MatchedQuery> = Vec::with_capacity(frames.len());
    for (frame, sealed) in frames.iter().enumerate() {
        asked.push(match_query(&sealed.query, map, options).map_err(|source| match source {
            LocalizeError::EmptyMap => LocalizeError::EmptyMap,
            LocalizeError::Stopped => LocalizeError::Stopped,
            source => LocalizeError::Frame { frame, source: Box::new(source) },
        })?);
    }
    // Of one device: told once, not by every frame.
    for later in asked.iter_mut().skip(1) {
        later.problem.position = None;
    }
    let matched_at = Instant::now();
    let correspondences = asked.iter().map(|a| a.problem.points.len()).sum();
    let rig: Vec<RigFrame> = frames
        .iter()
        .zip(&asked)
        .map(|(sealed, asked)| RigFrame {
            problem: asked.problem.clone(),
            cam_from_rig: sealed.cam_from_rig,
            rotation_sd_deg: sealed.rotation_sd_deg,
            translation_sd: sealed.translation_sd,
        })
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let estimate = estimate_rig_pose(&rig, &options.pose, &mut rng)
        .map_err(|source| LocalizeError::of_pose(source, correspondences))?;
    let own = Own {
        covariance: &estimate.covariance,
        by_matches: &estimate.covariance_by_matches,
        confidence: estimate.confidence,
    };
    let scheme = frames.first().map_or_else(Scheme::default, |frame| frame.query.scheme());
    let Verdict { covariance, confidence, state } = own.in_map(map, scheme, correspondences)?;
    let told = estimate.frames.iter().zip(&asked).map(|(found, asked)| FrameLocalization {
        cam_from_world: found.cam_from_world,
        inliers: found.inlier_keypoints,
        matches: distinct(asked.rows.iter().copied()),
        inlier_pairs: pairs_among(asked, &found.inliers),
        pairs: asked.rows.len(),
        noise_px: found.noise_px,
        focal_scale: found.focal_scale,
        odometry_deviation: found.odometry_deviation,
    });
    Ok(RigLocalization {
        rig_from_world: estimate.rig_from_world,
        covariance,
        confidence,
        state,
        frames: told.collect(),
        hypotheses: estimate.hypotheses,
        times: StageTimes {
            retrieve_ms: asked.iter().map(|a| a.retrieve_ms).sum(),
            match_ms: asked.iter().map(|a| a.match_ms).sum(),
            pose_ms: matched_at.elapsed().as_secs_f64() * 1e3,
        },
    })
}

/// Pairs of a row and a map point among these correspondences.
fn pairs_among(asked: &MatchedQuery, inliers: &[bool]) -> usize {
    distinct(asked.match_of.iter().zip(inliers).filter_map(|(m, agrees)| agrees.then_some(*m)))
}
