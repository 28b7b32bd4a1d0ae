//! Advice for each situation.

use std::collections::BTreeSet;

use veiloc_ar::{Advice, Situation};
use veiloc_protocol::{Answer, AnswerDoubt, DoubtKind};

use crate::walk::{Walk, answer};

fn doubtful(kind: DoubtKind) -> Answer {
    let walk = Walk::new(1, 0.0, 1);
    let doubts = vec![AnswerDoubt { kind, text: String::new() }];
    Answer { doubts, ..answer(&walk.frames[0].cam_from_map, false) }
}

#[test]
fn causes_come_before_effects() {
    let sharp = Situation { brightness: Some(0.4), keypoints: Some(900), ..Situation::default() };
    let trusted = answer(&Walk::new(1, 0.0, 1).frames[0].cam_from_map, true);
    let (ambiguous, one_sided) = (doubtful(DoubtKind::Ambiguous), doubtful(DoubtKind::OneSided));
    let (loose, weak) = (doubtful(DoubtKind::Imprecise), doubtful(DoubtKind::WeakEvidence));
    let other = doubtful(DoubtKind::Other);
    let cases = [
        (Situation { answer: Some(&trusted), degrees_per_second: Some(90.0), ..sharp }, Advice::Ready),
        (Situation { brightness: Some(0.05), keypoints: Some(40), ..sharp }, Advice::TooDark),
        // A dark frame with keypoints is usable.
        (Situation { brightness: Some(0.05), ..sharp }, Advice::TurnToMappedPlace),
        (Situation { degrees_per_second: Some(90.0), keypoints: Some(40), ..sharp }, Advice::MoveSlower),
        (Situation { keypoints: Some(40), ..sharp }, Advice::ShowMoreDetail),
        (Situation { misses: 1, ..sharp }, Advice::TurnToMappedPlace),
        (Situation { misses: 5, ..sharp }, Advice::NotInThisPlace),
        (Situation { answer: Some(&ambiguous), ..sharp }, Advice::ShowSurroundings),
        (Situation { answer: Some(&one_sided), ..sharp }, Advice::ShowBothSides),
        (Situation { answer: Some(&loose), ..sharp }, Advice::MoveCloser),
        (Situation { answer: Some(&weak), ..sharp }, Advice::TurnToMappedPlace),
        (Situation { answer: Some(&other), ..sharp }, Advice::ShowSurroundings),
    ];
    for (situation, expected) in cases {
        assert_eq!(Advice::of(&situation), expected, "{situation:?}");
    }
}

#[test]
fn each_has_a_name_and_a_sentence_of_its_own() {
    let names: BTreeSet<_> = Advice::ALL.iter().map(|advice| advice.name()).collect();
    let texts: BTreeSet<_> = Advice::ALL.iter().map(|advice| advice.text()).collect();
    assert_eq!((names.len(), texts.len()), (Advice::ALL.len(), Advice::ALL.len()));
}
