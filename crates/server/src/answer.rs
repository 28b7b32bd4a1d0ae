//! What is answered for a pose that was found.

use veiloc_localize::Localization;
use veiloc_query::{Answer, AnswerDoubt, AnswerFit, AnswerPose, AnswerTimes, DoubtKind};
use veiloc_robust::Doubt;

/// What is answered for a pose that took `queue_ms` to be begun with.
pub(crate) fn answer_of(found: &Localization, queue_ms: f64) -> Answer {
    let pose = &found.cam_from_world;
    let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    let doubts = found.confidence.doubts();
    Answer {
        pose: Some(AnswerPose {
            rotation: pose.quaternion(),
            translation: (*pose.translation()).into(),
            center: pose.center().coords.into(),
            covariance: found.covariance,
            center_covariance: pose.center_covariance(&found.covariance),
        }),
        trusted: doubts.is_empty(),
        doubts: doubts.iter().map(|d| AnswerDoubt { kind: kind_of(d), text: d.to_string() }).collect(),
        log_evidence: found.confidence.log_evidence,
        margin: found.confidence.margin,
        fit: fit_of(found),
        inliers: count(found.inliers),
        matches: count(found.matches),
        hypotheses: count(found.hypotheses),
        times: AnswerTimes {
            queue_ms,
            retrieve_ms: found.times.retrieve_ms,
            match_ms: found.times.match_ms,
            pose_ms: found.times.pose_ms,
        },
    }
}

/// `None` when it could not be estimated: then nothing is told, rather than a number that is none.
fn fit_of(found: &Localization) -> Option<AnswerFit> {
    let Localization { noise_px, focal_scale, .. } = *found;
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
