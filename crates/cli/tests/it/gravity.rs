//! Direction of gravity: set in a map, stored by it, and its effect on queries with gravity.

use super::common;

use common::{EXTRACTION, TestScene, scene};
use serde_json::Value;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};

/// Direction of gravity in rendered scenes.
const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

fn info(scene: &TestScene, map: &str) -> Value {
    scene.run(&format!("map info {map} --json")).succeeded().json()
}

fn build(scene: &TestScene, down: &str, out: &str) -> common::Run {
    let words = "map build --posed posed --images images --list map.txt --no-self-test";
    scene.run(&format!("{words} {} {down} -o {out}", EXTRACTION.join(" ")))
}

/// Gravity in the camera of an image, rotated by some degrees about the camera's `z` axis.
fn measured_gravity(scene: &TestScene, image: &str, degrees: f64) -> String {
    let (_, pose) = scene.poses.iter().find(|(name, _)| name == image).expect("an image of the scene");
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), degrees.to_radians());
    let [x, y, z]: [f64; 3] = (turn * (pose.rotation() * DOWN)).into();
    format!("{x},{y},{z},0.5")
}

#[test]
fn map_stores_gravity() {
    let scene = scene();
    build(scene, "--down 0,0,-3", "down.vmap").succeeded();
    assert_eq!(info(scene, "down.vmap")["down"], serde_json::json!([0.0, 0.0, -1.0]));
    let text = scene.run("map info down.vmap").succeeded().stdout;
    assert!(text.contains("down        (0.0000, 0.0000, -1.0000)"), "{text}");
    scene.run("map remove down.vmap map-03.png --no-self-test -o fewer.vmap").succeeded();
    assert_eq!(info(scene, "fewer.vmap")["down"], serde_json::json!([0.0, 0.0, -1.0]));
    scene.write("joins.txt", "map-03.png\n");
    let add = "map add fewer.vmap --posed posed --images images --list joins.txt --no-self-test -o more.vmap";
    scene.run(add).succeeded();
    assert_eq!(info(scene, "more.vmap")["down"], serde_json::json!([0.0, 0.0, -1.0]));
    assert_eq!(info(scene, "place.vmap")["down"], Value::Null);
    let text = scene.run("map info place.vmap").succeeded().stdout;
    assert!(text.contains("down        not known"), "{text}");
}

#[test]
fn invalid_directions_are_wrong_usage() {
    let scene = scene();
    for down in ["0,0,0", "NaN,0,1", "1,2", "up", "inf,0,0"] {
        let run = build(scene, &format!("--down={down}"), "never.vmap");
        assert_eq!(run.code, Some(2), "{run}");
        assert!(run.stderr.contains("--down") && run.stderr.contains("X,Y,Z"), "{run}");
        assert!(!scene.path("never.vmap").exists());
    }
}

#[test]
fn gravity_is_used_only_if_the_map_has_it() {
    let scene = scene();
    build(scene, "--down -z", "upright.vmap").succeeded();
    let localized = |map: &str, query: &str| {
        let run = scene.run(&format!("localize --map {map} {query} --json"));
        let message = run.stderr.clone();
        (run.json()["queries"][0].clone(), message)
    };
    let image = "query-1.png";
    scene.seal(image, "", "plain.vquery");
    scene.seal(image, &format!("dcl --gravity={}", measured_gravity(scene, image, 0.0)), "true.vquery");
    scene.seal(image, &format!("dcl --gravity={}", measured_gravity(scene, image, 30.0)), "false.vquery");

    let (plain, message) = localized("upright.vmap", "plain.vquery");
    assert!(plain.get("gravity").is_none() && !message.contains("down"), "{plain} {message}");
    let (unused, message) = localized("place.vmap", "true.vquery");
    assert_eq!(unused["gravity"], "unused");
    assert!(
        message.contains("1 of 1 have a direction of gravity") && message.contains("--down"),
        "{message}"
    );
    let (used, message) = localized("upright.vmap", "true.vquery");
    assert_eq!((&used["gravity"], &used["state"]), (&"used".into(), &"trusted".into()));
    assert!(!message.contains("down"), "{message}");

    // A grossly wrong direction is rejected: the pose is the same as without it, or doubtful.
    let (misled, _) = localized("upright.vmap", "false.vquery");
    let center = |query: &Value| {
        let c: Vec<f64> = serde_json::from_value(query["center"].clone()).expect("a position");
        Vector3::new(c[0], c[1], c[2])
    };
    if misled["state"] == "trusted" {
        assert_eq!(plain["state"], "trusted");
        let off = (center(&misled) - center(&plain)).norm();
        let sd = plain["position_sd"].as_f64().expect("a number");
        assert!(off < 4.0 * sd, "{off} where ± is {sd}");
    }
}
