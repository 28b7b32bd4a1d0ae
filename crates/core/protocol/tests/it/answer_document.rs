//! An answer as JSON: the fields of `docs/reference/http.md`, and values that JSON cannot express.

use super::common;

use veiloc_protocol::{Answer, AnswerDocument};

#[test]
fn document_has_all_fields_of_the_answer() {
    let answer: Answer = common::answer_with_fit(5, 2);
    let pose = answer.pose.expect("a pose");
    let document = serde_json::to_value(AnswerDocument::new(&answer)).expect("JSON");
    assert_eq!(document["version"], 1);
    assert_eq!(document["cam_from_world"]["q"], serde_json::json!([0.5, -0.5, 0.5, 0.5]));
    assert_eq!(document["cam_from_world"]["t"], serde_json::json!(pose.translation));
    assert_eq!(document["center"], serde_json::json!(pose.center()));
    assert_eq!(document["covariance"][2][3], pose.covariance[2][3]);
    assert_eq!(document["center_covariance"][0][1], pose.center_covariance()[0][1]);
    assert_eq!(document["state"], "doubtful");
    assert_eq!((&document["metres_per_unit"], &document["sd_includes"]), (&1.0.into(), &"map".into()));
    assert_eq!(document["down"], serde_json::json!([0.0, -1.0, 0.0]));
    assert_eq!(document["gravity"], "used");
    assert_eq!(serde_json::from_str::<serde_json::Value>(&answer.to_json()).expect("JSON"), document);
    assert_eq!(document["position_sd"], serde_json::json!(pose.position_sd()));
    assert_eq!((&document["noise_px"], &document["focal_scale"]), (&0.75.into(), &1.031_25.into()));
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

/// A withheld pose is absent; everything else is present.
#[test]
fn withheld_pose_is_absent() {
    let answer = common::answer_with_fit(5, 1);
    let fields = |answer: &Answer| -> Vec<String> {
        let document = serde_json::to_value(AnswerDocument::new(answer)).expect("JSON");
        document.as_object().expect("fields").keys().cloned().collect()
    };
    let (all, left) = (fields(&answer), fields(&answer.trusted_only()));
    let gone: Vec<&str> = all.iter().filter(|f| !left.contains(f)).map(String::as_str).collect();
    let pose =
        ["cam_from_world", "center", "center_covariance", "covariance", "position_sd", "rotation_sd_deg"];
    assert_eq!(gone, pose);
    assert!(left.contains(&"doubts".to_owned()) && left.contains(&"state".to_owned()), "{left:?}");
}
