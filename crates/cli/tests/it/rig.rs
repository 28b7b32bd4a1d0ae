//! `veiloc localize --rig`: a session of sealed queries gives one pose, and an invalid rig file gives an error.

use super::common;

use std::sync::Once;

use common::{POSITION_TOLERANCE, QUERIES, TestScene, pose, scene};
use serde_json::{Value, json};
use veiloc_geometry::CameraFromWorld;

/// All queries of the scene sealed under dcl, and a rig file for them: the first camera is the rig frame.
fn ready() -> &'static TestScene {
    static READY: Once = Once::new();
    let scene = scene();
    READY.call_once(|| {
        // This creates the folder too.
        scene.write("session/rig.json", rig(scene).to_string());
        for k in 0..QUERIES {
            scene.seal(&format!("query-{k}.png"), "dcl", &format!("session/{k}.vquery"));
        }
    });
    scene
}

/// The true relative poses.
fn rig(scene: &TestScene) -> Value {
    let first = scene.pose_of("query-0.png");
    let frame = |k: usize| {
        let relative = scene.pose_of(&format!("query-{k}.png")).compose(&first.inverse());
        let relative = CameraFromWorld::new(*relative.rotation(), *relative.translation());
        let t = relative.translation();
        json!({
            "query": format!("{k}.vquery"),
            "cam_from_rig": {"q": relative.quaternion(), "t": [t.x, t.y, t.z]},
            "rotation_sd_deg": if k == 0 { 0.0 } else { 0.05 },
            "translation_sd": if k == 0 { 0.0 } else { 0.005 },
        })
    };
    json!({"frames": (0..QUERIES).map(frame).collect::<Vec<_>>()})
}

#[test]
fn a_session_gives_one_pose() {
    let scene = ready();
    let run = scene.run("localize --map place.vmap --rig session/rig.json --json");
    assert_eq!(run.code, Some(0), "{run}");
    let document = run.json();
    assert_eq!(document["state"], "trusted", "{run}");
    let found = pose(&document["cam_from_world"]);
    assert!(scene.position_error("query-0.png", &found) < POSITION_TOLERANCE, "{run}");
    let frames = document["frames"].as_array().expect("frames");
    assert_eq!(frames.len(), QUERIES);
    for (k, frame) in frames.iter().enumerate() {
        let error = scene.position_error(&format!("query-{k}.png"), &pose(&frame["cam_from_world"]));
        assert!(error < POSITION_TOLERANCE, "{k}: {run}");
        assert_eq!(frame["query"], format!("{k}.vquery"));
    }
    let text = scene.run("localize --map place.vmap --rig session/rig.json");
    assert!(text.stdout.contains("session/rig.json  trusted  at ("), "{text}");
    assert_eq!(text.stdout.lines().count(), 1 + QUERIES, "{text}");
    // Equal input gives equal output, except for the time.
    let again = scene.run("localize --map place.vmap --rig session/rig.json --json").json();
    assert_eq!(again["covariance"], document["covariance"]);
}

#[test]
fn invalid_rig_files_are_refused() {
    let scene = ready();
    let with = |change: &dyn Fn(&mut Value)| {
        let mut document = rig(scene);
        change(&mut document);
        document.to_string()
    };
    let many = |document: &mut Value| document["frames"] = vec![document["frames"][0].clone(); 33].into();
    let cases: [(String, &[&str]); 12] = [
        (String::new(), &["not a rig file", "frames"]),
        ("{".to_owned(), &["not a rig file"]),
        ("[]".to_owned(), &["not a rig file"]),
        (json!({"frames": []}).to_string(), &["0 frames", "1 to 32"]),
        (with(&many), &["33 frames", "1 to 32"]),
        (with(&|d| d["more"] = 1.into()), &["unknown field", "more"]),
        (with(&|d| d["frames"][1]["pose"] = 1.into()), &["unknown field", "pose"]),
        (
            with(&|d| d["frames"][1]["cam_from_rig"]["q"] = json!([0, 0, 0, 0])),
            &["frame 1 (1.vquery)", "pose"],
        ),
        (
            with(&|d| d["frames"][1]["translation_sd"] = json!(-1)),
            &["frame 1 (1.vquery)", "translation_sd is -1"],
        ),
        (
            with(&|d| d["frames"][2]["query"] = "gone.vquery".into()),
            &["frame 2 (gone.vquery)", "relative to"],
        ),
        (
            with(&|d| d["frames"][2]["query"] = "rig-bad.json".into()),
            &["frame 2 (rig-bad.json)", "veiloc seal"],
        ),
        (with(&|d| d["frames"][1]["cam_from_rig"]["t"] = json!([0, 0])), &["not a rig file", "length"]),
    ];
    for (text, expected_words) in cases {
        scene.write("session/rig-bad.json", &text);
        let run = scene.run("localize --map place.vmap --rig session/rig-bad.json");
        assert_eq!(run.code, Some(1), "{text}: {run}");
        for word in ["rig-bad.json"].iter().chain(expected_words) {
            assert!(run.stderr.contains(word), "{word:?} of {text}: {run}");
        }
    }
    let missing = scene.run("localize --map place.vmap --rig session/none.json");
    assert!(missing.code == Some(1) && missing.stderr.contains("none.json"), "{missing}");
    let both = scene.run("localize --map place.vmap --rig session/rig.json session/0.vquery");
    assert_eq!(both.code, Some(2), "{both}");
}
