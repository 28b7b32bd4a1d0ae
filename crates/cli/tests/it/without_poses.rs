//! Maps of images without poses: the program of structure from motion is a script that writes a known model, so that the test
//! needs no pycolmap.
#![cfg(unix)]

use std::io::Write;
use std::process::{Command, Stdio};

use super::common;

use common::{EXTRACTION, TestScene, scene};

/// Writes a program that behaves as a Python with pycolmap: it says its version, or reads the task and copies a model. It
/// appends a line to `NAME-calls` each time it computes: the tests of this file share a folder.
fn python(scene: &TestScene, name: &str, models: &[&str], says: &str) {
    let copies: Vec<String> = (0..)
        .zip(models)
        .map(|(number, model)| format!("cp -r '{}' \"$sparse/{number}\"", scene.path(model).display()))
        .collect();
    let script = format!(
        r#"#!/bin/sh
case "$2" in *__version__*) echo 4.0; exit 0;; esac
sparse=$(sed 's/.*"sparse":"\([^"]*\)".*/\1/')
echo call >> '{calls}'
{copies}
{says}
"#,
        calls = scene.path(format!("{name}-calls")).display(),
        copies = copies.join("\n"),
    );
    // Another process writes it: a file that a parallel test holds open for writing, in a process it is about to start, cannot be
    // executed ("text file busy").
    let mut writer = Command::new("sh")
        .args(["-c", r#"cat > "$0" && chmod 755 "$0""#])
        .arg(scene.path(name))
        .stdin(Stdio::piped())
        .spawn()
        .expect("a shell");
    writer.stdin.take().expect("piped").write_all(script.as_bytes()).expect("written");
    assert!(writer.wait().expect("ended").success(), "{name} is written");
}

fn build(scene: &TestScene, arguments: &str) -> common::Run {
    scene.run(&format!("map build --images images {} {arguments}", EXTRACTION.join(" ")))
}

#[test]
fn map_is_built_from_images_alone_and_the_poses_are_kept() {
    let scene = scene();
    // The largest model has all poses but one; a second one has a few.
    let posed = String::from_utf8(scene.read("posed/images.txt")).expect("text");
    let cameras = scene.read("posed/cameras.txt");
    let records: Vec<&str> = posed.lines().filter(|line| line.contains(".png")).collect();
    for (model, of) in [("few", &records[..3]), ("many", &records[1..])] {
        scene.write(&format!("{model}/cameras.txt"), &cameras);
        scene.write(&format!("{model}/images.txt"), of.join("\n\n") + "\n\n");
    }
    let says = r#"echo '{"stage": "camera poses", "total": 13}'; echo a line of COLMAP; echo '{"done": 13}'
echo '{"unregistered": "map-00.png", "keypoints": 12, "verified_pairs": 0}'"#;
    python(scene, "python", &["few", "many"], says);
    let run = build(scene, "--python ./python -o alone.vmap --no-self-test").succeeded();
    assert!(run.stderr.contains("12 of 13 images have a pose, by pycolmap 4.0 of ./python"), "{run}");
    assert!(run.stderr.contains("2 models that are not connected"), "{run}");
    // It is in the other model, which says more than its keypoints.
    assert!(run.stderr.contains("map-00.png: in another model"), "{run}");
    let calls = || scene.read("python-calls").len();
    let once = calls();
    let again = build(scene, "--python ./python -o alone.vmap --no-self-test").succeeded();
    assert!(calls() == once && again.stderr.contains("from an earlier run"), "{again}");

    // Other images: computed again, in the folder that --work names.
    python(scene, "python", &["many"], says);
    let run = build(scene, "--python ./python --work kept -o alone.vmap --no-self-test").succeeded();
    assert!(calls() > once && run.stderr.contains("map-00.png: 12 keypoints"), "{run}");
    assert!(scene.path("kept/sfm/finished.json").is_file());

    // The camera that was estimated is named, and given to queries by the map.
    assert!(run.stderr.contains(&format!("Estimated camera: {}", common::CAMERA)), "{run}");
    let info = scene.run("map info alone.vmap --json").json();
    assert_eq!(info["main_camera"]["camera"], common::CAMERA, "{info}");
    assert_eq!(info["main_camera"]["images"], 12, "{info}");
    for camera in [common::CAMERA, "alone.vmap"] {
        let localize = "localize --map alone.vmap --queries queries.txt --images images --camera";
        let run = scene.run(&format!("{localize} {camera}"));
        assert_eq!(run.code, Some(0), "{camera}: {run}");
    }
}

#[test]
fn every_component_becomes_a_map() {
    let scene = scene();
    let posed = String::from_utf8(scene.read("posed/images.txt")).expect("text");
    let records: Vec<&str> = posed.lines().filter(|line| line.contains(".png")).collect();
    for (model, of) in [("part-of-5", &records[..5]), ("part-of-8", &records[5..])] {
        scene.write(&format!("{model}/cameras.txt"), scene.read("posed/cameras.txt"));
        scene.write(&format!("{model}/images.txt"), of.join("\n\n") + "\n\n");
    }
    python(scene, "two-parts", &["part-of-5", "part-of-8"], "true");
    let run = build(scene, "--python ./two-parts --components -o parts.vmap --no-self-test").succeeded();
    assert!(run.stderr.contains("2 models that are not connected; each becomes a map"), "{run}");
    for (map, images) in [("parts.vmap", 8), ("parts-2.vmap", 5)] {
        assert_eq!(scene.run(&format!("map info {map} --json")).json()["images"], images, "{map}");
    }
    assert!(!scene.path("parts-3.vmap").exists());
    let json = build(scene, "--python ./two-parts --components -o parts.vmap --json");
    assert_eq!(json.code, Some(2), "one document cannot describe two maps: {json}");
}

#[test]
fn video_that_cannot_be_decoded_is_refused() {
    let scene = scene();
    scene.write("walk.mp4", "no video");
    // Whether or not there is an ffmpeg here, the message names it and the file.
    let run = scene.run("map build --images walk.mp4 -o video.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("walk.mp4") && run.stderr.contains("ffmpeg"), "{run}");
    let run = scene.run("map build --images walk.mp4 --posed posed -o video.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("needs the folder of its images"), "{run}");
    scene.write("some.txt", "map-00.png");
    let run = scene.run("map build --images walk.mp4 --list some.txt -o video.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("--list names images of a folder"), "{run}");
    assert!(!scene.path("video.vmap").exists());
}

#[test]
fn missing_and_failing_programs_are_named() {
    let scene = scene();
    let run = build(scene, "--python ./no-python -o none.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("python3 -m pip install pycolmap"), "{run}");
    python(scene, "failing", &[], "echo 'ValueError: no texture' >&2; exit 3");
    let run = build(scene, "--python ./failing -o none.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("ValueError: no texture"), "{run}");
    python(scene, "empty", &[], "true");
    let run = build(scene, "--python ./empty --work empty-work -o none.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("no model could be computed from 13 images"), "{run}");
    let run = scene.run("map build --images images --posed posed --python ./empty -o none.vmap");
    assert!(run.code == Some(1) && run.stderr.contains("--python is for images without poses"), "{run}");
    for option in ["--topic /camera", "--odometry /odom"] {
        let run = scene.run(&format!("map build --images images --posed posed {option} -o none.vmap"));
        assert!(run.code == Some(1) && run.stderr.contains("is for a bag of ROS"), "{run}");
    }
    assert!(!scene.path("none.vmap").exists());
}
