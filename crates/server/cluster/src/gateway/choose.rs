//! What is told of what the regions gave.

use veiloc_map::regions::is_better;
use veiloc_protocol::Answer;
use veiloc_service::LocalizeFailure;

/// What is told of what the regions gave: the trusted pose with most evidence, else the doubtful one, else why there is none.
///
/// A region that could not be asked may have been the right one: then the client is asked to try again, instead of being told that there is no pose.
pub(crate) fn best(given: Vec<Result<Answer, LocalizeFailure>>) -> Result<Answer, LocalizeFailure> {
    let mut best: Option<Answer> = None;
    let mut why: Option<LocalizeFailure> = None;
    for result in given {
        match result {
            Ok(answer) => {
                if best.as_ref().is_none_or(|known| is_better(worth(&answer), worth(known))) {
                    best = Some(answer);
                }
            }
            Err(new) => {
                if why.is_none_or(|known| weight(new) > weight(known)) {
                    why = Some(new);
                }
            }
        }
    }
    best.ok_or(why.unwrap_or(LocalizeFailure::NoPose(veiloc_service::NoPose::Unsupported)))
}

/// As regions are compared.
const fn worth(answer: &Answer) -> (bool, f64) {
    (answer.trusted, answer.log_evidence)
}

/// What says more about what to do next.
const fn weight(why: LocalizeFailure) -> u8 {
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

    use veiloc_protocol::AnswerTimes;
    use veiloc_service::NoPose;

    use super::*;

    fn answer(trusted: bool, log_evidence: f64) -> Answer {
        Answer {
            pose: None,
            trusted,
            doubts: Vec::new(),
            log_evidence,
            margin: 1.0,
            fit: None,
            inliers: 0,
            matches: 0,
            hypotheses: 0,
            times: AnswerTimes::default(),
        }
    }

    #[test]
    fn trust_comes_before_evidence_and_a_pose_before_a_refusal() {
        let none = Err(LocalizeFailure::NoPose(NoPose::TooFew));
        let told = |given: Vec<Result<Answer, LocalizeFailure>>| best(given).map(|a| (a.trusted, a.log_evidence));
        assert_eq!(
            told(vec![Ok(answer(false, 90.0)), none.clone(), Ok(answer(true, 20.0))]),
            Ok((true, 20.0))
        );
        assert_eq!(told(vec![Ok(answer(true, 20.0)), Ok(answer(true, 30.0))]), Ok((true, 30.0)));
        assert_eq!(
            told(vec![Ok(answer(false, f64::NEG_INFINITY)), Ok(answer(false, 3.0))]),
            Ok((false, 3.0))
        );
        let busy = LocalizeFailure::Busy { retry_after: NonZeroU64::MIN };
        assert_eq!(
            told(vec![none.clone(), Err(busy), none.clone()]),
            Err(busy),
            "it may have been the right one"
        );
        assert_eq!(told(vec![none.clone()]), Err(LocalizeFailure::NoPose(NoPose::TooFew)));
        assert_eq!(told(Vec::new()), Err(LocalizeFailure::NoPose(NoPose::Unsupported)));
    }
}
