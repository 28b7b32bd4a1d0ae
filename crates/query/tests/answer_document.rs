//! An answer as JSON: the fields of `docs/service.md`, and what JSON cannot say.

mod common;

use veiloc_query::{Answer, AnswerDocument};

#[test]
fn a_document_tells_what_the_answer_tells() {
    let answer: Answer = common::answer(5, 2);
    let document = serde_json::to_value(AnswerDocument::new("lobby", &answer)).expect("JSON");
    assert_eq!(document["version"], 1);
    assert_eq!(document["map"], "lobby");
    assert_eq!(document["cam_from_world"]["q"], serde_json::json!([0.5, -0.5, 0.5, 0.5]));
    assert_eq!(document["cam_from_world"]["t"], serde_json::json!(answer.translation));
    assert_eq!(document["center"], serde_json::json!(answer.center));
    assert_eq!(document["covariance"][2][3], answer.covariance[2][3]);
    assert_eq!(document["center_covariance"], serde_json::json!(answer.center_covariance));
    assert_eq!(document["trusted"], false);
    assert_eq!(
        document["doubts"][1],
        serde_json::json!({
            "kind": "weak-evidence", "text": "because of weak-evidence"
        })
    );
    assert_eq!(document["confidence"]["log_evidence"], 812.5);
    assert_eq!((&document["inliers"], &document["matches"]), (&311.into(), &912.into()));
    assert_eq!(
        document["ms"],
        serde_json::json!({ "queue": 0.25, "retrieve": 0.5, "match": 12.0, "pose": 3.75 })
    );
    // JSON has no infinity.
    assert!(document["covariance"][5][5].is_null() && document["confidence"]["margin"].is_null());
}
