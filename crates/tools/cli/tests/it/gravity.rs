//! Direction of gravity: set in a map, stored by it, and its effect on queries with gravity.

use super::common;

use common::{EXTRACTION, Place, place};
use serde_json::Value;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};

/// Direction of gravity in rendered scenes.
const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

fn info(place: &Place, map: &str) -> Value {
    place.run(&format!("map info {map} --json")).succeeded().json()
}

fn build(place: &Place, down: &str, out: &str) -> common::Run {
    let words = "map build --posed posed --images images --list map.txt --no-self-test";
    place.run(&format!("{words} {} {down} -o {out}", EXTRACTION.join(" ")))
}

/// Gravity in the camera of an image, rotated by some degrees about the camera's `z` axis.
fn felt(place: &Place, image: &str, degrees: f64) -> String {
    let (_, pose) = place.poses.iter().find(|(name, _)| name == image).expect("an image of the place");
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), degrees.to_radians());
    let [x, y, z]: [f64; 3] = (turn * (pose.rotation() * DOWN)).into();
    format!("{x},{y},{z},0.5")
}

#[test]
fn a_map_keeps_what_it_was_told() {
    let place = place();
    build(place, "--down 0,0,-3", "down.vmap").succeeded();
    assert_eq!(info(place, "down.vmap")["down"], serde_json::json!([0.0, 0.0, -1.0]));
    let text = place.run("map info down.vmap").succeeded().stdout;
    assert!(text.contains("down        (0.0000, 0.0000, -1.0000)"), "{text}");
    place.run("map remove down.vmap map-03.png --no-self-test -o fewer.vmap").succeeded();
    assert_eq!(info(place, "fewer.vmap")["down"], serde_json::json!([0.0, 0.0, -1.0]));
    place.write("joins.txt", "map-03.png\n");
    let add = "map add fewer.vmap --posed posed --images images --list joins.txt --no-self-test -o more.vmap";
    place.run(add).succeeded();
    assert_eq!(info(place, "more.vmap")["down"], serde_json::json!([0.0, 0.0, -1.0]));
    assert_eq!(info(place, "place.vmap")["down"], Value::Null);
    let text = place.run("map info place.vmap").succeeded().stdout;
    assert!(text.contains("down        not known"), "{text}");
}

#[test]
fn what_is_no_direction_is_wrong_usage() {
    let place = place();
    for down in ["0,0,0", "NaN,0,1", "1,2", "up", "inf,0,0"] {
        let run = build(place, &format!("--down={down}"), "never.vmap");
        assert_eq!(run.code, Some(2), "{run}");
        assert!(run.stderr.contains("--down") && run.stderr.contains("X,Y,Z"), "{run}");
        assert!(!place.path("never.vmap").exists());
    }
}

#[test]
fn queries_are_held_upright_where_the_map_knows_and_told_so_where_it_does_not() {
    let place = place();
    build(place, "--down -z", "upright.vmap").succeeded();
    let localized = |map: &str, query: &str| {
        let run = place.run(&format!("localize --map {map} {query} --json"));
        let said = run.stderr.clone();
        (run.json()["queries"][0].clone(), said)
    };
    let image = "query-1.png";
    place.seal(image, "", "plain.vquery");
    place.seal(image, &format!("dcl --gravity={}", felt(place, image, 0.0)), "true.vquery");
    place.seal(image, &format!("dcl --gravity={}", felt(place, image, 30.0)), "false.vquery");

    let (plain, said) = localized("upright.vmap", "plain.vquery");
    assert!(plain.get("gravity").is_none() && !said.contains("down"), "{plain} {said}");
    let (unused, said) = localized("place.vmap", "true.vquery");
    assert_eq!(unused["gravity"], "unused");
    assert!(said.contains("1 of 1 have a direction of gravity") && said.contains("--down"), "{said}");
    let (used, said) = localized("upright.vmap", "true.vquery");
    assert_eq!((&used["gravity"], &used["state"]), (&"used".into(), &"trusted".into()));
    assert!(!said.contains("down"), "{said}");

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
