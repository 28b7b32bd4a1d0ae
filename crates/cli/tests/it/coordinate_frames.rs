//! Images whose poses are in another coordinate frame than the map: added to it, and built with it.

use super::common;

use std::fs;

use common::{CAMERA, QUERIES, Run, TestScene, pose, render_out_of_map_images, scene};
use serde_json::Value;
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_map::colmap::{ColmapImage, ColmapModel, write_text};
use veiloc_mapping::Similarity3;

/// Neighbours at the end of the trajectory.
const BLOCK: [&str; 4] = ["map-06.png", "map-07.png", "map-08.png", "map-09.png"];

fn moved(x: f64, y: f64, z: f64) -> Similarity3 {
    Similarity3 { translation: Vector3::new(x, y, z), ..Similarity3::identity() }
}

/// Name, and the similarity from the true frame to that of the given poses.
fn other_coordinate_frames() -> [(&'static str, Similarity3); 3] {
    let gauge = Similarity3 {
        scale: 2.3,
        rotation: Rotation3::from_scaled_axis(Vector3::new(0.0, 1.0, 0.0)),
        translation: Vector3::new(5.0, -3.0, 7.0),
    };
    [
        ("shift", moved(0.3, 0.0, 0.0)),
        ("half", Similarity3 { scale: 0.5, ..moved(0.0, 0.0, 0.0) }),
        ("gauge", gauge),
    ]
}

/// Writes a posed model with the poses of the block in another coordinate frame, and the others as they are.
fn write_posed(scene: &TestScene, folder: &str, given_from_true: &Similarity3) {
    let given = |name: &str, pose: &CameraFromWorld| {
        if BLOCK.contains(&name) { given_from_true.transform_pose(pose) } else { *pose }
    };
    let images = scene.poses.iter().zip(1..).map(|((name, pose), id)| ColmapImage {
        id,
        name: name.clone(),
        camera_id: 1,
        cam_from_world: given(name, pose),
        points2d: Vec::new(),
    });
    let camera = CAMERA.parse().expect("a camera");
    let model = ColmapModel::new(vec![(1, camera)], images.collect(), Vec::new()).expect("a model");
    write_text(&model, &scene.path(folder)).expect("written");
    fs::write(scene.path("block.txt"), BLOCK.join("\n")).expect("written");
}

/// The map without the block.
fn map_without_block(scene: &TestScene, folder: &str) -> String {
    let map = format!("{folder}/rest.vmap");
    scene.write(&map, scene.read("place.vmap"));
    scene.run(&format!("map remove {map} {}", BLOCK.join(" "))).succeeded();
    map
}

/// The median distance that the similarity moves the true centres of the block.
fn true_distance(scene: &TestScene, given_from_true: &Similarity3) -> f64 {
    let mut distances = BLOCK.map(|name| {
        let pose = scene.pose_of(name);
        pose.translation_error(&given_from_true.transform_pose(&pose))
    });
    distances.sort_by(f64::total_cmp);
    distances[BLOCK.len() / 2]
}

/// The error names the block, the remedies, and the true distance within its standard deviations.
fn assert_refused(run: &Run, distance: f64) {
    assert_eq!(run.code, Some(1), "{run}");
    for word in ["another coordinate frame", BLOCK[0], BLOCK[3], "--align", "--no-coordinate-frame-check"] {
        assert!(run.stderr.contains(word), "{word}: {run}");
    }
    let words: Vec<&str> = run.stderr.split_whitespace().collect();
    let at = words.iter().position(|word| *word == "±").expect("a distance with its standard deviation");
    let number = |word: &str| word.parse::<f64>().expect("a number");
    let (found, sd) = (number(words[at - 1]), number(words[at + 1]));
    assert!((found - distance).abs() < 4.0 * sd + 0.001 && sd < 0.05, "{distance}: {run}");
}

/// Largest distance of the queries from their true poses, map units.
fn worst_error(scene: &TestScene, map: &str) -> f64 {
    let camera = CAMERA.replace(',', " ");
    let list: Vec<String> = (0..QUERIES).map(|i| format!("query-{i}.png {camera}")).collect();
    scene.write("queries-with-camera.txt", list.join("\n"));
    let command = format!(
        "localize --map {map} --queries queries-with-camera.txt --images images --scheme points --json"
    );
    let document = scene.run(&command).json();
    let error = |query: &Value| {
        scene.position_error(query["file"].as_str().expect("a name"), &pose(&query["cam_from_world"]))
    };
    document["queries"].as_array().expect("a list").iter().map(error).fold(0.0, f64::max)
}

#[test]
fn added_images_in_another_frame_are_refused_or_aligned() {
    let scene = scene();
    let map = map_without_block(scene, "add");
    let before = scene.read(&map);
    for (name, given_from_true) in other_coordinate_frames() {
        write_posed(scene, &format!("add-{name}"), &given_from_true);
        let add = format!(
            "map add {map} --posed add-{name} --images images --list block.txt --no-self-test --json"
        );
        assert_refused(&scene.run(&add), true_distance(scene, &given_from_true));
        assert_eq!(scene.read(&map), before, "a refusal leaves the map unchanged");

        let out = format!("add/{name}.vmap");
        let document = scene.run(&format!("{add} --align -o {out}")).succeeded().json();
        let aligned = &document["coordinate_frame"]["aligned"][0];
        assert_eq!(aligned["images"].as_array().map(Vec::len), Some(BLOCK.len()), "{document}");
        let scale = aligned["scale"].as_f64().expect("a number");
        assert!((scale * given_from_true.scale - 1.0).abs() < 0.02, "{document}");
        let error = worst_error(scene, &out);
        assert!(error < 0.03, "{name}: {error}");
        // Without a comparison the wrong poses remain.
        scene.run(&format!("{add} --no-coordinate-frame-check -o add/wrong.vmap")).succeeded();
        if name == "shift" {
            let wrong = worst_error(scene, "add/wrong.vmap");
            assert!(wrong > 0.2, "{wrong}");
        }
    }
}

#[test]
fn added_images_in_the_frame_of_the_map_are_accepted() {
    let scene = scene();
    let map = map_without_block(scene, "honest");
    write_posed(scene, "honest", &Similarity3::identity());
    let add = format!("map add {map} --posed honest --images images --list block.txt --no-self-test --json");
    let plain = scene.run(&format!("{add} -o honest/plain.vmap")).succeeded();
    let document = plain.json();
    let frame = &document["coordinate_frame"];
    assert_eq!(
        (&frame["tested"], &frame["aligned"]),
        (&Value::from(4), &Value::Array(Vec::new())),
        "{plain}"
    );
    assert!(frame["localized"].as_u64() >= Some(3), "{plain}");
    assert!(frame["median_distance"].as_f64() < Some(0.04), "{plain}");
    assert_eq!(document["warnings"].as_array().map(Vec::len), Some(0), "{plain}");
    // Nothing is transformed, and the map is the same as without a comparison.
    for flag in ["--align", "--no-coordinate-frame-check"] {
        scene.run(&format!("{add} {flag} -o honest/other.vmap")).succeeded();
        assert!(scene.read("honest/other.vmap") == scene.read("honest/plain.vmap"), "{flag}");
    }
}

#[test]
fn unknown_frames_are_reported() {
    let scene = scene();
    render_out_of_map_images(2);
    scene.write("elsewhere.vmap", scene.read("place.vmap"));
    let add = "map add elsewhere.vmap --posed other/posed --images other/images --no-self-test --json";
    let run = scene.run(add).succeeded();
    let document = run.json();
    assert_eq!(
        (&document["coordinate_frame"]["tested"], &document["coordinate_frame"]["localized"]),
        (&Value::from(2), &Value::from(0))
    );
    let names: Vec<&Value> =
        document["warnings"].as_array().expect("a list").iter().map(|w| &w["name"]).collect();
    assert!(names.contains(&&Value::from("coordinate-frame-unknown")), "{run}");
    assert!(run.stderr.contains("2 images") && run.stderr.contains("could not be checked"), "{run}");
}

#[test]
fn built_images_in_another_frame_are_refused_or_aligned() {
    let scene = scene();
    let build =
        "map build --images images --list map.txt --max-keypoints 512 --query-keypoints 512 --no-self-test";
    for (name, given_from_true) in other_coordinate_frames() {
        write_posed(scene, &format!("build-{name}"), &given_from_true);
        let build = format!("{build} --posed build-{name} -o build-{name}/place.vmap --json");
        assert_refused(&scene.run(&build), true_distance(scene, &given_from_true));
        assert!(!scene.path(format!("build-{name}/place.vmap")).exists());

        let run = scene.run(&format!("{build} --align")).succeeded();
        let aligned = &run.json()["coordinate_frame"]["aligned"];
        assert_eq!(aligned[0]["images"].as_array().map(Vec::len), Some(BLOCK.len()), "{run}");
        let error = worst_error(scene, &format!("build-{name}/place.vmap"));
        assert!(error < 0.03, "{name}: {error}");
    }
}

/// An evaluation names the remedy too; with the flag, its errors show the second frame.
#[test]
fn evaluations_refuse_two_frames() {
    let scene = scene();
    let (_, given_from_true) = &other_coordinate_frames()[0];
    write_posed(scene, "evaluated", given_from_true);
    let evaluate = |command: &str, more: &str| {
        scene.run(&format!(
            "eval {command} --posed evaluated --images images --map-list map.txt --query-list queries.txt \
             --max-keypoints 512 --query-keypoints 512 {more}"
        ))
    };
    for (command, more) in [("scene", "--schemes points --json"), ("problems", "-o problems.jsonl")] {
        let refused = evaluate(command, more);
        assert_eq!(refused.code, Some(1), "{refused}");
        for word in ["another coordinate frame", BLOCK[0], BLOCK[3], "--no-coordinate-frame-check"] {
            assert!(refused.stderr.contains(word), "{word}: {refused}");
        }
        let run = evaluate(command, &format!("--no-coordinate-frame-check {more}")).succeeded();
        if command == "scene" {
            let document = run.json();
            let worst = document["queries"].as_array().expect("a list").iter();
            let worst = worst.filter_map(|query| query["translation_error"].as_f64()).fold(0.0, f64::max);
            assert!(worst > 0.2, "{run}");
        }
    }
}

/// The map of the tests itself is built without a refusal; here with the poses of two frames, unchecked.
#[test]
fn build_without_comparison_accepts_two_frames() {
    let scene = scene();
    let (_, given_from_true) = &other_coordinate_frames()[0];
    write_posed(scene, "unchecked", given_from_true);
    let build = "map build --posed unchecked --images images --list map.txt --max-keypoints 512 \
                 --query-keypoints 512 --no-self-test --no-coordinate-frame-check -o unchecked.vmap --json";
    let document = scene.run(build).succeeded().json();
    assert!(document.get("coordinate_frame").is_none(), "{document}");

    // As a finished model, the same map is refused too.
    scene.run("map export unchecked.vmap --colmap two-frames").succeeded();
    let import = "map import --model two-frames --images images --max-keypoints 512 --query-keypoints 512 \
                  --no-self-test -o imported.vmap --json";
    assert_refused(&scene.run(import), true_distance(scene, given_from_true));
    assert!(!scene.path("imported.vmap").exists());
    scene.run(&format!("{import} --no-coordinate-frame-check")).succeeded();
    scene.run("map export place.vmap --colmap one-frame").succeeded();
    scene.run(&import.replace("two-frames", "one-frame")).succeeded();
}
