//! A result of localization as the [`Answer`] that a service sends, and that program and bindings show.

use veiloc_geometry::Rigid3;
use veiloc_geometry::frames::World;
use veiloc_map::MapFile;
use veiloc_pose::{Confidence, Doubt};
use veiloc_protocol::{Answer, AnswerDoubt, AnswerFit, AnswerPose, AnswerTimes, DoubtKind, GravityUse};

use crate::{Localization, RigLocalization, StageTimes};

impl Localization {
    /// The answer; `map`: in which the query was localized. Nothing has waited: `times.queue_ms` is 0.
    pub fn answer(&self, map: &MapFile) -> Answer {
        Answer {
            fit: fit(self.noise_px, self.focal_scale, self.principal_shift_px),
            inliers: count(self.inliers),
            matches: count(self.matches),
            hypotheses: count(self.hypotheses),
            ..common(
                &self.cam_from_world,
                &self.covariance,
                &self.confidence,
                (self.gravity, map),
                self.times,
            )
        }
    }
}

impl RigLocalization {
    /// The answer: the pose is that of the rig, and counts are sums over all frames.
    pub fn answer(&self, map: &MapFile) -> Answer {
        Answer {
            fit: self
                .noise_px()
                .zip(self.focal_scale())
                .and_then(|(noise, focal)| fit(noise, focal, [0.0; 2])),
            inliers: count(self.frames.iter().map(|f| f.inliers).sum()),
            matches: count(self.frames.iter().map(|f| f.matches).sum()),
            hypotheses: count(self.hypotheses),
            ..common(
                &self.rig_from_world,
                &self.covariance,
                &self.confidence,
                (self.gravity, map),
                self.times,
            )
        }
    }
}

/// The fields that both kinds of answers share; `fit` and the counts are left at their defaults.
fn common<Frame>(
    pose: &Rigid3<Frame, World>,
    covariance: &[[f64; 6]; 6],
    confidence: &Confidence,
    (gravity, map): (GravityUse, &MapFile),
    StageTimes { retrieve_ms, match_ms, pose_ms }: StageTimes,
) -> Answer {
    Answer {
        pose: Some(AnswerPose {
            rotation: pose.quaternion(),
            translation: (*pose.translation()).into(),
            covariance: *covariance,
        }),
        doubts: answer_doubts(confidence),
        log_evidence: confidence.log_evidence,
        margin: confidence.margin,
        fit: None,
        gravity,
        map: map.coordinates(),
        inliers: 0,
        matches: 0,
        hypotheses: 0,
        times: AnswerTimes { queue_ms: 0.0, retrieve_ms, match_ms, pose_ms },
    }
}

/// The doubts about a pose, as answers state them; none for a trusted one.
pub fn answer_doubts(confidence: &Confidence) -> Vec<AnswerDoubt> {
    let doubt = |doubt: &Doubt| AnswerDoubt { kind: kind_of(doubt), text: doubt.to_string() };
    confidence.doubts().iter().map(doubt).collect()
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
