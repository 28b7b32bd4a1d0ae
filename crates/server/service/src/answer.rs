//! What is answered for a pose that was found.

use veiloc_geometry::Rigid3;
use veiloc_geometry::frames::World;
use veiloc_localization::{Localization, RigLocalization, StageTimes};
use veiloc_pose::{Confidence, Doubt};
use veiloc_protocol::{Answer, AnswerDoubt, AnswerFit, AnswerPose, AnswerTimes, DoubtKind};

/// What is answered for a pose that took `queue_ms` to be begun with.
pub(crate) fn answer_of(found: &Localization, queue_ms: f64) -> Answer {
    Answer {
        fit: fit(found.noise_px, found.focal_scale),
        inliers: count(found.inliers),
        matches: count(found.matches),
        hypotheses: count(found.hypotheses),
        ..told(&found.cam_from_world, &found.covariance, &found.confidence, &found.times, queue_ms)
    }
}

/// The same for a rig, which takes the camera's place: the pose is the rig's. Rows are those of all its frames.
pub(crate) fn answer_of_rig(found: &RigLocalization, queue_ms: f64) -> Answer {
    Answer {
        fit: found.noise_px().zip(found.focal_scale()).and_then(|(noise, focal)| fit(noise, focal)),
        inliers: count(found.frames.iter().map(|f| f.inliers).sum()),
        matches: count(found.frames.iter().map(|f| f.matches).sum()),
        hypotheses: count(found.hypotheses),
        ..told(&found.rig_from_world, &found.covariance, &found.confidence, &found.times, queue_ms)
    }
}

/// What is told of a pose in either case, without what fits it.
fn told<Frame>(
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

/// `None` when it could not be estimated: then nothing is told, rather than a number that is none.
fn fit(noise_px: f64, focal_scale: f64) -> Option<AnswerFit> {
    let told = [noise_px, focal_scale].iter().all(|value| value.is_finite() && *value > 0.0);
    told.then_some(AnswerFit { noise_px, focal_scale })
}

const fn kind_of(doubt: &Doubt) -> DoubtKind {
    match doubt {
        Doubt::WeakEvidence { .. } => DoubtKind::WeakEvidence,
        Doubt::Ambiguous { .. } => DoubtKind::Ambiguous,
        Doubt::LooselyHeld { .. } => DoubtKind::LooselyHeld,
        Doubt::OneSided { .. } => DoubtKind::OneSided,
        Doubt::FocalLength { .. } => DoubtKind::Other,
    }
}
