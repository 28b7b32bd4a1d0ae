//! `veiloc map compress`: a compressed map gives the same answers as the whole one, and cannot be changed.

use super::common;

use common::{POSITION_TOLERANCE, pose, scene};

#[test]
fn a_small_map_answers_and_says_what_it_was_made_of() {
    let scene = scene();
    let whole = scene.run("map info place.vmap --json").succeeded().json();
    let small = scene.run("map compress place.vmap --ratio 4 -o small.vmap --json").succeeded().json();
    let (before, now) = (whole["bytes"].as_u64().expect("bytes"), small["bytes"].as_u64().expect("bytes"));
    assert!(4 * now <= before && 5 * now > before, "{now} of {before}");
    assert_eq!(small["compressed"]["bytes"], whole["bytes"]);
    assert_eq!(small["compressed"]["points"], whole["points"]);
    assert_eq!(small["compressed"]["keypoints"], whole["keypoints"]);
    assert_eq!((&small["profile"], &small["images"]), (&whole["profile"], &whole["images"]));
    assert!(whole["compressed"].is_null() && small["self_test"].is_object());
    let printed = scene.run("map info small.vmap").succeeded();
    assert!(printed.stdout.contains("images cannot be added or removed"), "{printed}");
    // A query that was sealed for the whole map is accepted, and its pose is trusted.
    for scheme in ["points", "dcl"] {
        let sealed = format!("small-{scheme}.vquery");
        scene.seal("query-0.png", scheme, &sealed);
        let answer = scene.run(&format!("localize --map small.vmap --json {sealed}")).succeeded().json();
        assert_eq!(answer["queries"][0]["state"], "trusted", "{answer}");
        let error = scene.position_error("query-0.png", &pose(&answer["queries"][0]["cam_from_world"]));
        assert!(error < POSITION_TOLERANCE, "{scheme}: {error}");
    }
    for (command, expected) in [
        ("map compress small.vmap -o again.vmap", "the map is compressed"),
        ("map compress place.vmap --ratio 1e9 -o tiny.vmap", "too few"),
        ("map remove small.vmap map-02.png -o again.vmap", "the map is compressed"),
    ] {
        let refused = scene.run(command);
        assert!(refused.code == Some(1) && refused.stderr.contains(expected), "{refused}");
    }
    for command in ["--ratio 0", "--ratio NaN", "--size 0", "--recall-loss 101"] {
        let refused = scene.run(&format!("map compress place.vmap {command} -o tiny.vmap"));
        assert!(refused.code == Some(1) && refused.stderr.contains("give"), "{refused}");
    }
    assert!(!scene.path("again.vmap").exists() && !scene.path("tiny.vmap").exists());
}
