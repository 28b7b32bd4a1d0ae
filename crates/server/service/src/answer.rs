//! Conversion of a localization result to an [`Answer`].

use veiloc_geometry::Rigid3;
use veiloc_geometry::frames::World;
use veiloc_localization::{Localization, RigLocalization, StageTimes};
use veiloc_pose::{Confidence, Doubt};
use veiloc_protocol::{Answer, AnswerDoubt, AnswerFit, AnswerPose, AnswerTimes, DoubtKind};

/// The answer for one query. `queue_ms`: time the query waited in the queue, milliseconds.
pub(crate) fn answer_of(result: &Localization, queue_ms: f64) -> Answer {
    Answer {
        fit: fit(result.noise_px, result.focal_scale, result.principal_shift_px),
        inliers: count(result.inliers),
        matches: count(result.matches),
        hypotheses: count(result.hypotheses),
        ..common_answer(
            &result.cam_from_world,
            &result.covariance,
            &result.confidence,
            &result.times,
            queue_ms,
        )
    }
}

/// The answer for a rig: the pose is the pose of the rig, and counts are sums over all frames.
pub(crate) fn answer_of_rig(result: &RigLocalization, queue_ms: f64) -> Answer {
    Answer {
        fit: result
            .noise_px()
            .zip(result.focal_scale())
            .and_then(|(noise, focal)| fit(noise, focal, [0.0; 2])),
        inliers: count(result.frames.iter().map(|f| f.inliers).sum()),
        matches: count(result.frames.iter().map(|f| f.matches).sum()),
        hypotheses: count(result.hypotheses),
        ..common_answer(
            &result.rig_from_world,
            &result.covariance,
            &result.confidence,
            &result.times,
            queue_ms,
        )
    }
}

/// The fields that both kinds of answers share; `fit` and the counts are left at their defaults.
fn common_answer<Frame>(
    pose: &Rigid3<Frame, World>,
    covariance: &[[f64; 6]; 6],
    confidence: &Confidence,
    times: &StageTimes,
    queue_ms: f64,
) -> Answer {
    let doubts = confidence.doubts();
    Answer {
        pose: Some(AnswerPose {
            rotation: pose.quaternion(),
            translation: (*pose.translation()).into(),
            center: pose.center().coords.into(),
            covariance: *covariance,
            center_covariance: pose.center_covariance(covariance),
        }),
        trusted: doubts.is_empty(),
        doubts: doubts.iter().map(|d| AnswerDoubt { kind: kind_of(d), text: d.to_string() }).collect(),
        log_evidence: confidence.log_evidence,
        margin: confidence.margin,
        fit: None,
        inliers: 0,
        matches: 0,
        hypotheses: 0,
        times: AnswerTimes {
            queue_ms,
            retrieve_ms: times.retrieve_ms,
            match_ms: times.match_ms,
            pose_ms: times.pose_ms,
        },
    }
}

fn count(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

/// `None` when noise or focal scale could not be estimated.
fn fit(noise_px: f64, focal_scale: f64, principal_shift_px: [f64; 2]) -> Option<AnswerFit> {
    let is_known = [noise_px, focal_scale].iter().all(|value| value.is_finite() && *value > 0.0);
    is_known.then_some(AnswerFit { noise_px, focal_scale, principal_shift_px })
}

const fn kind_of(doubt: &Doubt) -> DoubtKind {
    match doubt {
        Doubt::WeakEvidence { .. } => DoubtKind::WeakEvidence,
        Doubt::Ambiguous { .. } | Doubt::Rival { .. } => DoubtKind::Ambiguous,
        Doubt::Imprecise { .. } | Doubt::LessThanNeeded { .. } => DoubtKind::Imprecise,
        Doubt::OneSided { .. } => DoubtKind::OneSided,
        Doubt::FocalLength { .. } | Doubt::Camera | Doubt::FarFromPosition { .. } | Doubt::Gravity { .. } => {
            DoubtKind::Other
        }
    }
}
