//! Which regions a query is asked in, and which of their poses is told.

use veiloc_query::Answer;
use veiloc_server::Unanswered;

use crate::message::Candidate;

/// Regions that share at least this part of what the best one holds are asked together with it.
const BESIDE: f64 = 0.75;

/// The regions to ask together, and those to ask when none of the first gives a pose that is trusted; `most` in all.
///
/// A region that holds nearly as much as the best one may be the right one as well. One that holds less is mostly a
/// neighbour, whose images are in the best one's margin too: asked at once it would cost a localization for nothing.
pub(crate) fn rounds(candidates: &[Candidate], most: usize) -> Vec<Vec<usize>> {
    let asked = &candidates[..candidates.len().min(most)];
    let enough = asked.first().map_or(0.0, |best| f64::from(best.held) * BESIDE);
    let (first, second): (Vec<&Candidate>, Vec<&Candidate>) =
        asked.iter().partition(|candidate| f64::from(candidate.held) >= enough);
    let numbers =
        |some: Vec<&Candidate>| some.into_iter().map(|candidate| candidate.region as usize).collect();
    [first, second].into_iter().filter(|some| !some.is_empty()).map(numbers).collect()
}

/// What is told of what the regions gave: the trusted pose with most evidence, else the doubtful one, else why there is none.
///
/// A region that could not be asked may have been the right one: then it is said to come back, and not that there is no pose.
pub(crate) fn best(given: Vec<Result<Answer, Unanswered>>) -> Result<Answer, Unanswered> {
    let mut best: Option<Answer> = None;
    let mut why: Option<Unanswered> = None;
    for result in given {
        match result {
            Ok(answer) => {
                if best.as_ref().is_none_or(|known| is_better(&answer, known)) {
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
    best.ok_or(why.unwrap_or(Unanswered::NoPose(veiloc_server::NoPose::Unsupported)))
}

fn is_better(answer: &Answer, known: &Answer) -> bool {
    let key = |answer: &Answer| (answer.trusted, answer.log_evidence);
    let ((trusted, evidence), (known_trusted, known_evidence)) = (key(answer), key(known));
    trusted.cmp(&known_trusted).then(evidence.total_cmp(&known_evidence)).is_gt()
}

/// What says more about what to do next.
const fn weight(why: Unanswered) -> u8 {
    match why {
        Unanswered::EmptyMap => 0,
        Unanswered::NoPose(_) => 1,
        Unanswered::Stopped => 2,
        Unanswered::Broken => 3,
        Unanswered::TimedOut => 4,
        Unanswered::Unreached { .. } => 5,
        Unanswered::Busy { .. } => 6,
        Unanswered::WrongProfile => 7,
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU64;

    use veiloc_query::AnswerTimes;
    use veiloc_server::NoPose;

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
    fn neighbours_wait_for_the_second_round() {
        let candidates = |held: &[u32]| -> Vec<Candidate> {
            held.iter().enumerate().map(|(i, held)| Candidate { region: i as u32 + 5, held: *held }).collect()
        };
        for (held, most, expected) in [
            (&[10][..], 3, vec![vec![5]]),
            (&[10, 6, 4, 3], 3, vec![vec![5], vec![6, 7]]),
            (&[8, 7, 6, 5], 3, vec![vec![5, 6, 7]]),
            (&[8, 7, 6, 5], 2, vec![vec![5, 6]]),
            (&[10, 6, 4], 1, vec![vec![5]]),
            (&[], 3, vec![]),
        ] {
            assert_eq!(rounds(&candidates(held), most), expected, "{held:?} of {most}");
        }
    }

    #[test]
    fn trust_comes_before_evidence_and_a_pose_before_a_refusal() {
        let none = Err(Unanswered::NoPose(NoPose::TooFew));
        let told = |given: Vec<Result<Answer, Unanswered>>| best(given).map(|a| (a.trusted, a.log_evidence));
        assert_eq!(
            told(vec![Ok(answer(false, 90.0)), none.clone(), Ok(answer(true, 20.0))]),
            Ok((true, 20.0))
        );
        assert_eq!(told(vec![Ok(answer(true, 20.0)), Ok(answer(true, 30.0))]), Ok((true, 30.0)));
        assert_eq!(
            told(vec![Ok(answer(false, f64::NEG_INFINITY)), Ok(answer(false, 3.0))]),
            Ok((false, 3.0))
        );
        let busy = Unanswered::Busy { retry_after: NonZeroU64::MIN };
        assert_eq!(
            told(vec![none.clone(), Err(busy), none.clone()]),
            Err(busy),
            "it may have been the right one"
        );
        assert_eq!(told(vec![none.clone()]), Err(Unanswered::NoPose(NoPose::TooFew)));
        assert_eq!(told(Vec::new()), Err(Unanswered::NoPose(NoPose::Unsupported)));
    }
}
