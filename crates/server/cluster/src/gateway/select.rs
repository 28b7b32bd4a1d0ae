//! Selects the best answer of several regions.

use veiloc_map::regions::is_better_pose;
use veiloc_protocol::Answer;
use veiloc_service::LocalizeFailure;

/// Returns the trusted pose with the highest evidence, else the best doubtful one, else the most informative failure.
///
/// An unreachable region may have been the right one. Then the client should retry instead of getting "no pose".
pub(crate) fn best(results: Vec<Result<Answer, LocalizeFailure>>) -> Result<Answer, LocalizeFailure> {
    let mut best: Option<Answer> = None;
    let mut why: Option<LocalizeFailure> = None;
    for result in results {
        match result {
            Ok(answer) => {
                if best.as_ref().is_none_or(|known| is_better_pose(rank_key(&answer), rank_key(known))) {
                    best = Some(answer);
                }
            }
            Err(new) => {
                if why.is_none_or(|known| priority(new) > priority(known)) {
                    why = Some(new);
                }
            }
        }
    }
    best.ok_or(why.unwrap_or(LocalizeFailure::NoPose(veiloc_service::NoPose::Unsupported)))
}

/// Key by which answers are compared.
const fn rank_key(answer: &Answer) -> (bool, f64) {
    (answer.trusted(), answer.log_evidence)
}

/// Priority of a failure: how much it tells the client about what to do next.
const fn priority(why: LocalizeFailure) -> u8 {
    match why {
        LocalizeFailure::EmptyMap => 0,
        LocalizeFailure::NoPose(_) => 1,
        LocalizeFailure::Stopped => 2,
        LocalizeFailure::Broken => 3,
        LocalizeFailure::TimedOut => 4,
        LocalizeFailure::Unreached { .. } => 5,
        LocalizeFailure::Busy { .. } => 6,
        LocalizeFailure::WrongProfile => 7,
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU64;

    use veiloc_protocol::{AnswerDoubt, AnswerTimes, DoubtKind, GravityUse, MapCoordinates};
    use veiloc_service::NoPose;

    use super::*;

    fn answer(trusted: bool, log_evidence: f64) -> Answer {
        let doubt = AnswerDoubt { kind: DoubtKind::WeakEvidence, text: String::new() };
        Answer {
            pose: None,
            doubts: if trusted { Vec::new() } else { vec![doubt] },
            log_evidence,
            margin: 1.0,
            fit: None,
            gravity: GravityUse::NotProvided,
            map: MapCoordinates::default(),
            inliers: 0,
            matches: 0,
            hypotheses: 0,
            times: AnswerTimes::default(),
        }
    }

    #[test]
    fn trusted_poses_then_evidence_then_failures() {
        let none = Err(LocalizeFailure::NoPose(NoPose::TooFew));
        let best_of = |results: Vec<Result<Answer, LocalizeFailure>>| {
            best(results).map(|a| (a.trusted(), a.log_evidence))
        };
        assert_eq!(
            best_of(vec![Ok(answer(false, 90.0)), none.clone(), Ok(answer(true, 20.0))]),
            Ok((true, 20.0))
        );
        assert_eq!(best_of(vec![Ok(answer(true, 20.0)), Ok(answer(true, 30.0))]), Ok((true, 30.0)));
        assert_eq!(
            best_of(vec![Ok(answer(false, f64::NEG_INFINITY)), Ok(answer(false, 3.0))]),
            Ok((false, 3.0))
        );
        let busy = LocalizeFailure::Busy { retry_after: NonZeroU64::MIN };
        assert_eq!(
            best_of(vec![none.clone(), Err(busy), none.clone()]),
            Err(busy),
            "it may have been the right one"
        );
        assert_eq!(best_of(vec![none.clone()]), Err(LocalizeFailure::NoPose(NoPose::TooFew)));
        assert_eq!(best_of(Vec::new()), Err(LocalizeFailure::NoPose(NoPose::Unsupported)));
    }
}
